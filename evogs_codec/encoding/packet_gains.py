"""Hints: what stays to be refined after each packet, for its entry (spec 5.6) and its place.

Letters: D channels, L sampled leaves, A generations, K steps, B components.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from evogs_codec.encoding.estimated_gains import area, visibility
from evogs_codec.encoding.grids import Grid
from evogs_codec.format.directory import UNKNOWN_ERROR
from evogs_codec.model.components import CORE, PICKS, component_slice
from evogs_codec.model.palette import Palette
from evogs_codec.model.splats import F64, I32, I64
from evogs_codec.model.tree import EvolutionTree, Step, take_picks

__all__ = ["LeafTracker"]

N_SAMPLED = 4096  # leaves of a tile that the error estimates look at

# Mean squared errors of pictures, as measured on a lifted scene, a trained tree and LapisGS layers.
BLANK_ERROR = 0.1  # with no packet
COARSE_ERROR = 0.025  # while all splats are as far off as they ever are; less with a power of that
COARSE_POWER = 1.75
SH_ERROR = 0.001  # for SH coefficients that are wrong by 1: of many splats they cancel


class LeafTracker:
    """What stands for each leaf after every step, for the error estimates (spec 5.6)."""

    def __init__(self, tile: EvolutionTree, grid: Grid) -> None:
        self.grid = grid
        self.palette, self.components = tile.palette, tile.components
        self.shown: list[I32] = []
        self.picks = np.zeros(1 + sum(step.n_new for step in tile.steps), np.int32)  # -1: none
        self.snapshots: list[I32] = []
        self.missing: list[npt.NDArray[np.bool_]] = []
        self.present: list[I32] = []
        self.born_from, live = tile.lineage()
        leaves = np.flatnonzero(live)
        # The sampled leaves and, from then on, whatever slot stands for each of them.
        self.leaves = leaves[:: max(1, len(leaves) // N_SAMPLED)]
        self.ancestors = self._ancestors()

    def _ancestors(self) -> I64:
        """(A, L) slots of the ancestors of the sampled leaves, nearest first, -1 after the last."""
        rows = [self.leaves]
        while np.any(rows[-1] >= 0):
            rows.append(np.where(rows[-1] >= 0, self.born_from[rows[-1]], -1))
        return np.stack(rows)

    def note(self, x: I32, n: int, step: Step | None = None) -> None:
        """Remember what stands for each sampled leaf: (D, L), 0 where nothing does.

        Args:
            x: (D, at least n) slots.
            n: how many.
            step: that of the tree which led to them; None for one that corrects what it lacks.
        """
        if step is not None:
            take_picks(step, self.picks, n - step.n_new)
        exists = (self.ancestors >= 0) & (self.ancestors < n)
        first = np.argmax(exists, axis=0)
        slot = self.ancestors[first, np.arange(exists.shape[1])]
        found = exists.any(0)
        self.shown.append(self.picks[np.where(found, slot, -1)])
        self.snapshots.append(np.where(found, x[:, np.where(found, slot, 0)], 0).astype(np.int32))
        self.missing.append(np.logical_not(found))
        self.present.append(x[0:3, : 0 if found.all() else n].copy())

    def estimates(self, final: I32) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
        """Per step: for each column its error (spec 5.6) and its gain.

        Errors are in grid units. They never rise: what a later step leaves to be refined, an
        earlier one does too. A gain is how much of the mean squared error of pictures goes, in the
        units of a picture from 0 to 1.
        """
        n_steps, components = len(self.snapshots), self.components.of_tiles
        if not len(self.leaves):
            return [((UNKNOWN_ERROR,) * len(components), (0.0,) * len(components))] * n_steps
        last = final[:, self.leaves].astype(np.float64)
        values = last / self.grid.scale
        weights = visibility(values) / max(visibility(values).sum(), 1e-300)
        errors, left = (
            np.zeros((n_steps, len(components))),
            np.zeros((n_steps + 1, len(components))),
        )
        ways = self._ways(last[0:3])
        errors[:, 0] = np.sqrt(np.square(ways).mean(1))
        farthest = np.maximum(ways.max(0), np.sqrt(area(values)) * self.grid.scale[0])
        left[0, 0], left[1:, 0] = (
            BLANK_ERROR,
            COARSE_ERROR * (ways / farthest).mean(1) ** COARSE_POWER,
        )
        for column, component in enumerate(components):
            if component == PICKS:
                assert self.palette is not None
                squares = self._off_picks(self.palette)
                errors[:, column] = np.sqrt(squares[1:].mean((1, 2))) * self.grid.scale[-1]
                left[:, column] = SH_ERROR * (squares.sum(1) @ weights) / 3
            elif component != CORE:
                part = component_slice(component)
                off = [
                    np.square(x[part] - last[part])
                    for x in (0 * final[:, self.leaves], *self.snapshots)
                ]
                errors[:, column] = [np.sqrt(square.mean()) for square in off[1:]]
                unit = np.square(self.grid.scale[part])
                left[:, column] = [
                    SH_ERROR * float(weights @ (square / unit).sum(0)) / 3 for square in off
                ]
        errors, left = (np.maximum.accumulate(x[::-1], axis=0)[::-1] for x in (errors, left))
        whole = np.minimum(np.rint(errors), UNKNOWN_ERROR - 1).astype(np.int64)
        gains = -np.diff(left, axis=0)
        return [(tuple(e), tuple(g)) for e, g in zip(whole.tolist(), gains.tolist(), strict=True)]

    def _off_picks(self, palette: Palette) -> F64:
        """(1 + K, C, L) squared errors of the SH above band 0, of none and then after each step."""
        last = palette.sh_of(self.picks[self.leaves]).astype(np.float64)
        off = [-last, *(palette.sh_of(picks) - last for picks in self.shown)]
        return np.square(np.stack(off))

    def _ways(self, last: F64) -> F64:
        """(K, L) from what stands for each leaf after a step to its last position, grid units.

        Where nothing does yet, from whatever is nearest.
        """
        ways = np.zeros((len(self.snapshots), last.shape[1]))
        for k, (shown, missing, present) in enumerate(
            zip(self.snapshots, self.missing, self.present, strict=True)
        ):
            ways[k] = np.sqrt(np.square(shown[0:3] - last).sum(0))
            if missing.any():
                ways[k, missing] = scipy.spatial.cKDTree(present.T).query(last[:, missing].T)[0]
        return ways
