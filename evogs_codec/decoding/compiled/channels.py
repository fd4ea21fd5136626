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
from evogs_codec.decoding.compiled.runs import gather, refine_runs, scatter, split_runs
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
    sum_siblings,
    turn_back,
    unpack,
    unpack_signed,
    unzigzag,
)
from evogs_codec.format.packet_header import FLAG_OF_CHANGED
from evogs_codec.format.planes import MAX_SUM
from evogs_codec.model.arithmetic import MAX_DELTA, MAX_PRODUCT, MAX_X
from evogs_codec.model.components import PICKS
from evogs_codec.model.siblings import MAX_SIBLING
from evogs_codec.model.splats import I32, I64, U8
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
    "inverse_ycocg",
    "read_headers",
    "sibling_runs",
    "unpack",
    "unzigzag",
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
        bounds: (C,) no |number| of a slot is above it.
    """

    rows: I32
    kind: int
    low: np.int64
    high: np.int64
    bounds: I64


class Plans(NamedTuple):
    """Where the core steps of a tile act; the packets of the bands use it again.

    Attributes:
        places: (1 + steps, 6) slots before the step; where its `runs`, `splits` and `drops` begin;
            P of all steps before it; where its `siblings` begin.
        runs: (2, n) first slot and length of runs of slots of P; none crosses a chunk of P.
        splits: (n,) which of P are splits.
        drops: (n,) slots of the drops.
        alphas: (5, n) a of the splits per group.
        siblings: (3, n) of steps that only refine, runs of records whose slots were born from slots
            of the step: the first record, the record of its sibling, and the length.
        terms: (steps,) the most differences that a psi of the step is the sum of.
        bounds: (D,) of each channel, no |number| of a slot is above it.
    """

    places: I64
    runs: I64
    splits: I64
    drops: I64
    alphas: I32
    siblings: I32
    terms: I64
    bounds: I64

    @staticmethod
    def empty(
        scratch: Scratch, n_channels: int, n_steps: int, n_psi: tuple[int, int], n_drops: int
    ) -> Plans:
        """Room for the core steps of a tile; of psi the splits and the refines."""
        n_splits, n_refines = n_psi
        n_records = n_splits + n_refines + n_drops
        n_runs = n_records + n_records // CHUNK + n_steps
        return Plans(
            np.zeros((n_steps + 1, 6), np.int64),
            scratch.take((2, n_runs), np.int64),
            scratch.take((n_splits,), np.int64),
            scratch.take((n_drops,), np.int64),
            scratch.take((N_GROUPS, n_splits), np.int32),
            scratch.take((3, n_refines), np.int32),
            np.ones(n_steps, np.int64),
            np.zeros(n_channels, np.int64),
        )


@_jit
def apply_packets(
    headers: Headers,
    tables: Tables,
    plans: Plans,
    x: I32,
    live: npt.NDArray[np.bool_],
    born_from: I32,
    shown: I32,
) -> bool:
    """Apply packets of a tile to its slots (spec 7.4); False if one is not plainly legal.

    Args:
        headers: the packets.
        tables: tables of the stream and tile.
        plans: of core steps applied before, and room for those of these packets.
        x: (D, n) slots.
        live: (n,) whether a slot is.
        born_from: (n,) slot each slot was split from, -1 for adds.
        shown: (n,) picks of the slots, where there is a palette.
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
    for k in range(len(headers.components)):
        if headers.components[k] == PICKS and not _apply_picks(headers, k, plans, shown):
            return False
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
    channels = Channels(rows, kind, low, high, plans.bounds[first : first + len(rows)])
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
    rows, kind, low, high, bounds = channels
    width = len(rows) if headers.flags[k] & 1 else 1
    for first in range(0, len(rows), width):
        largest = _largest_q(headers.codes[k, at + first : at + first + width])
        part = rows[first : first + width]
        if largest == 0:
            _copy_parents(part, plans, headers.steps[k], scratch[0])
            continue
        some = Channels(part, kind, low, high, bounds[first : first + width])
        if not _apply_turned(headers, k, at + first, largest, tables, plans, some, scratch):
            return False
    return True


@_jit
def _largest_q(codes: U8) -> int:
    """A bound of |q| of channels that are turned together, from their codings (spec 7.1)."""
    bits = np.int64(0)
    for code in codes:
        bits = max(bits, (np.int64(code) & 15) + 8 * ((np.int64(code) >> 4) & 3))
    largest = np.int64(1) << bits >> 1
    return 4 * largest + 2 if len(codes) == 3 and bits else largest


@_jit
def _copy_parents(rows: I32, plans: Plans, step: int, scratch: I32) -> None:
    """The C2 of splits whose psi are 0."""
    run, split, end = plans.places[step, 1], plans.places[step, 2], plans.places[step + 1, 2]
    first, n_psi = plans.places[step, 0], plans.places[step + 1, 4] - plans.places[step, 4]
    n_splits, begin = end - split, 0
    while begin < n_psi and n_splits:
        n, next_run = min(CHUNK, n_psi - begin), run
        last = _first_split(plans, step, split, begin + n)
        for row in rows:
            seconds = row[first : first + last - split]
            if n_splits == n_psi:
                next_run = gather(row, plans.runs, run, seconds, n)
                continue
            next_run = gather(row, plans.runs, run, scratch, n)
            for j in range(last - split):
                seconds[j] = scratch[plans.splits[split + j] - begin]
        first, run, split, begin = first + last - split, next_run, last, begin + n


@_jit
def _apply_turned(
    headers: Headers,
    k: int,
    at: int,
    largest_q: int,
    tables: Tables,
    plans: Plans,
    channels: Channels,
    scratch: I32,
) -> bool:
    """`_apply_psi` of channels that are turned together; no |q| but of siblings is above a bound.

    Where bounds say that every number stays in range, nothing is looked at but what is changed.
    """
    step, level, q = headers.steps[k], headers.levels[k], scratch[:3]
    n_splits, n_refines = headers.counts[k, 1], headers.counts[k, 2]
    n_psi = n_splits + n_refines
    rows, kind, low, high, bounds = channels
    group, unit = min(kind, SH_GROUP), tables.units[1 + level, kind]
    _, _, shift, largest_alpha = tables.alpha_places[level, group]
    half = np.int64((1 << shift) >> 1)
    run, split = plans.places[step, 1], plans.places[step, 2]
    whole, has_siblings = np.empty((0, 0), np.int32), False
    for j in range(len(rows)):
        has_siblings |= headers.codes[k, at + j] & 64 > 0
    if has_siblings:
        sibling, end = plans.places[step, 5], plans.places[step + 1, 5]
        whole = _whole_psi(headers, k, at, n_psi, len(rows))
        fits = largest_q * plans.terms[step] <= MAX_SIBLING
        for j in range(len(rows)):
            if not headers.codes[k, at + j] & 64:
                continue
            if fits:
                sum_siblings(whole[j], plans.siblings, sibling, end)
            elif not add_siblings(whole[j], plans.siblings, sibling, end):
                return False
        largest_q = largest_q * plans.terms[step] if fits else np.int64(MAX_SIBLING)
    # Of what |q| may be: |Delta|, |a * Delta| with its rounding, |C1| and |C2|.
    delta = largest_q * unit if largest_q <= MAX_DELTA // unit else np.int64(MAX_INT)
    is_bounded = n_splits == 0 or n_refines == 0
    product = np.int64(0)
    if n_splits:
        product = delta * largest_alpha + half
        is_bounded &= product <= MAX_PRODUCT
    is_bounded &= delta <= MAX_DELTA
    moved, room = max(delta, (product >> shift) + 1 if n_splits else 0), min(high, -low)
    is_quick = np.zeros(3, np.bool_)
    for j in range(len(rows)):
        is_quick[j] = is_bounded and bounds[j] + moved <= room
        bounds[j] = bounds[j] + moved if is_quick[j] else max(abs(low), abs(high))
    for begin in range(0, n_psi, CHUNK):
        n = min(CHUNK, n_psi - begin)
        if not has_siblings:
            _psi_chunk(headers, k, at, begin, n, q, 0, len(rows))
        next_run, next_split = run, split
        for j in range(len(rows)):
            row, part = rows[j], q[j]
            if has_siblings:
                part = whole[j][begin : begin + n]
            if is_quick[j] and n_splits == 0:
                next_run = refine_runs(row, part, np.int32(unit), plans.runs, run, n)
                continue
            if is_quick[j]:
                next_split, first = split + n, plans.places[step, 0] + begin
                next_run = split_runs(
                    row, part, np.int32(unit), plans.alphas[group, split:next_split], shift,
                    row[first : first + n], plans.runs, run,
                )  # fmt: skip
                continue
            largest = scale(part, n, unit)
            if largest < 0:
                return False
            next_run, next_split = _refine_chunk(
                row, part, n, begin, largest, plans, step, run, split,
                plans.alphas[group], largest_alpha, shift, low, high, scratch[3:],
            )  # fmt: skip
            if next_run < 0:
                return False
        run, split = next_run, next_split
    return True


@_jit
def _psi_chunk(
    headers: Headers, k: int, at: int, begin: int, n: int, q: I32, to: int, width: int
) -> None:
    """Integers begin .. begin + n of psi without siblings, in q (C, any) from `to` on.

    They are of `width` channels that are turned together; `at` is the list of the first.
    """
    n_psi = headers.counts[k, 1] + headers.counts[k, 2]
    for j in range(width):
        code, start = headers.codes[k, at + j], headers.starts[k, at + j]
        unpack_signed(code, headers.planes, start, n_psi, begin, n, q[j][to : to + n])
    if width == 3:
        turn_back(q[0][to : to + n], q[1][to : to + n], q[2][to : to + n])


@_jit
def _whole_psi(headers: Headers, k: int, at: int, n_psi: int, n_rows: int) -> I32:
    """All of them, (C, P): siblings may be far apart."""
    whole = np.empty((n_rows, n_psi), np.int32)
    for begin in range(0, n_psi, CHUNK):
        n = min(CHUNK, n_psi - begin)
        _psi_chunk(headers, k, at, begin, n, whole, begin, n_rows)
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
    parents, next_run = scratch[0], gather(row, plans.runs, run, scratch[0], n)
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
    scatter(parents, plans.runs, run, row, n)
    return next_run, next_split


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
    rows, kind, low, high, bounds = channels
    first, unit = plans.places[headers.steps[k], 0] + n_splits, tables.units[0, kind]
    q, sums = scratch[:3], np.zeros(3, np.int64)
    for begin in range(0, n_adds, CHUNK):
        n = min(CHUNK, n_adds - begin)
        for j in range(len(rows)):
            code, start = headers.codes[k, at + j], headers.starts[k, at + j]
            unpack_signed(code, headers.planes, start, n_adds, begin, n, q[j])
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
            bounds[j] = max(bounds[j], max(np.int64(most), -np.int64(least)))
    return True


@_jit
def _apply_picks(headers: Headers, k: int, plans: Plans, shown: I32) -> bool:
    """The picks of a packet (spec 7.4); False if one is past the entries that it may name."""
    step = headers.steps[k]
    first, run, drop = plans.places[step, 0], plans.places[step, 1], plans.places[step, 3]
    end, end_of_runs, end_of_drops = (
        plans.places[step + 1, 0], plans.places[step + 1, 1], plans.places[step + 1, 3],
    )  # fmt: skip
    n_psi = headers.counts[k, 1] + headers.counts[k, 2] if headers.flags[k] & FLAG_OF_CHANGED else 0
    code, start = headers.codes[k, 0], headers.starts[k, 0]
    if not picks(
        code, headers.planes, start, plans.runs[:, run:end_of_runs], n_psi, first,
        headers.n_entries[k], shown, n_psi + end - first,
    ):  # fmt: skip
        return False
    for slot in plans.drops[drop:end_of_drops]:
        shown[slot] = 0
    return True
