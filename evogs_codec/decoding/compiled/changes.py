"""The psi of packets, compiled: refines and splits of the slots of channels (spec 7.3).

Of a packet `CHUNK` records are taken at a time. Sums fit int32 by the bounds of spec 7.3; products
are bounded before they are made.

Letters: P records with psi, S splits, A adds, all of one step; C channels that are turned together,
1 or 3.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.decoding.compiled.headers import Headers
from evogs_codec.decoding.compiled.plans import CHUNK, SH_GROUP, Channels, Plans, Tables
from evogs_codec.decoding.compiled.runs import gather, refine_runs, scatter, split_runs
from evogs_codec.decoding.compiled.values import (
    MAX_INT,
    add_siblings,
    children,
    first_children,
    products_fit,
    scale,
    second_children,
    sum_siblings,
    turn_back,
    unpack_signed,
)
from evogs_codec.model.arithmetic import MAX_DELTA, MAX_PRODUCT
from evogs_codec.model.siblings import MAX_SIBLING
from evogs_codec.model.splats import I32, U8

__all__ = ["apply_psi"]

_jit = jit()


@_jit
def apply_psi(
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
    """`apply_psi` of channels that are turned together; no |q| but of siblings is above a bound.

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
