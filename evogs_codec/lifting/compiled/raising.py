"""The loops of `parents` and `splitting`: unions of moments, alphas, midpoints, splits.

Letters: n nodes or pairs, D channels, K alphas of a table, C channels that share an alpha.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import F32, F64, I64

__all__ = ["choose", "merge", "midpoints", "misfits", "split"]

_jit = jit(error_model="numpy")


@_jit
def merge(
    mass: F64,
    mean: F64,
    cov: F64,
    a: I64,
    b: I64,
    mass_out: F64,
    mean_out: F64,
    cov_out: F64,
) -> None:
    """`parents.merged` of the nodes a and b (n,), out."""
    for row in range(len(a)):
        i, j = a[row], b[row]
        both = mass[i] + mass[j]
        share = mass[i] / both if both > 0 else 0.5
        rest = 1 - share
        mass_out[row] = both
        for p in range(3):
            d = mean[p, i] - mean[p, j]
            mean_out[p, row] = mean[p, j] + share * d
            for q in range(p, 3):
                apart = d * (mean[q, i] - mean[q, j])
                sum_of = share * cov[p, q, i] + rest * cov[p, q, j] + share * rest * apart
                cov_out[p, q, row] = cov_out[q, p, row] = sum_of


@_jit
def misfits(
    c1: F64, c2: F64, wanted: F64, alphas: F64, weight: F64, too_large: float, most: float, out: F64
) -> None:
    """Misfit (K, n) of the parents of the pairs c1, c2 (C, n), out; infinite where psi is beyond.

    Arguments, several to a line:
        wanted: (C, n).
        weight: (n,).
        most: a psi from which on it is beyond.
    """
    for row in range(c1.shape[1]):
        for k in range(len(alphas)):
            alpha = alphas[k]
            total = 0.0
            is_beyond = False
            for c in range(len(c1)):
                parent = (c2[c, row] + alpha * c1[c, row]) / (1 + alpha)
                error = parent - wanted[c, row]
                total += (too_large if error > 0 else 1.0) * (error * error)
                is_beyond |= abs(c1[c, row] - parent) >= most
            out[k, row] = np.inf if is_beyond else weight[row] * total


@_jit
def choose(misfits: F64, prices: F64, index: I64, best: F64, counts: I64) -> None:
    """Take what costs least, the first of equal ones: (n,) its index, or K, and its cost, out.

    Arguments, several to a line:
        misfits: (K, n).
        prices: (K,) of the alphas.
        counts: (K + 1,) zeros, out.
    """
    n_alphas, n = misfits.shape
    for row in range(n):
        least, which = np.inf, n_alphas
        for k in range(n_alphas):
            cost = misfits[k, row] + prices[k]
            if cost < least:
                least, which = cost, k
        best[row], index[row] = least, which
        counts[which] += 1


@_jit
def midpoints(values: F64, c1: I64, c2: I64, parents: F64) -> None:
    """Parents (D, n), out, halfway between the columns c1 and c2 of `values`."""
    for channel in range(len(values)):
        row, to = values[channel], parents[channel]
        for pair in range(len(c1)):
            to[pair] = (row[c1[pair]] + row[c2[pair]]) / 2


@_jit
def split(
    values: F64,
    parent: I64,
    c1: I64,
    c2: I64,
    alpha: F64,
    group_of: I64,
    rounding: float,
    psi: F32,
    is_off: npt.NDArray[np.bool_],
) -> None:
    """Psi (D, n) of splits, out, and where a C2 is not what its split makes, out.

    Arguments, several to a line:
        values: (D, T) numbers of the nodes `parent`, `c1` and `c2`, each (n,).
        alpha: (5, n).
        group_of: (D,) row of `alpha` of each channel.
        rounding: of a number: what it may be off.
        is_off: (n,), in and out.
    """
    for channel in range(len(values)):
        row, to, own = values[channel], psi[channel], alpha[group_of[channel]]
        for pair in range(len(parent)):
            p, a, b = row[parent[pair]], row[c1[pair]], row[c2[pair]]
            step = np.float32(a - p)
            to[pair] = step
            off = abs(b - (p - own[pair] * np.float64(step)))
            is_off[pair] |= off > rounding * max(max(abs(p), abs(a)), abs(b))
