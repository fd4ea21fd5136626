"""The hot loops of decoding, compiled: the integers of `refine` and `planes`, no temporaries.

Optional: without numba the codec uses numpy. A test holds the two to identical integers and faults.
Packets are applied a channel and `CHUNK` records at a time, so that what lies between planes and
slots stays in the nearest cache. Like `kernel_headers` it knows no faults: where a rule is broken
it gives up, and the numpy code finds out which. Sums fit int32 by the bounds of spec 7.3; products
are bounded before they are made.

Over 400 lines: it is one loop over packets, channels and records, read from the top down; what it
does with single values is in `kernel_values`.

Letters: P records with psi, S splits, A adds, all of one step; C channels of a component.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from evogs_codec.kernel_headers import MAX_LISTS, N_SIDES, read_headers
from evogs_codec.kernel_values import float_rows, inverse_ycocg, scale, unpack, unzigzag
from evogs_codec.planes import MAX_SUM
from evogs_codec.refine import MAX_PRODUCT, MAX_X
from evogs_codec.splats import I32, I64, U8
from evogs_codec.tree import Kind

__all__ = [
    "MAX_LISTS",
    "Headers",
    "Plans",
    "Tables",
    "apply_packets",
    "float_rows",
    "read_headers",
]

_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False)
CHUNK = 4096  # a multiple of 8, so that packed planes begin a byte with each chunk
REFINE, SPLIT, DROP = int(Kind.REFINE), int(Kind.SPLIT), int(Kind.DROP)
N_CORE, N_GROUPS, SH_GROUP = 14, 5, 4
NO_CONSTANT = 1 << 20  # where the a of the splits differ
MAX_INT = 0x7FFFFFFF


class Headers(NamedTuple):
    """The packets to apply, in order: rows of the packet table and what `read_headers` found.

    Attributes:
        components, steps: (K,) of each packet.
        levels: (K,) label of its step.
        counts: (K, 4) adds, splits, refines, drops of its step.
        codes, starts, flags: (K, MAX_LISTS), (K, MAX_LISTS), (K,).
        planes: all planes.
    """

    components: I64
    steps: I64
    levels: I64
    counts: I64
    codes: U8
    starts: I64
    flags: I64
    planes: U8


class Tables(NamedTuple):
    """Quantisers, alpha tables and the box of a tile.

    Attributes:
        units: (1 + n_levels, classes) grid units of one q: of adds, of psi of each level.
        alphas: the entries of all alpha tables, one after the other.
        alpha_places: (n_levels, 5, 3) first entry, number of entries, K.
        box: (3, 2) least and largest position.
    """

    units: I64
    alphas: I32
    alpha_places: I64
    box: I64


class Plans(NamedTuple):
    """Where the core steps of a tile act; the packets of the bands use it again.

    Attributes:
        places: (1 + steps, 5) slots before the step; where its `runs`, `splits` and `drops` begin;
            P of the step before.
        runs: (2, n) first slot and length of runs of slots of P; none crosses a chunk of P.
        splits: (n,) which of P are splits.
        drops: (n,) slots of the drops.
        alphas: (5, n) a of the splits per group, where they differ.
        constants: (steps, 5) a of all splits of a step, or NO_CONSTANT.
    """

    places: I64
    runs: I64
    splits: I64
    drops: I64
    alphas: I32
    constants: I64

    @staticmethod
    def empty(n_steps: int, n_records: int, n_splits: int) -> Plans:
        """Room for the core steps of a tile."""
        n_runs = n_records + n_records // CHUNK + n_steps
        return Plans(
            np.zeros((n_steps + 1, 5), np.int64),
            np.empty((2, n_runs), np.int64),
            np.empty(n_splits, np.int64),
            np.empty(n_records - n_splits, np.int64),
            np.empty((N_GROUPS, n_splits), np.int32),
            np.empty((n_steps, N_GROUPS), np.int64),
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
    scratch = np.empty((7, CHUNK), np.int32)
    for k in range(len(headers.components)):
        component, step = headers.components[k], headers.steps[k]
        if not _bits_are_plain(headers, k):
            return False
        if component == 0:
            if not _read_records(headers, k, tables, plans, live, born_from):
                return False
            rows = x[:N_CORE]
        else:
            first = 11 + 3 * component * component
            rows = x[first : first + 3 * (2 * component + 1)]
        n_adds, n_splits, n_refines, n_drops = headers.counts[k]
        if n_splits + n_refines and not _apply_psi(headers, k, tables, plans, rows, scratch):
            return False
        if n_adds and not _apply_adds(headers, k, tables, plans, rows, scratch):
            return False
        begin = plans.places[step, 3]
        for slot in plans.drops[begin : begin + n_drops]:
            rows[:, slot] = 0
    return True


@_jit
def _bits_are_plain(headers: Headers, k: int) -> bool:
    """R-5.9-9 for the lists of a packet."""
    for j in range(headers.codes.shape[1]):
        low = np.int64(headers.codes[k, j]) & 15
        if low == 0 or low == 8:
            continue
        n, start = _list_length(headers, k, j), headers.starts[k, j]
        if low == 1 or low == 2 or low == 4:
            used = n * low % 8
            if used and headers.planes[start + n * low // 8] >> used:
                return False
        else:
            largest = np.uint8(0)
            for value in headers.planes[start : start + n]:
                largest = max(largest, value)
            if largest >> low:
                return False
    return True


@_jit
def _list_length(headers: Headers, k: int, j: int) -> int:
    """Integers of a list that is stored (spec 5.9)."""
    n_adds, n_splits, n_refines, n_drops = headers.counts[k]
    component = headers.components[k]
    n_channels, first = 3 * (2 * component + 1), 0
    if component == 0:
        n_channels, first = N_CORE, N_SIDES
        if j < 2:
            return n_splits + n_refines + n_drops
        if j < N_SIDES:
            return n_splits
    return n_splits + n_refines if j < first + n_channels else n_adds


@_jit
def _read_records(
    headers: Headers,
    k: int,
    tables: Tables,
    plans: Plans,
    live: npt.NDArray[np.bool_],
    born_from: I32,
) -> bool:
    """Slots, kinds and alpha of a core packet into `plans`; changes which slots are live."""
    step, planes = headers.steps[k], headers.planes
    n_adds, n_splits, n_refines, n_drops = headers.counts[k]
    n_records, codes, starts = n_splits + n_refines + n_drops, headers.codes[k], headers.starts[k]
    n_before, run, split, drop, _ = plans.places[step]
    at_split, at_drop, n_psi = split, drop, 0
    kind = SPLIT if n_splits else DROP if n_drops else REFINE
    has_kinds = (n_splits > 0) + (n_refines > 0) + (n_drops > 0) > 1
    gaps, kinds = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.int32)
    slot, end_of_run = np.int64(-1), np.int64(-1)
    for begin in range(0, n_records, CHUNK):
        n = min(CHUNK, n_records - begin)
        unpack(codes[0], planes, starts[0], n_records, begin, n, gaps)
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
        first, n_entries, _ = tables.alpha_places[headers.levels[k], group]
        plans.constants[step, group] = tables.alphas[first]
        if codes[2 + group] == 0:
            continue
        plans.constants[step, group] = NO_CONSTANT
        for begin in range(0, n_splits, CHUNK):
            n = min(CHUNK, n_splits - begin)
            unpack(codes[2 + group], planes, starts[2 + group], n_splits, begin, n, gaps)
            for i in range(n):
                if gaps[i] >= n_entries:  # R-7.2-3
                    return False
                plans.alphas[group, split + begin + i] = tables.alphas[first + gaps[i]]
    plans.places[step + 1] = n_before + n_splits + n_adds, run, at_split, at_drop, n_psi
    live[n_before : n_before + n_splits + n_adds] = True
    born_from[n_before + n_splits : n_before + n_splits + n_adds] = -1
    for slot in plans.drops[drop:at_drop]:
        live[slot] = False
    return True


@_jit
def _class_of(component: int, channel: int) -> int:
    """Spec 3.2: class of a channel of a component."""
    if component:
        return 4 + component
    return (
        0 if channel < 3 else 1 if channel < 7 else 2 if channel < 10 else 3 if channel < 11 else 4
    )


@_jit
def _apply_psi(
    headers: Headers, k: int, tables: Tables, plans: Plans, rows: I32, scratch: I32
) -> bool:
    """Refines and splits of all channels of a component."""
    component, step, level = headers.components[k], headers.steps[k], headers.levels[k]
    n_psi = headers.counts[k, 1] + headers.counts[k, 2]
    first_sh, at = (0, 0) if component else (11, N_SIDES)
    if not headers.flags[k] & 1:
        first_sh = len(rows)
    channel, q = 0, scratch[:3]
    while channel < len(rows):
        count = 3 if channel >= first_sh else 1
        kind = _class_of(component, channel)
        group, unit = min(kind, SH_GROUP), tables.units[1 + level, kind]
        shift, constant = tables.alpha_places[level, group, 2], plans.constants[step, group]
        low, high = -np.int64(MAX_X), np.int64(MAX_X)
        if kind == 0:
            low, high = tables.box[channel]
        run, split = plans.places[step, 1], plans.places[step, 2]
        for begin in range(0, n_psi, CHUNK):
            n = min(CHUNK, n_psi - begin)
            for j in range(count):
                code, start = (
                    headers.codes[k, at + channel + j],
                    headers.starts[k, at + channel + j],
                )
                unpack(code, headers.planes, start, n_psi, begin, n, q[j])
                unzigzag(q[j], n)
            if count == 3:
                inverse_ycocg(q, n)
            next_run, next_split = run, split
            for j in range(count):
                largest = scale(q[j], n, unit)
                if largest < 0:
                    return False
                next_run, next_split = _refine_chunk(
                    rows[channel + j], q[j], n, begin, largest, plans, step, run, split,
                    plans.alphas[group], constant, shift, low, high, scratch[3:],
                )  # fmt: skip
                if next_run < 0:
                    return False
            run, split = next_run, next_split
        channel += count
    return True


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
    constant: int,
    shift: int,
    low: int,
    high: int,
    scratch: I32,
) -> tuple[int, int]:
    """Records begin .. begin + n of P in one channel (spec 7.3); (next run, next split) or (-1, 0).

    `largest` is the largest |Delta|; `run` and `split` are the first of the chunk.
    """
    parents, i, next_run = scratch[0], 0, run
    while i < n:
        slot, length = plans.runs[0, next_run], plans.runs[1, next_run]
        to, part = parents[i : i + length], row[slot : slot + length]
        for j in range(length):
            to[j] = part[j]
        i += length
        next_run += 1
    least, most = np.int32(MAX_INT), np.int32(-MAX_INT)
    for i in range(n):
        new = np.int32(parents[i] + delta[i])
        least, most = min(least, new), max(most, new)
    i = 0
    for r in range(run, next_run):
        slot, length = plans.runs[0, r], plans.runs[1, r]
        old, of, part = parents[i : i + length], delta[i : i + length], row[slot : slot + length]
        for j in range(length):
            part[j] = old[j] + of[j]
        i += length

    next_split = _first_split(plans, step, split, begin + n)
    n_splits, of_split = next_split - split, delta
    if 0 < n_splits < n:
        parents, of_split = scratch[1], scratch[2]
        for j in range(n_splits):
            i = plans.splits[split + j] - begin
            parents[j], of_split[j] = scratch[0, i], delta[i]
    at = plans.places[step, 0] + split - plans.places[step, 2]
    seconds = row[at : at + n_splits]
    if not _second_children(
        parents, of_split, largest, alphas[split:next_split], constant, shift, seconds
    ):
        return -1, 0
    for i in range(n_splits):
        least, most = min(least, seconds[i]), max(most, seconds[i])
    if least < low or most > high:
        return -1, 0
    return next_run, next_split


@_jit
def _first_split(plans: Plans, step: int, split: int, record: int) -> int:
    """The first of the splits of a step, from `split` on, that is at `record` of P or later."""
    end = plans.places[step + 1, 2]
    if end - plans.places[step, 2] == plans.places[step + 1, 4]:  # all P are splits
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
def _second_children(
    parents: I32, delta: I32, largest: int, alphas: I32, constant: int, shift: int, out: I32
) -> bool:
    """C2 = parents - RoundShift(a * delta, shift); False if a product is too large (R-7.3-2)."""
    half, bits = np.int32((1 << shift) >> 1), np.int32(shift)
    room, a = MAX_PRODUCT - np.int64(half), np.int32(constant)
    differ = constant == NO_CONSTANT
    largest_a = np.int64(abs(a))
    if differ:
        largest_a = np.int64(0)
        for value in alphas:
            largest_a = max(largest_a, abs(np.int64(value)))
    if largest * largest_a > room:
        for i in range(len(out)):
            product = np.int64(delta[i]) * np.int64(alphas[i] if differ else a)
            if product > room or product < -room:
                return False
    if differ:
        for i in range(len(out)):
            product = np.int32(np.int32(alphas[i] * delta[i]) + half)
            out[i] = np.int32(parents[i] - (product >> (bits & np.int32(31))))
    elif constant == 1 and shift == 0:
        for i in range(len(out)):
            out[i] = np.int32(parents[i] - delta[i])
    else:
        for i in range(len(out)):
            product = np.int32(np.int32(a * delta[i]) + half)
            out[i] = np.int32(parents[i] - (product >> (bits & np.int32(31))))
    return True


@_jit
def _apply_adds(
    headers: Headers, k: int, tables: Tables, plans: Plans, rows: I32, scratch: I32
) -> bool:
    """Adds of all channels of a component."""
    component, step = headers.components[k], headers.steps[k]
    n_adds, n_splits, _, _ = headers.counts[k]
    first_sh, at = (0, len(rows)) if component else (11, N_SIDES + N_CORE)
    if not headers.flags[k] & 2:
        first_sh = len(rows)
    channel, q, sums = 0, scratch[:3], np.empty(3, np.int64)
    while channel < len(rows):
        count = 3 if channel >= first_sh else 1
        kind = _class_of(component, channel)
        low, high = -np.int64(MAX_X), np.int64(MAX_X)
        if kind == 0:
            low, high = tables.box[channel]
        sums[:] = 0
        for begin in range(0, n_adds, CHUNK):
            n = min(CHUNK, n_adds - begin)
            for j in range(count):
                code, start = (
                    headers.codes[k, at + channel + j],
                    headers.starts[k, at + channel + j],
                )
                unpack(code, headers.planes, start, n_adds, begin, n, q[j])
                unzigzag(q[j], n)
                if code & 64:
                    for i in range(n):
                        sums[j] += q[j, i]
                        if sums[j] > MAX_SUM or sums[j] < -MAX_SUM:  # R-7.1-1
                            return False
                        q[j, i] = sums[j]
            if count == 3:
                inverse_ycocg(q, n)
            to = plans.places[step, 0] + n_splits + begin
            for j in range(count):
                if scale(q[j], n, tables.units[0, kind]) < 0:
                    return False
                least, most, row = (
                    np.int32(MAX_INT),
                    np.int32(-MAX_INT),
                    rows[channel + j, to : to + n],
                )
                for i in range(n):
                    row[i] = q[j, i]
                    least, most = min(least, q[j, i]), max(most, q[j, i])
                if least < low or most > high:
                    return False
        channel += count
    return True
