"""The loops of `rate_distortion.cheapest`, compiled: its integers without arrays for each option.

Optional: without numba the codec uses numpy, which gives the same integers. Logarithms come from
numpy for both, and no sum depends on its order.

Letters: C rows of n numbers, W bins of all rows together.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import F64, I64

__all__ = ["apart", "choose", "count", "extents", "go_down", "go_up"]

_jit = jit()


@_jit
def extents(u: F64, span: float, out: F64, most: I64) -> None:
    """Round numbers, and tell how large those below `span` become.

    Arguments, several to a line:
        u: (C, n) numbers in steps.
        out: (C, n) the nearest integers, out.
        most: (C,) the largest magnitude of each row, out.
    """
    for row in range(len(u)):
        largest = 0.0
        for i in range(u.shape[1]):
            nearest = np.rint(u[row, i])
            out[row, i] = nearest
            size = abs(nearest)
            if size < span and size > largest:
                largest = size
        most[row] = np.int64(largest)


@_jit
def go_up(means: F64, worth: F64, first: I64, second: I64, pair: F64) -> None:
    """What two siblings are, and in the place of the first what they are together.

    Arguments, several to a line:
        means, worth: (C, P), in and out.
        first, second: (n,) records.
        pair: (4, C, n) means and worths of both, out.
    """
    for row in range(len(means)):
        for i in range(len(first)):
            a, b = first[i], second[i]
            pair[0, row, i], pair[1, row, i] = means[row, a], means[row, b]
            pair[2, row, i], pair[3, row, i] = worth[row, a], worth[row, b]
            means[row, a] = (means[row, a] + means[row, b]) / 2
            worth[row, a] = worth[row, a] + worth[row, b]


@_jit
def apart(pair: F64, psi: F64, first: I64, wanted: F64, both: F64) -> None:
    """What siblings should differ by, once it is known what they have in common.

    Arguments, several to a line:
        pair: (4, C, n) as of `go_up`.
        psi: (C, P) what the first ones hold so far.
        first: (n,) records.
        wanted, both: (C, n) the difference and its worth, out.
    """
    for row in range(len(psi)):
        for i in range(len(first)):
            common = psi[row, first[i]]
            sum_of = max(pair[2, row, i] + pair[3, row, i], 1e-300)
            both[row, i] = sum_of
            wanted[row, i] = (
                pair[2, row, i] * (pair[0, row, i] - common)
                - pair[3, row, i] * (pair[1, row, i] - common)
            ) / sum_of


@_jit
def go_down(psi: F64, differences: F64, first: I64, second: I64, d: F64) -> None:
    """Two siblings of what they have in common, in the place of the first, and of a difference.

    Arguments, several to a line:
        psi, differences: (C, P), in and out.
        first, second: (n,) records.
        d: (C, n).
    """
    for row in range(len(psi)):
        for i in range(len(first)):
            a, b = first[i], second[i]
            common = psi[row, a]
            psi[row, a], psi[row, b] = common + d[row, i], common - d[row, i]
            differences[row, b] = d[row, i]


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
