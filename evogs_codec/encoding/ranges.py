"""What a tree spans: the ranges that decide about grids and steps.

Letters: n points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.model.channels import (
    GROUP_CHANNELS,
    N_CORE,
    N_GEOMETRY,
    N_GROUPS,
    channel_class,
    n_channels,
    n_classes,
)
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import EvolutionTree

__all__ = ["Ranges", "middle_of"]

SAMPLED_EVERY, SAMPLED_ABOVE = 16, 4096  # every 16th splat tells the extent, where there are many
SMALL_PERCENTILE = 5  # percentile of the sizes of leaves
MAX_LOG_SIZE = 700.0  # of a size: its exponential is a number
# Points, of which one far away would move a percentile that is interpolated.
INTERPOLATED_FROM = 256


@dataclass(frozen=True)
class Ranges:
    """What the grids must hold, in scene units.

    Attributes:
        extent: robust extent of the scene: the longest axis of its 1st to 99th percentiles.
        largest: per group the largest magnitude of a state; positions from the tile's middle.
        furthest: largest coordinate of the middle of a tile.
        psi: [level][class] range of psi; [n_levels] of adds, and of the entries of a palette.
        sharing: leaves for each entry that one picks; 0 without a palette. Classes above 4 are
            those of its entries.
        size: one leaf in 20 has a longest half axis of this at most; infinite without leaves.
    """

    extent: float
    largest: tuple[float, ...]
    furthest: float
    psi: tuple[tuple[float, ...], ...]
    sharing: float = 0.0
    size: float = math.inf

    @staticmethod
    def of(tiles: Sequence[EvolutionTree], n_levels: int) -> Ranges:
        """What the states, the psi and the adds of these trees span."""
        palette = tiles[0].palette
        classes = n_classes(tiles[0].shown_degree)
        channels = [channel_class(c) for c in range(n_channels(tiles[0].sh_degree))]
        largest = [0.0] * N_GROUPS
        psi = np.zeros((n_levels + 1, classes, 2))
        leaves = []
        n_leaves = sum(tile.n_leaves for tile in tiles)
        every = SAMPLED_EVERY if n_leaves >= SAMPLED_ABOVE else 1
        for tile in tiles:
            middle = middle_of(tile)
            state = None
            for step, state in zip(tile.steps, tile.states(), strict=True):
                n = state.values.shape[1]
                values = state.values[:, np.append(step.slots, np.arange(n - step.n_new, n))]
                for group, part in enumerate(GROUP_CHANNELS):
                    rows = values[part] - middle[:, None] if group == 0 else values[part]
                    if rows.size:
                        largest[group] = max(largest[group], float(np.abs(rows).max()))
                for row, numbers in ((step.level, step.psi), (n_levels, step.adds)):
                    if numbers.shape[1]:
                        np.minimum.at(psi[row, :, 0], channels, numbers.min(axis=1))
                        np.maximum.at(psi[row, :, 1], channels, numbers.max(axis=1))
            if state is not None:
                leaves.append(state.values[:N_GEOMETRY, np.flatnonzero(state.live)[::every]])
        if palette is not None and palette.entries.size:
            largest[4] = max(largest[4], float(np.abs(palette.entries).max()))
            for c, row in enumerate(palette.entries, start=N_CORE):
                low, high = psi[n_levels, channel_class(c)]
                psi[n_levels, channel_class(c)] = min(low, row.min()), max(high, row.max())
        some = np.concatenate([np.zeros((N_GEOMETRY, 0)), *leaves], axis=1)
        return Ranges(
            extent=_extent(some[GROUP_CHANNELS[0]]),
            largest=tuple(largest),
            furthest=max(float(np.abs(middle_of(tile)).max()) for tile in tiles),
            psi=tuple(tuple(np.ptp(row, axis=1)) for row in psi),
            sharing=0.0 if palette is None else _sharing(tiles),
            size=_size(some[GROUP_CHANNELS[2]]),
        )


def _sharing(tiles: Sequence[EvolutionTree]) -> float:
    picks = [np.empty(0, np.int32)]
    for tile in tiles:
        picks += [state.picks[state.live] for state in [*tile.states(slice(0))][-1:]]
    some = np.concatenate(picks)
    some = some[some > 0]
    return max(len(some) / max(len(np.unique(some)), 1), 1.0)


def _size(log_scales: F64) -> float:
    """The 5th percentile of the longest half axes of log-scales (3, n); infinite without any."""
    if not log_scales.shape[1]:
        return math.inf
    return math.exp(
        min(float(np.percentile(log_scales.max(axis=0), SMALL_PERCENTILE)), MAX_LOG_SIZE)
    )


def _extent(points: F64) -> float:
    """What 98 % of points (3, n) span along the widest axis; of few, all but the outermost."""
    n = points.shape[1]
    if n == 0:
        return 1.0
    if n < INTERPOLATED_FROM:
        low, high = math.ceil(0.01 * (n - 1)), math.floor(0.99 * (n - 1))
        spread = np.ptp(np.sort(points, axis=1)[:, [low, high]], axis=1)
    else:
        spread = np.ptp(np.percentile(points, (1, 99), axis=1), axis=0)
    return float(spread.max()) or float(np.ptp(points, axis=1).max()) or 1.0


def middle_of(tile: EvolutionTree) -> F64:
    """(3,) middle of the box of the adds of a tile; 0 without adds."""
    adds = [step.adds[0:3] for step in tile.steps if step.n_adds]
    if not adds:
        return np.zeros(3)
    low: F64 = np.min([part.min(1) for part in adds], axis=0).astype(np.float64)
    high: F64 = np.max([part.max(1) for part in adds], axis=0).astype(np.float64)
    return (low + high) / 2
