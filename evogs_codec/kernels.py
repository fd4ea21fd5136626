"""The hot loops of decoding, compiled: the integers of `refine` and `planes`, no temporaries.

Optional: without numba the codec uses numpy. A test holds the two to identical integers and faults.
Each function is the loop of spec 7.4 over one packet, planes in, slots out. Sums fit int32 by the
bounds of spec 7.3; products are made in int64, so nothing overflows before it is checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from evogs_codec.packets import Values
from evogs_codec.planes import MAX_SUM
from evogs_codec.refine import MAX_DELTA, MAX_PRODUCT, MAX_X, RangeError, StepPlan
from evogs_codec.splats import F32, I32, I64, U8

__all__ = ["apply_channels", "float_rows"]

_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False)
_OK, _BAD_SUM, _BAD_DELTA, _BAD_PRODUCT, _BAD_X, _BAD_BOX = range(6)
_MESSAGES = {
    _BAD_SUM: "a running sum of adds exceeds 2^28",
    _BAD_DELTA: "|Delta| exceeds 2^28",
    _BAD_PRODUCT: "|alpha * Delta| exceeds 2^30",
    _BAD_X: "|X| exceeds 2^30 - 1",
    _BAD_BOX: "a position is outside the box of its tile",
}


def apply_channels(
    x: I32,
    plan: StepPlan,
    psi: Values,
    adds: Values,
    steps: I64,
    alphas: Sequence[tuple[I32 | int, int]],
    limits: I64,
) -> None:
    """Apply a packet to the rows of its component (spec 7.4).

    Args:
        x: (C, n) rows of the component.
        plan: the step.
        psi: stored values of refines and splits.
        adds: stored values of adds.
        steps: (2, C) grid units of one q, of psi and of adds.
        alphas: per channel a, one of each split or one for all, and K.
        limits: (C, 2) least and largest X allowed.

    Raises:
        RangeError: a bound of spec 7.3 or R-7.1-1 is broken.
    """
    targets = plan.targets
    first = targets.start if isinstance(targets, slice) else 0
    indexes = _NONE if isinstance(targets, slice) else targets
    splits = _NONE if plan.splits is None else plan.splits
    stacked, place, shifts = _stack(alphas)
    status: int = _apply(
        x,
        first,
        indexes,
        splits,
        plan.splits is None,
        plan.n_before,
        plan.n_splits,
        psi.n,
        psi.codes,
        psi.data,
        psi.starts,
        psi.first_sh if psi.is_ycocg else len(x),
        adds.n,
        adds.codes,
        adds.data,
        adds.starts,
        adds.first_sh if adds.is_ycocg else len(x),
        steps,
        stacked,
        place,
        shifts,
        limits,
        plan.drops,
    )
    if status != _OK:
        raise RangeError(_MESSAGES[status])


_NONE = np.empty(0, np.int64)


def _stack(alphas: Sequence[tuple[I32 | int, int]]) -> tuple[I32, I64, I64]:
    """(alphas of all channels one after the other, (C, 2) start and 0 or 1 between splits, K)."""
    parts: list[I32] = []
    found: dict[int, tuple[int, int]] = {}
    total = 0
    place = np.empty((len(alphas), 2), np.int64)
    for channel, (a, _) in enumerate(alphas):
        if id(a) not in found:  # the channels of a group share theirs
            part = np.array([a], np.int32) if isinstance(a, int) else a
            found[id(a)] = (total, 0 if isinstance(a, int) else 1)
            parts.append(part)
            total += len(part)
        place[channel] = found[id(a)]
    shifts = np.array([shift for _, shift in alphas], np.int64)
    return np.concatenate(parts), place, shifts


@_jit
def _low_bits(low: int, data: U8, at: int, n: int, out: I32) -> None:
    """The low plane of a list; a loop for each packing, so that each is a vector loop."""
    if low == 4:
        for i in range(n >> 1):
            byte = np.int32(data[at + i])
            out[2 * i] = byte & np.int32(15)
            out[2 * i + 1] = byte >> np.int32(4)
        if n & 1:
            out[n - 1] = data[at + (n >> 1)] & 15
    elif low == 2:
        for i in range(n >> 2):
            byte = np.int32(data[at + i])
            out[4 * i] = byte & np.int32(3)
            out[4 * i + 1] = (byte >> np.int32(2)) & np.int32(3)
            out[4 * i + 2] = (byte >> np.int32(4)) & np.int32(3)
            out[4 * i + 3] = byte >> np.int32(6)
        for i in range(n & ~3, n):
            out[i] = (np.int32(data[at + (n >> 2)]) >> np.int32(2 * (i & 3))) & np.int32(3)
    elif low == 1:
        for i in range(n):
            out[i] = (np.int32(data[at + (i >> 3)]) >> np.int32(i & 7)) & np.int32(1)
    else:
        for i in range(n):
            out[i] = data[at + i]


@_jit
def _stored(code: int, data: U8, start: int, n: int, out: I32) -> None:
    """Unpack and unzigzag a list of n values (spec 7.1); stored values are below 2**24."""
    low, high = code & 15, (code >> 4) & 3
    one, at = np.int32(1), start
    if low == 0 and high == 1:
        for i in range(n):
            z = np.int32(data[at + i])
            out[i] = (z >> one) ^ -(z & one)
        return
    if low == 0:
        out[:n] = 0
    else:
        _low_bits(low, data, at, n, out)
        at += (n * low + 7) // 8 if low == 1 or low == 2 or low == 4 else n
    shift = np.int32(low)
    if high == 2:
        for i in range(n):
            out[i] |= np.int32(data[at + i]) << shift
        at += n
        shift += np.int32(8)
    if high:
        for i in range(n):
            z = out[i] | (np.int32(data[at + i]) << shift)
            out[i] = (z >> one) ^ -(z & one)
    else:
        for i in range(n):
            z = out[i]
            out[i] = (z >> one) ^ -(z & one)


@_jit
def _integers(
    channel: int, codes: U8, data: U8, starts: I64, first_sh: int, n: int, out: I32
) -> int:
    """Put q of a channel, or of the three of a triple, into `out`; how many, or -1 for a fault."""
    count = 3 if channel >= first_sh else 1
    for k in range(count):
        row = out[k]
        _stored(codes[channel + k], data, starts[channel + k], n, row)
        if codes[channel + k] & 64:
            total = np.int64(0)
            for i in range(n):
                total += row[i]
                if total > MAX_SUM or total < -MAX_SUM:
                    return -1
                row[i] = total
    if count == 3:
        one = np.int32(1)
        for i in range(n):
            y, co, cg = out[0, i], out[1, i], out[2, i]
            t = y - (cg >> one)
            b = t - (co >> one)
            out[0, i], out[1, i], out[2, i] = b + co, cg + t, b
    return count


@_jit
def _scale(q: I32, n: int, step: int, bits: int) -> bool:
    """Delta in place of q, of which |q| <= 2**bits is known; False if one is out of range."""
    if (1 << bits) > MAX_DELTA // step:
        largest = np.int32(0)
        for i in range(n):
            largest = max(largest, abs(q[i]))
        if largest > MAX_DELTA // step:
            return False
    if step != 1:
        factor = np.int32(step & 0x7FFFFFFF)  # a larger step leaves only zeros
        for i in range(n):
            q[i] *= factor
    return True


@_jit
def _known_bits(code: int, count: int) -> int:
    """|q| <= 2**bits by the coding alone; a triple and running sums may be larger."""
    if count == 3 or code & 64:
        return 30
    return (code & 15) + 8 * ((code >> 4) & 3)


@_jit
def _refine_channel(
    row: I32,
    delta: I32,
    n_psi: int,
    first: int,
    indexes: I64,
    splits: I64,
    all_split: bool,
    n_before: int,
    n_splits: int,
    alpha: I32,
    a_at: int,
    a_stride: int,
    shift: int,
    low: int,
    high: int,
) -> int:
    """Refines and splits of one channel (spec 7.3), in int32 once the products are known to fit."""
    room = MAX_PRODUCT - ((1 << shift) >> 1)
    half, bits = np.int32((1 << shift) >> 1), np.int32(shift)
    contiguous = len(indexes) == 0
    constant = np.int32(alpha[a_at]) if n_splits else np.int32(1)
    symmetric = a_stride == 0 and constant == 1 and shift == 0
    for j in range(0 if symmetric else n_splits):
        product = np.int64(alpha[a_at + j * a_stride]) * np.int64(
            delta[j] if all_split else delta[splits[j]]
        )
        if product > room or product < -room:
            return _BAD_PRODUCT
    least, most = np.int32(0x7FFFFFFF), np.int32(-0x7FFFFFFF)
    if all_split and contiguous and symmetric:
        for i in range(n_psi):
            p, d = row[first + i], delta[i]
            new, second = p + d, p - d
            row[first + i] = new
            row[n_before + i] = second
            least, most = min(least, min(new, second)), max(most, max(new, second))
    elif all_split and symmetric:
        for i in range(n_psi):
            p, d = row[indexes[i]], delta[i]
            new, second = p + d, p - d
            row[indexes[i]] = new
            row[n_before + i] = second
            least, most = min(least, min(new, second)), max(most, max(new, second))
    elif all_split:
        for i in range(n_psi):
            slot = first + i if contiguous else indexes[i]
            p, d = row[slot], delta[i]
            a = alpha[a_at + i * a_stride]
            new, second = p + d, p - ((a * d + half) >> bits)
            row[slot] = new
            row[n_before + i] = second
            least, most = min(least, min(new, second)), max(most, max(new, second))
    else:
        for j in range(n_splits):  # C2 first: it needs P, which C1 replaces
            i = splits[j]
            p = row[first + i] if contiguous else row[indexes[i]]
            second = p - ((alpha[a_at + j * a_stride] * delta[i] + half) >> bits)
            row[n_before + j] = second
            least, most = min(least, second), max(most, second)
        for i in range(n_psi):
            slot = first + i if contiguous else indexes[i]
            new = row[slot] + delta[i]
            row[slot] = new
            least, most = min(least, new), max(most, new)
    if n_psi and (least < low or most > high):
        return _BAD_BOX if high < MAX_X else _BAD_X
    return _OK


@_jit
def _apply(
    x: I32,
    first: int,
    indexes: I64,
    splits: I64,
    all_split: bool,
    n_before: int,
    n_splits: int,
    n_psi: int,
    psi_codes: U8,
    psi_data: U8,
    psi_starts: I64,
    psi_first_sh: int,
    n_adds: int,
    adds_codes: U8,
    adds_data: U8,
    adds_starts: I64,
    adds_first_sh: int,
    steps: I64,
    alpha: I32,
    place: I64,
    shifts: I64,
    limits: I64,
    drops: I64,
) -> int:
    n_channels = len(x)
    q = np.empty((3, max(n_psi, n_adds, 1)), np.int32)
    channel = 0
    while channel < n_channels and n_psi:
        count = _integers(channel, psi_codes, psi_data, psi_starts, psi_first_sh, n_psi, q)
        if count < 0:
            return _BAD_SUM
        for k in range(count):
            c = channel + k
            if not _scale(q[k], n_psi, steps[0, c], _known_bits(psi_codes[c], count)):
                return _BAD_DELTA
            status: int = _refine_channel(
                x[c],
                q[k],
                n_psi,
                first,
                indexes,
                splits,
                all_split,
                n_before,
                n_splits,
                alpha,
                place[c, 0],
                place[c, 1],
                shifts[c],
                limits[c, 0],
                limits[c, 1],
            )
            if status != _OK:
                return status
        channel += count
    channel = 0
    at = n_before + n_splits
    while channel < n_channels and n_adds:
        count = _integers(channel, adds_codes, adds_data, adds_starts, adds_first_sh, n_adds, q)
        if count < 0:
            return _BAD_SUM
        for k in range(count):
            c = channel + k
            if not _scale(q[k], n_adds, steps[1, c], _known_bits(adds_codes[c], count)):
                return _BAD_DELTA
            least, most = np.int32(0x7FFFFFFF), np.int32(-0x7FFFFFFF)
            for i in range(n_adds):
                x[c, at + i] = q[k, i]
                least, most = min(least, q[k, i]), max(most, q[k, i])
            if least < limits[c, 0] or most > limits[c, 1]:
                return _BAD_BOX if limits[c, 1] < MAX_X else _BAD_X
        channel += count
    for c in range(n_channels):
        for slot in drops:
            x[c, slot] = 0
    return _OK


@_jit
def float_rows(
    x: I32, rows: I64, origins: npt.NDArray[np.int64], scales: npt.NDArray[np.float64], out: F32
) -> None:
    """out[i, c] = binary32((origins[c] + x[c, rows[i]]) * scales[c]), rounded once (R-7.6-1).

    A block of splats at a time, so that what is written stays in cache while channels take turns.
    """
    n, block = len(rows), 128
    for begin in range(0, n, block):
        end = min(begin + block, n)
        for c in range(out.shape[1]):
            row, origin, scale = x[c], origins[c], scales[c]
            for i in range(begin, end):
                out[i, c] = np.float32((origin + row[rows[i]]) * scale)
