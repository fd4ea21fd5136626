"""Values, compiled: lists to integers to grid units, grid units to floats (spec 7.1, 7.3, 7.6).

The innermost loops of `channels`. Each is written so that it becomes vector code: int32 throughout,
a loop for each way of packing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.arithmetic import MAX_DELTA, MAX_PRODUCT
from evogs_codec.model.siblings import MAX_SIBLING
from evogs_codec.model.splats import F32, I32, I64, U8

__all__ = [
    "MAX_INT",
    "add_siblings",
    "children",
    "entries",
    "first_children",
    "float_picks",
    "float_rows",
    "inverse_ycocg",
    "picks",
    "products_fit",
    "scale",
    "second_children",
    "sum_siblings",
    "turn_back",
    "unpack",
    "unpack_signed",
    "unzigzag",
]

_jit = jit()
MAX_INT = 0x7FFFFFFF
BLOCK = 2048  # splats whose floats are written at a time
N_ASKED = 64  # rows of a palette that are read ahead


@_jit
def unpack(code: int, planes: U8, start: int, n_all: int, begin: int, n: int, out: I32) -> None:
    """Stored integers begin .. begin + n of a list of n_all (spec 7.1), each below 2**24."""
    low, high = np.int64(code) & 15, (np.int64(code) >> 4) & 3
    at, shift = start + begin, np.int32(low)
    if low == 1 or low == 2 or low == 4:
        at += (n_all * low + 7) // 8
        _unpack_low(planes[start + begin * low // 8 :], low, n, out)
    elif low:
        at += n_all
        part = planes[start + begin : start + begin + n]
        for i in range(n):
            out[i] = part[i]
    elif high:
        part = planes[at : at + n]
        for i in range(n):
            out[i] = part[i]
        at += n_all
        shift = np.int32(8)
        high -= 1
    else:
        out[:n] = 0
    for _ in range(high):
        part = planes[at : at + n]
        for i in range(n):
            out[i] |= np.int32(part[i]) << (shift & np.int32(31))
        at += n_all
        shift += np.int32(8)


@_jit
def _unpack_low(part: U8, low: int, n: int, out: I32) -> None:
    """The low bits of n values; a loop for each packing, so that each is a vector loop."""
    per_byte, mask = 8 // low, np.int32((1 << low) - 1)
    whole = n // per_byte
    if low == 4:
        for i in range(whole):
            byte = np.int32(part[i])
            out[2 * i], out[2 * i + 1] = byte & mask, byte >> np.int32(4)
    elif low == 2:
        for i in range(whole):
            byte = np.int32(part[i])
            for k in range(4):
                out[4 * i + k] = (byte >> np.int32(2 * k)) & mask
    else:
        for i in range(whole):
            byte = np.int32(part[i])
            for k in range(8):
                out[8 * i + k] = (byte >> np.int32(k)) & mask
    for i in range(whole * per_byte, n):
        out[i] = (np.int32(part[whole]) >> np.int32(low * (i - whole * per_byte))) & mask


@_jit
def unpack_signed(
    code: int, planes: U8, start: int, n_all: int, begin: int, n: int, out: I32
) -> None:
    """`unpack` and `unzigzag`, in one loop for the codings that most values have."""
    kind, one = np.int64(code) & 63, np.int32(1)
    if kind == 16:  # one plane of whole bytes
        part = planes[start + begin : start + begin + n]
        for i in range(n):
            byte = np.int32(part[i])
            out[i] = (byte >> one) ^ -(byte & one)
        return
    unpack(code, planes, start, n_all, begin, n, out)
    if kind:
        unzigzag(out, n)


@_jit
def unzigzag(q: I32, n: int) -> None:
    """The first n of q, in place (spec 7.1)."""
    one = np.int32(1)
    for i in range(n):
        q[i] = (q[i] >> one) ^ -(q[i] & one)


@_jit
def undelta(q: I32, n: int) -> bool:
    """Running sums of the first n of q, in place; False if one leaves its range (R-7.1-1)."""
    total = np.int64(0)
    for i in range(n):
        total += q[i]
        if total > MAX_DELTA or total < -MAX_DELTA:
            return False
        q[i] = np.int32(total)
    return True


@_jit
def sum_siblings(q: I32, siblings: I32, run: int, end: int) -> None:
    """The psi of sibling differences, in place; known to stay in range.

    Args:
        q: (P,) differences.
        siblings: (3, any) runs of records whose slots were born from slots of the step: the first
            record, the record of its sibling, and the length.
        run: the first of the step.
        end: the run after its last.
    """
    for k in range(run, end):
        begin, other, length = siblings[0, k], siblings[1, k], siblings[2, k]
        seconds, firsts = q[begin : begin + length], q[other : other + length]
        for i in range(length):
            d, common = seconds[i], firsts[i]
            seconds[i], firsts[i] = np.int32(common - d), np.int32(common + d)


@_jit
def add_siblings(q: I32, siblings: I32, run: int, end: int) -> bool:
    """`sum_siblings`; False if a number leaves its range (R-7.1-2)."""
    for k in range(run, end):
        begin, other, length = siblings[0, k], siblings[1, k], siblings[2, k]
        for i in range(length):
            d, common = np.int64(q[begin + i]), np.int64(q[other + i])
            second, first = common - d, common + d
            if max(abs(second), abs(first)) > MAX_SIBLING:
                return False
            q[begin + i], q[other + i] = np.int32(second), np.int32(first)
    return True


@_jit
def entries(codes: U8, starts: I64, planes: U8, is_ycocg: bool, units: I64, out: I32) -> bool:
    """Delta (C, n) of the entries of a packet (spec 7.1, 7.3); False if one leaves its range."""
    n = out.shape[1]
    for first in range(0, len(out), 3):
        triple = out[first : first + 3]
        for k in range(3):
            unpack_signed(codes[first + k], planes, starts[first + k], n, 0, n, triple[k])
            if codes[first + k] & 64 and not undelta(triple[k], n):
                return False
        if is_ycocg:
            inverse_ycocg(triple, n)
        for k in range(3):
            if scale(triple[k], n, units[first + k]) < 0:
                return False
    return True


@_jit
def picks(
    code: int,
    planes: U8,
    start: int,
    runs: I64,
    n_changed: int,
    first: int,
    n_entries: int,
    out: I32,
    n: int,
) -> bool:
    """The n picks of a packet to their slots in `out` (spec 7.4); False if one is too large.

    The first `n_changed` are of the slots in runs (2, any) of begins and lengths, the others of
    those from `first` on.
    """
    found = out[first : first + n]
    if n_changed:
        found = np.empty(n, np.int32)
    unpack(code, planes, start, n, 0, n, found)
    most = np.int32(0)
    for i in range(n):
        most = max(most, found[i])
    if most > n_entries:
        return False
    at = 0
    for r in range(runs.shape[1] if n_changed else 0):
        for slot in range(runs[0, r], runs[0, r] + runs[1, r]):
            out[slot] = found[at]
            at += 1
    if n_changed:
        out[first : first + n - n_changed] = found[n_changed:]
    return True


@_jit
def inverse_ycocg(q: I32, n: int) -> None:
    """The first n of the rows Y Co Cg to R G B, in place (spec 7.1)."""
    turn_back(q[0][:n], q[1][:n], q[2][:n])


@_jit
def turn_back(first: I32, second: I32, third: I32) -> None:
    """`inverse_ycocg` of three rows."""
    one = np.int32(1)
    for i in range(len(first)):
        y, co, cg = first[i], second[i], third[i]
        t = np.int32(y - (cg >> one))
        b = np.int32(t - (co >> one))
        first[i], second[i], third[i] = np.int32(b + co), np.int32(cg + t), b


@_jit
def scale(q: I32, n: int, unit: int) -> int:
    """Delta in place of q; the largest |Delta|, or -1 if it is over 2**28 (R-7.3-1)."""
    least, most = np.int32(0), np.int32(0)
    for i in range(n):
        least, most = min(least, q[i]), max(most, q[i])
    largest = max(np.int64(most), -np.int64(least))
    if largest > MAX_DELTA // unit:
        return -1
    if unit != 1 and largest:
        factor = np.int32(unit)
        for i in range(n):
            q[i] = np.int32(q[i] * factor)
    return largest * unit


@_jit
def products_fit(delta: I32, largest: int, alphas: I32, largest_alpha: int, shift: int) -> bool:
    """R-7.3-2 for a * delta; no |delta| is above `largest`, no |a| above `largest_alpha`."""
    room = MAX_PRODUCT - np.int64((1 << shift) >> 1)
    if largest * largest_alpha <= room:
        return True
    for i in range(len(alphas)):
        product = np.int64(delta[i]) * np.int64(alphas[i])
        if product > room or product < -room:
            return False
    return True


@_jit
def children(
    parents: I32, delta: I32, alphas: I32, shift: int, seconds: I32
) -> tuple[np.int32, np.int32]:
    """C1 in place of the parents of splits, and C2 (spec 7.3); (least, largest) of both.

    Products are known to fit.
    """
    half, bits = np.int32((1 << shift) >> 1), np.int32(shift & 31)
    least, most = np.int32(MAX_INT), np.int32(-MAX_INT)
    for i in range(len(seconds)):
        p, d = parents[i], delta[i]
        first = np.int32(p + d)
        product = np.int32(np.int32(alphas[i] * d) + half)
        second = np.int32(p - (product >> bits))
        parents[i], seconds[i] = first, second
        least, most = min(least, min(first, second)), max(most, max(first, second))
    return least, most


@_jit
def first_children(parents: I32, delta: I32, n: int) -> tuple[np.int32, np.int32]:
    """C1 in place of the first n parents; the least and the largest."""
    least, most = np.int32(MAX_INT), np.int32(-MAX_INT)
    for i in range(n):
        first = np.int32(parents[i] + delta[i])
        parents[i] = first
        least, most = min(least, first), max(most, first)
    return least, most


@_jit
def second_children(
    parents: I32, delta: I32, alphas: I32, shift: int, seconds: I32
) -> tuple[np.int32, np.int32]:
    """C2 of splits; the least and the largest. Products are known to fit."""
    half, bits = np.int32((1 << shift) >> 1), np.int32(shift & 31)
    least, most = np.int32(MAX_INT), np.int32(-MAX_INT)
    for i in range(len(seconds)):
        product = np.int32(np.int32(alphas[i] * delta[i]) + half)
        second = np.int32(parents[i] - (product >> bits))
        seconds[i] = second
        least, most = min(least, second), max(most, second)
    return least, most


def _writer(n_channels: int) -> Any:  # noqa: ANN401 - numba has no types
    """What writes so many channels as floats; a number that is known becomes vector code."""

    @_jit
    def write(x: I32, factor: np.float32, out: F32) -> None:
        for i in range(len(out)):
            for c in range(n_channels):
                out[i, c] = np.float32(x[c, i]) * factor

    return write


_write_12, _write_9, _write_4, _write_3, _write_1 = map(_writer, (12, 9, 4, 3, 1))


@_jit
def float_rows(x: I32, origins: I64, scale: float, out: F32) -> None:
    """out[i, c] = binary32((origins[c] + x[c, i]) * scale), rounded once (R-7.6-1).

    As many channels at a time as there are streams that a processor reads ahead, and a block of
    splats at a time, so that the lines of memory which channels share stay in cache.
    """
    n, n_channels = out.shape
    if origins[:n_channels].any():  # |O + X| is below 2**53, so binary64 holds it
        for i in range(n):
            for c in range(n_channels):
                out[i, c] = np.float32((np.float64(origins[c]) + np.float64(x[c, i])) * scale)
        return
    factor = np.float32(scale)  # a power of 2: the conversion is the only rounding
    for begin in range(0, n, BLOCK):
        part, to = x[:, begin : begin + BLOCK], out[begin : begin + BLOCK]
        at = 0
        while at < n_channels:
            left = n_channels - at
            if left % 12 == 0:
                _write_12(part[at : at + 12], factor, to[:, at : at + 12])
                at += 12
            elif left % 9 == 0:
                _write_9(part[at : at + 9], factor, to[:, at : at + 9])
                at += 9
            elif left % 4 == 0:
                _write_4(part[at : at + 4], factor, to[:, at : at + 4])
                at += 4
            elif left % 3 == 0:
                _write_3(part[at : at + 3], factor, to[:, at : at + 3])
                at += 3
            else:
                _write_1(part[at : at + 1], factor, to[:, at : at + 1])
                at += 1


@_jit
def float_picks(x: I32, scale: float, picks: I32, rows: Any, out: F32) -> int:  # noqa: ANN401
    """SH of splats with picks: out[i, :3] is x[:, i] * scale, of band 0, the rest a row * scale.

    Each line of memory is written once, from its begin to its end. Of some splats at a time the
    rows are first asked for, so that many come at once: their sum is returned for that alone.
    """
    n_rest, factor, asked = out.shape[1] - 3, np.float32(scale), np.int64(0)
    for begin in range(0, len(out), N_ASKED):
        end = min(begin + N_ASKED, len(out))
        for i in range(begin, end):
            asked += rows[picks[i], 0]
        for i in range(begin, end):
            row, to = rows[picks[i]], out[i]
            for c in range(3):
                to[c] = np.float32(x[c, i]) * factor
            for c in range(n_rest):
                to[3 + c] = np.float32(row[c]) * factor
    return asked
