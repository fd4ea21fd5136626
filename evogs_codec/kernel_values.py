"""Values, compiled: lists to integers to grid units, grid units to floats (spec 7.1, 7.3, 7.6).

The innermost loops of `kernels`. Each is written so that it becomes vector code: int32 throughout,
a loop for each way of packing.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from evogs_codec.refine import MAX_DELTA
from evogs_codec.splats import F32, I32, U8

__all__ = ["float_rows", "inverse_ycocg", "scale", "unpack", "unzigzag"]

_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False)


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
def unzigzag(q: I32, n: int) -> None:
    """The first n of q, in place (spec 7.1)."""
    one = np.int32(1)
    for i in range(n):
        q[i] = (q[i] >> one) ^ -(q[i] & one)


@_jit
def inverse_ycocg(q: I32, n: int) -> None:
    """The first n of the rows Y Co Cg to R G B, in place (spec 7.1)."""
    one, first, second, third = np.int32(1), q[0], q[1], q[2]
    for i in range(n):
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
def float_rows(
    x: I32, origins: npt.NDArray[np.int64], scales: npt.NDArray[np.float64], out: F32
) -> None:
    """out[i, c] = binary32((origins[c] + x[c, i]) * scales[c]), rounded once (R-7.6-1).

    A block of splats at a time, so that what is written stays in cache while channels take turns.
    """
    n, block = x.shape[1], 128
    exact = True
    for origin in origins:
        exact = exact and origin == 0
    for begin in range(0, n, block):
        end = min(begin + block, n)
        for c in range(len(x)):
            row, to = x[c, begin:end], out[begin:end, c]
            if exact:  # a scale is a power of 2: the conversion is the only rounding
                factor = np.float32(scales[c])
                for i in range(end - begin):
                    to[i] = np.float32(row[i]) * factor
            else:
                origin, scale = np.float64(origins[c]), scales[c]
                for i in range(end - begin):
                    to[i] = np.float32((origin + np.float64(row[i])) * scale)
