"""The k-d tree that says which tile a position is in.

Tiles have about as many splats each, unless splats of other sizes are apart from the others.

Letters: n points, T tiles, M nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32, F64, I64

__all__ = ["Split", "Tree"]

MAX_BLOCK = 8  # tiles of a neighbourhood at most, if none is halved or cut between sizes
# Tiles are cut between sizes where that saves so many bits a splat. Scenes of one scale save up to
# 3, an object of 5 cm in a kilometre of city 8 to 30; the next cuts, around it, save less.
FIRST_BITS, NEXT_BITS = 6.0, 3.0
EXTREME_SIZES = (2, 98)  # percentiles of the sizes: those beyond them count as these
FINEST = 1 << 40  # what the smallest splats weigh: sums over a sample fit 64 bits
SPARE = 0.1  # of a tile: a part with no more than that beyond whole tiles gets no other one

# Of a tree: the number of a tile; or an axis, the value below which positions are in the first of
# two parts, and these.
Split: TypeAlias = "int | tuple[int, float, Split, Split]"


@dataclass(frozen=True, eq=False)
class Tree:
    """A k-d tree.

    Attributes:
        axis: (M,) of every node, -1 of a leaf.
        value: (M,) positions below it are left.
        child: (M,) the left child, before the right one; of a leaf the number of its tile.
        origins: (T, 3) a point in the middle of each tile, multiples of a power of two.
        blocks: (T,) number of the neighbourhood of each tile; those of one are next to each other.
    """

    axis: npt.NDArray[np.int8]
    value: F64
    child: I64
    origins: F64
    blocks: I64

    @staticmethod
    def of(
        sample: F64,
        n_tiles: int,
        sizes: F32 | None = None,
        reach: float = np.inf,
        least: int = 1,
    ) -> Tree:
        """Over a sample (n, 3) of the points, each tile with about as many of them.

        Args:
            sample: of the points.
            n_tiles: tiles wanted. There are more where splats of other sizes are apart.
            sizes: (n,) mean log-scales of their splats; None: all alike.
            reach: a tile that is wider is halved.
            least: points of the sample. A tile is halved for its width while it has more, and a
                cut between sizes leaves at least so many in each part.
        """
        axis, value, child = [-1], [0.0], [0]
        middles: list[F64] = []
        blocks: list[int] = []
        n_blocks = 0
        logs = np.zeros(len(sample)) if sizes is None else sizes.astype(np.float64)
        todo = [(0, np.arange(len(sample)), n_tiles, False, FIRST_BITS)]
        while todo:
            node, rows, n, is_inside, bits = todo.pop()
            points = sample[rows]
            n_blocks += n <= MAX_BLOCK and not is_inside
            is_inside = n <= MAX_BLOCK
            parts = n // 2, n - n // 2
            split = _between_sizes(points, logs[rows], least, bits)
            if split is not None:
                bits = NEXT_BITS
                share = float(np.mean(points[:, split[0]] < split[1]))
                parts = math.ceil(n * share - SPARE), math.ceil(n * (1 - share) - SPARE)
            elif n > 1:
                split = _split(points, n)
            else:
                split = _halves(points, reach, least)
            if split is None:
                child[node] = len(middles)
                low = points.min(axis=0) if len(points) else np.zeros(3)
                high = points.max(axis=0) if len(points) else np.zeros(3)
                middles.append((low + high) / 2)
                blocks.append(n_blocks)
                continue
            axis[node], value[node] = split
            child[node] = len(axis)
            axis += [-1, -1]
            value += [0.0, 0.0]
            child += [0, 0]
            is_left = points[:, axis[node]] < value[node]
            left, right = (max(part, 1) for part in parts)
            todo.append((child[node] + 1, rows[~is_left], right, is_inside, bits))
            todo.append((child[node], rows[is_left], left, is_inside, bits))
        extent = float(np.ptp(sample, axis=0).max(initial=0.0)) if len(sample) else 0.0
        quantum = 2.0 ** np.floor(np.log2(max(extent, 1e-30) / 2**16))
        origins = np.rint(np.array(middles) / quantum) * quantum
        return Tree(
            np.array(axis, np.int8), np.array(value), np.array(child), origins, np.array(blocks)
        )

    @property
    def n_tiles(self) -> int:
        """T."""
        return len(self.origins)

    def neighbourhoods(self) -> dict[int, Split]:
        """The part of the tree that each neighbourhood is, by its number."""
        parts: dict[int, tuple[int, Split]] = {}
        for node in reversed(range(len(self.axis))):  # children have higher numbers
            first = int(self.child[node])
            if self.axis[node] < 0:
                parts[node] = int(self.blocks[first]), first
            elif first in parts and first + 1 in parts and parts[first][0] == parts[first + 1][0]:
                (block, left), (_, right) = parts.pop(first), parts.pop(first + 1)
                parts[node] = block, (int(self.axis[node]), float(self.value[node]), left, right)
        return dict(parts.values())

    def tile_of(self, points: F64) -> I64:
        """(n,) the tile of each point (n, 3)."""
        node = np.zeros(len(points), np.int64)
        inner = np.arange(len(points)) if self.axis[0] >= 0 else np.empty(0, np.int64)
        while len(inner):
            at = node[inner]
            is_right = points[inner, self.axis[at]] >= self.value[at]
            node[inner] = self.child[at] + is_right
            inner = inner[self.axis[node[inner]] >= 0]
        return self.child[node]


def _split(points: F64, n_tiles: int) -> tuple[int, float] | None:
    """Along the longest axis, in parts for n // 2 tiles and for the rest; None if in one place."""
    if len(points) < 2:
        return None
    low, high = np.percentile(points, (2, 98), axis=0)
    for axis in (int(np.argmax(high - low)), int(np.argmax(np.ptp(points, axis=0)))):
        row = np.sort(points[:, axis])
        value = float(row[len(row) * (n_tiles // 2) // n_tiles])
        if value > row[0]:
            return axis, value
        above = row[row > row[0]]
        if len(above):
            return axis, float(above[0])
    return None


def _between_sizes(points: F64, logs: F64, least: int, bits: float) -> tuple[int, float] | None:
    """Where splats of other sizes begin, if a cut there saves more than so many bits a splat.

    All splats of a tile share a step of positions, which its small splats decide. Taken as the
    power mean of exponent -2 of the sizes, a splat has log2(size / step) bits on each axis.
    """
    n, least = len(points), max(least, 1)
    if n < 2 * least:
        return None
    low, high = np.percentile(logs, EXTREME_SIZES)
    # Integers, whose sums do not depend on the order of the points.
    squares = np.exp(-2 * (np.clip(logs, low, high) - low))
    fineness = np.maximum(np.rint(FINEST * squares), 1).astype(np.int64)
    n_left = np.arange(1, n)
    best, found = bits, None
    for axis in range(3):
        order = np.argsort(points[:, axis])
        row, sums = points[order, axis], np.cumsum(fineness[order])
        left, right = sums[:-1], sums[-1] - sums[:-1]
        apart = n_left * np.log2(left / n_left) + (n - n_left) * np.log2(right / (n - n_left))
        saved = 3 / 2 * (math.log2(sums[-1] / n) - apart / n)
        saved[(row[1:] == row[:-1]) | (np.minimum(n_left, n - n_left) < least)] = 0
        at = int(np.argmax(saved))
        if saved[at] > best:
            best, found = float(saved[at]), (axis, float(row[at + 1]))
    return found


def _halves(points: F64, reach: float, least: int) -> tuple[int, float] | None:
    """Along the longest axis in the middle, of points that are farther apart than they may be."""
    if len(points) <= max(least, 1):
        return None
    wide = np.ptp(points, axis=0)
    axis = int(np.argmax(wide))
    middle = float(points[:, axis].min() + wide[axis] / 2)
    return (axis, middle) if wide[axis] > reach and points[:, axis].min() < middle else None
