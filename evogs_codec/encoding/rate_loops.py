"""The loops of `rate_distortion.cheapest`, compiled: its integers without arrays for each option.

Optional: without numba the codec uses numpy, which gives the same integers. Logarithms come from
numpy for both, and no sum depends on its order.

Letters: C rows of n numbers, W bins of all rows together.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from evogs_codec.model.splats import F64, I64

__all__ = ["choose", "count"]

_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False)


@_jit
def count(u: F64, span: float, middles: I64, counts: I64) -> None:
    """Count all options of each number.

    Arguments, several to a line:
        u: (C, n) numbers in steps; those that round to `span` or more do not count.
        middles: (C,) the bin of 0 of each row.
        counts: (W,) zeros, out.
    """
    for row in range(len(u)):
        middle = middles[row]
        for value in u[row]:
            if not abs(np.rint(value)) < span:
                continue
            below = np.int64(np.floor(value))
            counts[middle + below] += 1
            counts[middle + below + 1] += 1
            if -1 < value < 1:  # all multiples are 0
                counts[middle] += 5
                continue
            for multiple in (2, 4, 8, 16):
                counts[middle + multiple * np.int64(np.rint(value / multiple))] += 1
            counts[middle] += 1


@_jit
def choose(
    u: F64, weights: F64, span: float, middles: I64, bits: F64, out: F64, counts: I64
) -> None:
    """Take the option of each number that costs least, the first of equal ones, and count it.

    Arguments, several to a line:
        u, span, middles: as of `count`; what does not count is left as it is.
        weights: (C, n) bits that a squared error of one step is worth.
        bits: (W,) of each integer.
        out: (C, n), out.
        counts: (W,) zeros, out.
    """
    for row in range(len(u)):
        middle = middles[row]
        for i in range(u.shape[1]):
            value = u[row, i]
            if not abs(np.rint(value)) < span:
                continue
            weight = weights[row, i]
            best = np.floor(value)
            off = best - value
            least = weight * (off * off) + bits[middle + np.int64(best)]
            option = best + 1
            off = option - value
            cost = weight * (off * off) + bits[middle + np.int64(option)]
            if cost < least:
                least, best = cost, option
            if not -1 < value < 1:  # else both 0 and all multiples are among the two
                for multiple in (2.0, 4.0, 8.0, 16.0):
                    option = multiple * np.rint(value / multiple)
                    off = option - value
                    cost = weight * (off * off) + bits[middle + np.int64(option)]
                    if cost < least:
                        least, best = cost, option
                if weight * (value * value) + bits[middle] < least:
                    best = 0.0
            out[row, i] = best
            counts[middle + np.int64(best)] += 1
