"""Trading accuracy for bits: the integers whose error and whose bits together cost least."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.alpha_tables import cheapest_alphas
from evogs_codec.model.arithmetic import AlphaTable
from evogs_codec.model.splats import F64, I64, U8

__all__ = ["ErrorWeights", "cheapest"]

MULTIPLES = (2, 4, 8, 16)  # tried beside the two nearest integers and 0, where errors matter little
PASSES = 3
SPAN = 1 << 12  # larger integers are rounded: they are few, and important
TINY = 1e-300
UNSEEN = 0.02  # of an occurrence, so that an integer that did not occur is possible


@dataclass(frozen=True, eq=False)
class ErrorWeights:
    """Bits that the squared error of a step is worth: P refines and splits of a group, S splits.

    Attributes:
        targets: (C, P) of refined splats and C1s.
        new: (C, at least S) of C2s first.
    """

    targets: F64
    new: F64

    def choose(
        self, u: F64, v: F64, table: AlphaTable, splits: slice | npt.NDArray[Any]
    ) -> tuple[U8, F64]:
        """Indices (S,) of alphas and Delta (C, S), for children at P + u and P + v, in steps."""
        first, second = self.targets[:, splits], self.new[:, : u.shape[1]]
        indices = _alphas(u, v, first, second, table)
        alpha = table.values[indices]
        both = np.maximum(first + alpha * alpha * second, TINY)
        return indices, (first * u - alpha * second * v) / both

    def integers(
        self, u: F64, table: AlphaTable, indices: U8, splits: slice | npt.NDArray[Any]
    ) -> F64:
        """(C, P) integers for Delta `u`: an error of it is one of C1, and alpha times one of C2."""
        alpha = table.values[indices]
        both = self.targets.copy()
        both[:, splits] += np.square(alpha) * self.new[:, : len(alpha)]
        return cheapest(u, both)


def _alphas(u: F64, v: F64, first: F64, second: F64, table: AlphaTable) -> U8:
    """(S,) index of the alpha that costs least."""
    if len(table.entries) == 1 or not u.shape[1]:
        return np.zeros(u.shape[1], np.uint8)
    # Channels weigh in as they do on the average of the splits.
    shares = (first + second).sum(1, keepdims=True)
    shares *= len(u) / max(float(shares.sum()), TINY)
    w1, w2 = first.mean(0), second.mean(0)
    uu, uv, vv = ((shares * x).sum(0) for x in (u * u, u * v, v * v))

    def cost(a: float) -> F64:
        """What the best Delta leaves, and what rounding it adds."""
        both = np.maximum(w1 + a * a * w2, TINY)
        total: F64 = w1 * w2 / both * (vv + 2 * a * uv + a * a * uu) + both * (len(u) / 12.0)
        return total

    return cheapest_alphas(table, u.shape[1], cost, 1.0, passes=PASSES)


def cheapest(u: F64, weights: F64) -> F64:
    """(C, n) integers near `u`: least sum of weights times squared error, and of bits.

    Bits are those of an order-0 code of each row for the integers of the pass before.

    Args:
        u: (C, n) numbers in steps.
        weights: (C, n) bits that a squared error of one step is worth.
    """
    out = np.rint(u)
    for row in range(len(u)):
        near = np.abs(out[row]) < SPAN
        if near.any():
            out[row, near] = _row(u[row, near], weights[row, near])
    return out


def _row(u: F64, weights: F64) -> F64:
    below = np.floor(u)
    options = [below, below + 1, *(m * np.rint(u / m) for m in MULTIPLES), np.zeros_like(u)]
    best = np.concatenate(options)  # what is an option of many is cheap to begin with
    for _ in range(PASSES):
        bits = _bits(best)
        costs = [weights * np.square(q - u) + bits[_index(q)] for q in options]
        least = np.argmin(costs, axis=0)
        best = np.choose(least, options)
    return best


def _bits(q: F64) -> F64:
    """Bits of each integer of the span, by how often it occurs."""
    counts = np.bincount(_index(q), minlength=2 * SPAN + 17) + UNSEEN
    bits: F64 = -np.log2(counts / counts.sum())
    return bits


def _index(q: F64) -> I64:
    """Multiples may be a little beyond the span."""
    index: I64 = q.astype(np.int64) + SPAN + 8
    return index
