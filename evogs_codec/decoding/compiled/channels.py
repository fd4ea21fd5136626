"""The hot loops of decoding, compiled: the integers of `arithmetic` and `planes`, no temporaries.

Optional: without numba the codec uses numpy. A test holds the two to identical integers and faults.
Channels do not know each other: all packets are applied to one (or to the three of an SH
coefficient) before the next, so that its slots stay in cache; of a packet `CHUNK` records at a
time, so that what lies between planes and slots stays in the nearest one. Like `headers` it
knows no faults: where a rule is broken it gives up, and the numpy code finds out which. Sums fit
int32 by the bounds of spec 7.3; products are bounded before they are made.

Over 400 lines: it is one loop over channels, packets and records, read from the top down; what it
does with single values is in `values`.

Letters: P records with psi, S splits, A adds, all of one step; C channels that are turned together,
1 or 3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from evogs_codec.common.buffers import Scratch
from evogs_codec.decoding.compiled.headers import (
    MAX_LISTS,
    N_CORE,
    N_SIDES,
    Headers,
    bits_are_plain,
    read_headers,
)
from evogs_codec.decoding.compiled.values import (
    MAX_INT,
    add_siblings,
    children,
    entries,
    first_children,
    float_picks,
    float_rows,
    inverse_ycocg,
    picks,
    products_fit,
    scale,
    second_children,
    unpack,
    unzigzag,
)
from evogs_codec.format.planes import MAX_SUM
from evogs_codec.model.arithmetic import MAX_X
from evogs_codec.model.splats import I32, I64
from evogs_codec.model.tree import Kind

__all__ = [
    "MAX_LISTS",
    "Headers",
    "Plans",
    "Tables",
    "apply_packets",
    "entries",
    "float_picks",
    "float_rows",
    "picks",
    "read_headers",
]

_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False)
CHUNK = 4096  # a multiple of 8, so that packed planes begin a byte with each chunk
REFINE, SPLIT, DROP = int(Kind.REFINE), int(Kind.SPLIT), int(Kind.DROP)
N_GROUPS, SH_GROUP, FIRST_SH = 5, 4, 11


class Tables(NamedTuple):
    """Quantisers, alpha tables and the box of a tile.

    Attributes:
        units: (1 + n_levels, classes) grid units of one q: of adds, of psi of each level.
        alphas: the entries of all alpha tables, one after the other.
        alpha_places: (n_levels, 5, 4) first entry, number of entries, K, largest |entry|.
        box: (3, 2) least and largest position.
    """

    units: I64
    alphas: I32
    alpha_places: I64
    box: I64


class Channels(NamedTuple):
    """Channels that are turned together: one, or the three of an SH coefficient.

    Attributes:
        rows: (C, n) their slots.
        kind: their class.
        low, high: the least and the largest number that a slot may hold.
    """

    rows: I32
    kind: int
    low: np.int64
    high: np.int64


class Plans(NamedTuple):
    """Where the core steps of a tile act; the packets of the bands use it again.

    Attributes:
        places: (1 + steps, 5) slots before the step; where its `runs`, `splits` and `drops` begin;
            P of all steps before it.
        runs: (2, n) first slot and length of runs of slots of P; none crosses a chunk of P.
        splits: (n,) which of P are splits.
        drops: (n,) slots of the drops.
        alphas: (5, n) a of the splits per group.
        parents: (n,) of the refines, the record of the slot that its slot was born from, or -1;
            unset but for steps that only refine.
    """

    places: I64
    runs: I64
    splits: I64
    drops: I64
    alphas: I32
    parents: I32

    @staticmethod
    def empty(
        scratch: Scratch, n_steps: int, n_records: int, n_splits: int, n_refines: int
    ) -> Plans:
        """Room for the core steps of a tile."""
        n_runs = n_records + n_records // CHUNK + n_steps
        return Plans(
            np.zeros((n_steps + 1, 5), np.int64),
            scratch.take((2, n_runs), np.int64),
            scratch.take((n_splits,), np.int64),
            scratch.take((n_records - n_splits,), np.int64),
            scratch.take((N_GROUPS, n_splits), np.int32),
            scratch.take((n_refines,), np.int32),
        )


@_jit
def apply_packets(
    headers: Headers,
    tables: Tables,
    plans: Plans,
    x: I32,
    live: npt.NDArray[np.bool_],
    born_from: I32,
) -> bool:
    """Apply packets of a tile to its slots (spec 7.4); False if one is not plainly legal.

    Args:
        headers: the packets.
        tables: tables of the stream and tile.
        plans: of core steps applied before, and room for those of these packets.
        x: (D, n) slots.
        live: (n,) whether a slot is.
        born_from: (n,) slot each slot was split from, -1 for adds.
    """
    places = np.empty(len(live), np.int32)  # pages that no step of refines looks at are never made
    for k in range(len(headers.components)):
        if not bits_are_plain(headers, k):
            return False
        if headers.components[k] == 0 and not _read_records(
            headers, k, tables, plans, live, born_from, places
        ):
            return False
    scratch, first = np.empty((6, CHUNK), np.int32), 0
    while first < len(x):
        count = 1 if first < FIRST_SH else 3
        if not _apply_channels(headers, tables, plans, first, x[first : first + count], scratch):
            return False
        first += count
    return True


@_jit
def _read_records(
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
    n_before, run, split, drop, before = plans.places[step]
    at_split, at_drop, n_psi = split, drop, 0
    kind = SPLIT if n_splits else DROP if n_drops else REFINE
    has_kinds = (n_splits > 0) + (n_refines > 0) + (n_drops > 0) > 1
    gaps, kinds = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.int32)
    slot, end_of_run = np.int64(-1), np.int64(-1)
    all_split = n_splits == n_records and drop == 0  # of slots that are all live
    for begin in range(0, n_records, CHUNK):
        n = min(CHUNK, n_records - begin)
        unpack(codes[0], planes, starts[0], n_records, begin, n, gaps)
        if all_split:
            first = n_before + begin
            slot = _next_slots(gaps[:n], slot, born_from[first : first + n])
            if slot >= n_before:  # R-7.2-1
                return False
            run = _next_runs(gaps[:n], born_from[first], plans.runs, run)
            n_psi, at_split = n_psi + n, at_split + n
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
    if n_splits == 0 and n_drops == 0 and n_refines:
        _parent_records(plans, plans.places[step, 1], n_refines, before - split, born_from, places)
    end = n_before + n_splits + n_adds
    plans.places[step + 1] = end, run, at_split, at_drop, before + n_psi
    live[n_before : n_before + n_splits + n_adds] = True
    born_from[n_before + n_splits : n_before + n_splits + n_adds] = -1
    for slot in plans.drops[drop:at_drop]:
        live[slot] = False
    return True


@_jit
def _parent_records(
    plans: Plans, run: int, n: int, parent: int, born_from: I32, places: I32
) -> None:
    """The `parents` of n records whose slots are those of the runs from `run` on.

    `places` is any number of each slot: that of a record counts if it is of that slot.
    """
    parents = plans.parents[parent : parent + n]
    slots, i = np.empty(n, np.int32), 0
    while i < n:
        slot, length = plans.runs[0, run], plans.runs[1, run]
        for j in range(length):
            of = born_from[slot + j]
            at = places[of] if of >= 0 else -1
            parents[i] = at if 0 <= at < i and slots[at] == of else -1
            slots[i], places[slot + j] = slot + j, i
            i += 1
        run += 1


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


@_jit
def _apply_channels(
    headers: Headers, tables: Tables, plans: Plans, first: int, rows: I32, scratch: I32
) -> bool:
    """All packets on the channels from `first` on, whose slots are `rows` (C, n)."""
    kind = _class_of(first)
    component = max(kind - SH_GROUP, 0)
    at = first - (11 + 3 * component * component if component else 0)  # in the component
    n_channels = 3 * (2 * component + 1) if component else N_CORE
    at_psi = at + (0 if component else N_SIDES)
    low, high = -np.int64(MAX_X), np.int64(MAX_X)
    if kind == 0:
        low, high = tables.box[first]
    channels = Channels(rows, kind, low, high)
    for k in range(len(headers.components)):
        if headers.components[k] != component:
            continue
        n_adds, n_splits, n_refines, n_drops = headers.counts[k]
        if n_splits + n_refines and not _apply_psi(
            headers, k, at_psi, tables, plans, channels, scratch
        ):
            return False
        if n_adds and not _apply_adds(
            headers, k, at_psi + n_channels, tables, plans, channels, scratch
        ):
            return False
        begin = plans.places[headers.steps[k], 3]
        for slot in plans.drops[begin : begin + n_drops]:
            rows[:, slot] = 0
    return True


@_jit
def _class_of(channel: int) -> int:
    """Spec 3.2."""
    if channel < FIRST_SH:
        return 0 if channel < 3 else 1 if channel < 7 else 2 if channel < 10 else 3
    return 4 if channel < 14 else 5 if channel < 23 else 6 if channel < 38 else 7


@_jit
def _apply_psi(
    headers: Headers,
    k: int,
    at: int,
    tables: Tables,
    plans: Plans,
    channels: Channels,
    scratch: I32,
) -> bool:
    """Refines and splits of a packet; `at` is the first list of the channels."""
    step, level, q = headers.steps[k], headers.levels[k], scratch[:3]
    n_psi = headers.counts[k, 1] + headers.counts[k, 2]
    rows, kind, low, high = channels
    group, unit = min(kind, SH_GROUP), tables.units[1 + level, kind]
    _, _, shift, largest_alpha = tables.alpha_places[level, group]
    run, split = plans.places[step, 1], plans.places[step, 2]
    whole, has_siblings = np.empty((0, 0), np.int32), False
    for j in range(len(rows)):
        has_siblings |= headers.codes[k, at + j] & 64 > 0
    if has_siblings:
        parent = plans.places[step, 4] - plans.places[step, 2]  # refines before the step
        whole = _whole_psi(headers, k, at, n_psi, len(rows))
        for j in range(len(rows)):
            if headers.codes[k, at + j] & 64 and not add_siblings(
                whole[j], plans.parents[parent : parent + n_psi]
            ):
                return False
    for begin in range(0, n_psi, CHUNK):
        n = min(CHUNK, n_psi - begin)
        if has_siblings:
            for j in range(len(rows)):
                q[j, :n] = whole[j, begin : begin + n]
        else:
            _psi_chunk(headers, k, at, begin, n, q[: len(rows)])
        next_run, next_split = run, split
        for j in range(len(rows)):
            largest = scale(q[j], n, unit)
            if largest < 0:
                return False
            next_run, next_split = _refine_chunk(
                rows[j], q[j], n, begin, largest, plans, step, run, split,
                plans.alphas[group], largest_alpha, shift, low, high, scratch[3:],
            )  # fmt: skip
            if next_run < 0:
                return False
        run, split = next_run, next_split
    return True


@_jit
def _psi_chunk(headers: Headers, k: int, at: int, begin: int, n: int, q: I32) -> None:
    """Integers begin .. begin + n of psi of channels whose first list is `at`, without siblings."""
    n_psi = headers.counts[k, 1] + headers.counts[k, 2]
    for j in range(len(q)):
        code, start = headers.codes[k, at + j], headers.starts[k, at + j]
        unpack(code, headers.planes, start, n_psi, begin, n, q[j])
        unzigzag(q[j], n)
    if len(q) == 3 and headers.flags[k] & 1:
        inverse_ycocg(q, n)


@_jit
def _whole_psi(headers: Headers, k: int, at: int, n_psi: int, n_rows: int) -> I32:
    """All of them, (C, P): siblings may be far apart."""
    whole = np.empty((n_rows, n_psi), np.int32)
    for begin in range(0, n_psi, CHUNK):
        n = min(CHUNK, n_psi - begin)
        _psi_chunk(headers, k, at, begin, n, whole[:, begin : begin + n])
    return whole


@_jit
def _refine_chunk(
    row: I32,
    delta: I32,
    n: int,
    begin: int,
    largest: int,
    plans: Plans,
    step: int,
    run: int,
    split: int,
    alphas: I32,
    largest_alpha: int,
    shift: int,
    low: int,
    high: int,
    scratch: I32,
) -> tuple[int, int]:
    """Records begin .. begin + n of P in one channel (spec 7.3); (next run, next split) or (-1, 0).

    `largest` is the largest |Delta|; `run` and `split` are the first of the chunk.
    """
    parents, next_run = scratch[0], _gather(row, plans.runs, run, scratch[0], n)
    next_split = _first_split(plans, step, split, begin + n)
    n_splits = next_split - split
    at = plans.places[step, 0] + split - plans.places[step, 2]
    seconds = row[at : at + n_splits]
    of, of_delta, a = parents, delta, alphas[split:next_split]
    if n_splits < n:
        of, of_delta = scratch[1], scratch[2]
        for j in range(n_splits):
            i = plans.splits[split + j] - begin
            of[j], of_delta[j] = parents[i], delta[i]
    if not products_fit(of_delta, largest, a, largest_alpha, shift):
        return -1, 0
    if n_splits == n:
        least, most = children(parents, delta, a, shift, seconds)
    else:
        least, most = first_children(parents, delta, n)
        if n_splits:
            low_second, high_second = second_children(of, of_delta, a, shift, seconds)
            least, most = min(least, low_second), max(most, high_second)
    if least < low or most > high:
        return -1, 0
    _scatter(parents, plans.runs, run, row, n)
    return next_run, next_split


@_jit
def _gather(row: I32, runs: I64, run: int, out: I32, n: int) -> int:
    """The slots of the runs from `run` on, n in all, one after the other; the run after them."""
    i = 0
    while i < n:
        slot, length = runs[0, run], runs[1, run]
        to, part = out[i : i + length], row[slot : slot + length]
        for j in range(length):
            to[j] = part[j]
        i += length
        run += 1
    return run


@_jit
def _scatter(values: I32, runs: I64, run: int, row: I32, n: int) -> None:
    """The inverse of `_gather`."""
    i = 0
    while i < n:
        slot, length = runs[0, run], runs[1, run]
        to, part = row[slot : slot + length], values[i : i + length]
        for j in range(length):
            to[j] = part[j]
        i += length
        run += 1


@_jit
def _first_split(plans: Plans, step: int, split: int, record: int) -> int:
    """The first of the splits of a step, from `split` on, that is at `record` of P or later."""
    end = plans.places[step + 1, 2]
    n_psi = plans.places[step + 1, 4] - plans.places[step, 4]
    if end - plans.places[step, 2] == n_psi:  # all P are splits
        return min(end, plans.places[step, 2] + record)
    first, last = split, end
    while first < last:
        middle = (first + last) >> 1
        if plans.splits[middle] < record:
            first = middle + 1
        else:
            last = middle
    return first


@_jit
def _apply_adds(
    headers: Headers,
    k: int,
    at: int,
    tables: Tables,
    plans: Plans,
    channels: Channels,
    scratch: I32,
) -> bool:
    """Adds of a packet; `at` is the first list of the channels."""
    n_adds, n_splits, _, _ = headers.counts[k]
    rows, kind, low, high = channels
    first, unit = plans.places[headers.steps[k], 0] + n_splits, tables.units[0, kind]
    q, sums = scratch[:3], np.zeros(3, np.int64)
    for begin in range(0, n_adds, CHUNK):
        n = min(CHUNK, n_adds - begin)
        for j in range(len(rows)):
            code, start = headers.codes[k, at + j], headers.starts[k, at + j]
            unpack(code, headers.planes, start, n_adds, begin, n, q[j])
            unzigzag(q[j], n)
            if code & 64:
                for i in range(n):
                    sums[j] += q[j, i]
                    if sums[j] > MAX_SUM or sums[j] < -MAX_SUM:  # R-7.1-1
                        return False
                    q[j, i] = sums[j]
        if len(rows) == 3 and headers.flags[k] & 2:
            inverse_ycocg(q, n)
        for j in range(len(rows)):
            if scale(q[j], n, unit) < 0:
                return False
            least, most = np.int32(MAX_INT), np.int32(-MAX_INT)
            row = rows[j, first + begin : first + begin + n]
            for i in range(n):
                row[i] = q[j, i]
                least, most = min(least, q[j, i]), max(most, q[j, i])
            if least < low or most > high:
                return False
    return True
