"""The records of core packets, compiled: slots, kinds, alphas, siblings into `Plans` (spec 7.2)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.decoding.compiled.headers import Headers
from evogs_codec.decoding.compiled.plans import CHUNK, DROP, N_GROUPS, REFINE, SPLIT, Plans, Tables
from evogs_codec.decoding.compiled.values import unpack
from evogs_codec.model.splats import I32, I64

__all__ = ["read_records", "sibling_runs"]

_jit = jit()


@_jit
def read_records(
    headers: Headers,
    k: int,
    tables: Tables,
    plans: Plans,
    live: npt.NDArray[np.bool_],
    born_from: I32,
    places: I32,
) -> bool:
    """Slots, kinds and alpha of a core packet into `plans`; changes which slots are live."""
    step, planes = headers.steps[k], headers.planes
    n_adds, n_splits, n_refines, n_drops = headers.counts[k]
    n_records, codes, starts = n_splits + n_refines + n_drops, headers.codes[k], headers.starts[k]
    n_before, run, split, drop, before, sibling = plans.places[step]
    at_split, at_drop, n_psi = split, drop, 0
    kind = SPLIT if n_splits else DROP if n_drops else REFINE
    has_kinds = (n_splits > 0) + (n_refines > 0) + (n_drops > 0) > 1
    gaps, kinds = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.int32)
    slot, end_of_run = np.int64(-1), np.int64(-1)
    all_live = drop == 0
    slots = np.empty(n_refines if n_splits == 0 and n_drops == 0 else 0, np.int32)
    for begin in range(0, n_records, CHUNK):
        n = min(CHUNK, n_records - begin)
        unpack(codes[0], planes, starts[0], n_records, begin, n, gaps)
        if all_live and n_drops == 0 and not has_kinds:
            of = slots[begin : begin + n]
            if n_splits:
                of = born_from[n_before + begin : n_before + begin + n]
            slot = _next_slots(gaps[:n], slot, of)
            if slot >= n_before:  # R-7.2-1
                return False
            run = _next_runs(gaps[:n], of[0], plans.runs, run)
            n_psi, at_split = n_psi + n, at_split + (n if n_splits else 0)
            continue
        if has_kinds:
            unpack(codes[1], planes, starts[1], n_records, begin, n, kinds)
        for i in range(n):
            slot += np.int64(gaps[i]) + 1
            if slot >= n_before or not live[slot]:  # R-7.2-1
                return False
            if has_kinds:
                kind = np.int64(kinds[i])
            if kind == DROP:
                if at_drop - drop == n_drops:
                    return False
                plans.drops[at_drop] = slot
                at_drop += 1
                continue
            if len(slots):
                slots[n_psi] = slot
            if kind == SPLIT:
                if at_split - split == n_splits:
                    return False
                plans.splits[at_split] = n_psi
                born_from[n_before + at_split - split] = slot
                at_split += 1
            elif kind != REFINE:
                return False
            if slot == end_of_run and n_psi % CHUNK:
                plans.runs[1, run - 1] += 1
            else:
                plans.runs[0, run], plans.runs[1, run] = slot, 1
                run += 1
            end_of_run = slot + 1
            n_psi += 1
    if n_psi != n_splits + n_refines or at_split - split != n_splits:  # R-7.2-2
        return False
    for group in range(N_GROUPS):
        first, n_entries, _, _ = tables.alpha_places[headers.levels[k], group]
        alphas = plans.alphas[group, split:at_split]
        if codes[2 + group] == 0:
            alphas[:] = tables.alphas[first]
            continue
        for begin in range(0, n_splits, CHUNK):
            n = min(CHUNK, n_splits - begin)
            unpack(codes[2 + group], planes, starts[2 + group], n_splits, begin, n, gaps)
            if gaps[:n].max() >= n_entries:  # R-7.2-3
                return False
            for i in range(n):
                alphas[begin + i] = tables.alphas[first + gaps[i]]
    if len(slots):
        sibling, plans.terms[step] = sibling_runs(slots, born_from, places, plans.siblings, sibling)
    end = n_before + n_splits + n_adds
    plans.places[step + 1] = end, run, at_split, at_drop, before + n_psi, sibling
    live[n_before : n_before + n_splits + n_adds] = True
    born_from[n_before + n_splits : n_before + n_splits + n_adds] = -1
    for slot in plans.drops[drop:at_drop]:
        live[slot] = False
    return True


@_jit
def sibling_runs(
    slots: I32, born_from: I32, places: I32, siblings: I32, at_run: int
) -> tuple[int, np.int32]:
    """The runs of `siblings` of records with these slots, from `at_run` on.

    `places` is any number of each slot: that of a record counts if it is of that slot. No record
    is on both sides of a run, so that a run may be turned in any order.

    Returns:
        The run after them, and the most differences that a psi is the sum of.
    """
    terms, most = np.ones(len(slots), np.int32), np.int32(1)
    begin, other, length = np.int64(-1), np.int64(-1), np.int64(0)
    for i in range(len(slots)):
        slot = slots[i]
        places[slot] = i
        of = born_from[slot]
        if of < 0:
            continue
        at = np.int64(places[of])
        if at < 0 or at >= i or slots[at] != of:
            continue
        n = np.int32(terms[at] + np.int32(1))
        terms[at], terms[i] = n, n
        most = max(most, n)
        if length and i == begin + length and at == other + length and at < begin:
            length += 1
            continue
        if length:
            siblings[0, at_run], siblings[1, at_run], siblings[2, at_run] = begin, other, length
            at_run += 1
        begin, other, length = np.int64(i), at, np.int64(1)
    if length:
        siblings[0, at_run], siblings[1, at_run], siblings[2, at_run] = begin, other, length
        at_run += 1
    return at_run, most


@_jit
def _next_slots(gaps: I32, last: int, out: I32) -> int:
    """Slots of records after that of slot `last`, from their gaps; the last of them."""
    slot = last
    for i in range(len(gaps)):
        slot += np.int64(gaps[i]) + 1
        out[i] = slot
    return slot


@_jit
def _next_runs(gaps: I32, first: int, runs: I64, run: int) -> int:
    """Runs from `run` on, of slots from `first` on, each with its gap to the one before it.

    Returns:
        The run after them.
    """
    begin, slot = 0, np.int64(first)
    for i in range(1, len(gaps)):
        if gaps[i]:
            runs[0, run], runs[1, run] = slot, i - begin
            slot += i - begin + np.int64(gaps[i])
            begin = i
            run += 1
    runs[0, run], runs[1, run] = slot, len(gaps) - begin
    return run + 1
