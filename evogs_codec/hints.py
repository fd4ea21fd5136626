"""Hints: the error estimates of packet entries (spec 5.6).

Letters: D channels, L sampled leaves, A generations.
"""

from __future__ import annotations

import math

import numpy as np

from evogs_codec.coded import component_slice
from evogs_codec.directory import UNKNOWN_ERROR
from evogs_codec.grids import Grid
from evogs_codec.splats import I32, I64
from evogs_codec.tree import EvolutionTree, Kind

__all__ = ["History"]

SAMPLE = 4096  # leaves of a tile that the error estimates look at


class History:
    """Snapshots after every step, for the error estimates of the packet entries (spec 5.6)."""

    def __init__(self, tile: EvolutionTree, grid: Grid) -> None:
        self.grid = grid
        self.snapshots: list[I32] = []
        total = sum(step.n_new for step in tile.steps)
        self.born_from = np.full(total, -1, np.int64)
        live = np.zeros(total, bool)
        n = 0
        for step in tile.steps:
            parents = step.slots[step.kinds == Kind.SPLIT]
            self.born_from[n : n + len(parents)] = parents
            live[n : n + step.n_new] = True
            live[step.slots[step.kinds == Kind.DROP]] = False
            n += step.n_new
        leaves = np.flatnonzero(live)
        # The sampled leaves and, from then on, whatever slot stands for each of them.
        self.leaves = leaves[:: max(1, len(leaves) // SAMPLE)]
        self.ancestors = self._ancestors()

    def _ancestors(self) -> I64:
        """(A, L) slots of the ancestors of the sampled leaves, nearest first, -1 after the last."""
        rows = [self.leaves]
        while np.any(rows[-1] >= 0):
            rows.append(np.where(rows[-1] >= 0, self.born_from[rows[-1]], -1))
        return np.stack(rows)

    def note(self, x: I32, n: int) -> None:
        """Remember what stands for each sampled leaf: (D, L), NaN-free; absent ones are marked."""
        exists = (self.ancestors >= 0) & (self.ancestors < n)
        first = np.argmax(exists, axis=0)
        slot = self.ancestors[first, np.arange(exists.shape[1])]
        found = exists.any(0)
        snapshot = np.where(found, x[:, np.where(found, slot, 0)], np.iinfo(np.int32).min)
        self.snapshots.append(snapshot.astype(np.int32))

    def errors(self, final: I32) -> list[tuple[int, ...]]:
        """Per step, per component: the estimate of spec 5.6 in grid units."""
        last = final[:, self.leaves].astype(np.float64)
        if not last.shape[1]:
            return [(UNKNOWN_ERROR,) * (self.grid.sh_degree + 1)] * len(self.snapshots)
        # A splat that is still missing is as far off as it is large.
        log_radius = last[7:10].max(0) / self.grid.scale[7]
        radius = np.exp(np.minimum(log_radius, 80)) * self.grid.scale[0]
        out = []
        for snapshot in self.snapshots:
            missing = snapshot[0] == np.iinfo(np.int32).min
            square = np.square(snapshot[0:3] - last[0:3]).sum(0)
            square[missing] = np.square(np.minimum(radius[missing], 1e9))
            errors = [math.sqrt(square.mean())]
            for component in range(1, self.grid.sh_degree + 1):
                part = component_slice(component)
                shown = np.where(missing, 0, snapshot[part])
                errors.append(math.sqrt(np.square(shown - last[part]).mean()))
            out.append(tuple(min(round(e), UNKNOWN_ERROR - 1) for e in errors))
        return out
