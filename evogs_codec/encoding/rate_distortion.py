"""Trading accuracy for bits: the integers whose error and whose bits together cost least."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.alpha_tables import cheapest_alphas
from evogs_codec.model.arithmetic import AlphaTable
from evogs_codec.model.splats import F64, I64, U8

__all__ = ["ErrorWeights", "cheapest", "loops"]

MULTIPLES = (2, 4, 8, 16)  # tried beside the two nearest integers and 0, where errors matter little
PASSES = 3
SPAN = 1 << 12  # larger integers are rounded: they are few, and important
MAX_AWAY = max(MULTIPLES) // 2 + 1  # so far are options from the nearest integer, at most
TINY = 1e-300
UNSEEN_COUNT = 0.02  # of an occurrence, so that an integer that did not occur is possible
BINS = 2 * SPAN + 17  # integers that are possible


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

    Bits are those of an order-0 code of each row for the integers of the pass before; at first for
    all options, since what is an option of many is cheap to begin with.

    Args:
        u: (C, n) numbers in steps.
        weights: (C, n) bits that a squared error of one step is worth.
    """
    out = np.empty_like(u)
    if not out.size:
        return out
    found = loops()
    choose, count = (_choose, _count) if found is None else (found.choose, found.count)
    most = np.empty(len(u), np.int64)
    (_extents if found is None else found.extents)(u, SPAN, out, most)
    most += MAX_AWAY
    ends = np.cumsum(2 * most + 1)
    middles = ends - most - 1  # the bin of 0 of each row
    counts = np.zeros(ends[-1], np.int64)
    count(u, SPAN, middles, counts)
    for _ in range(PASSES):
        bits = _bits(counts, ends)
        counts = np.zeros_like(counts)
        choose(u, weights, SPAN, middles, bits, out, counts)
    return out


def loops() -> ModuleType | None:
    """The loops, compiled; None where numba, which is an extra, is missing."""
    try:
        from evogs_codec.encoding import rate_loops
    except ImportError:
        return None
    return rate_loops


def _bits(counts: I64, ends: I64) -> F64:
    """(W,) bits of each integer of the rows, which end at `ends`, by how often it occurs."""
    begins = np.append(0, ends[:-1])
    totals = np.add.reduceat(counts, begins) + UNSEEN_COUNT * BINS
    bits: F64 = -np.log2((counts + UNSEEN_COUNT) / np.repeat(totals, ends - begins))
    return bits


def _extents(u: F64, span: float, out: F64, most: I64) -> None:
    """`rate_loops.extents` in numpy."""
    np.rint(u, out=out)
    sizes = np.abs(out)
    sizes[sizes >= span] = 0
    most[:] = sizes.max(axis=1)


def _options(u: F64) -> list[F64]:
    below = np.floor(u)
    return [below, below + 1, *(m * np.rint(u / m) for m in MULTIPLES), np.zeros_like(u)]


def _count(u: F64, span: float, middles: I64, counts: I64) -> None:
    """`rate_loops.count` in numpy."""
    for row, middle in zip(u, middles, strict=True):
        near = np.concatenate(_options(row[np.abs(np.rint(row)) < span]))
        found = np.bincount(near.astype(np.int64) + middle)
        counts[: len(found)] += found


def _choose(
    u: F64, weights: F64, span: float, middles: I64, bits: F64, out: F64, counts: I64
) -> None:
    """`rate_loops.choose` in numpy."""
    for row, own, middle, to in zip(u, weights, middles, out, strict=True):
        near = np.abs(np.rint(row)) < span
        options = _options(row[near])
        costs = [
            own[near] * np.square(q - row[near]) + bits[q.astype(np.int64) + middle]
            for q in options
        ]
        best = np.choose(np.argmin(costs, axis=0), options)
        to[near] = best
        found = np.bincount(best.astype(np.int64) + middle)
        counts[: len(found)] += found
