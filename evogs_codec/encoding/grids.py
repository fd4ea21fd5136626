"""Grids and quantisers of a stream, chosen from what a tree holds (spec 3.1, 5.3).

A grid is fine enough for the steps asked for and coarse enough for the largest value.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.encoding.settings import Settings
from evogs_codec.errors import EvogsError, InputError
from evogs_codec.model.arithmetic import Quantiser
from evogs_codec.model.channels import (
    GROUP_CHANNELS,
    GROUPS,
    N_CORE,
    N_GROUPS,
    channel_class,
    group_of_class,
    n_channels,
    n_classes,
)
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import EvolutionTree

__all__ = [
    "AccuracyWarning",
    "Grid",
    "NotRepresentableError",
    "Ranges",
    "TooFineError",
    "grid_exponents",
    "middle_of",
    "wanted_steps",
    "warn_if_coarser",
]

FINEST_STEP = 16  # grid units of the finest step: steps are then right to a few per cent
MAX_STATE = 1 << 27  # |X| aimed at: leaves room for errors and for Delta of adds (R-7.3-1)
MAX_ORIGIN = 1 << 52  # R-5.5-1
SAMPLED, MANY = 16, 4096  # every 16th splat tells the extent, where there are many
FEW = 256  # points, of which one far away would move a percentile that is interpolated
MOST_COARSER = 6  # levels above the last, beyond which steps stay as they are
MAX_EXACT = 1 << 22  # near-lossless: differences of two states fit 24 bits


class NotRepresentableError(InputError):
    """The tree has numbers that no grid of the format holds."""


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
    """

    extent: float
    largest: tuple[float, ...]
    furthest: float
    psi: tuple[tuple[float, ...], ...]
    sharing: float = 0.0

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
        every = SAMPLED if n_leaves >= MANY else 1
        for tile in tiles:
            middle = middle_of(tile)
            state = None
            for step, state in zip(tile.steps, tile.states(), strict=True):
                values = state.values
                for group, part in enumerate(GROUP_CHANNELS):
                    rows = values[part] - middle[:, None] if group == 0 else values[part]
                    if rows.size:
                        largest[group] = max(largest[group], float(np.abs(rows).max()))
                for row, numbers in ((step.level, step.psi), (n_levels, step.adds)):
                    if numbers.shape[1]:
                        for c, kind in enumerate(channels):
                            low, high = float(numbers[c].min()), float(numbers[c].max())
                            psi[row, kind, 0] = min(psi[row, kind, 0], low)
                            psi[row, kind, 1] = max(psi[row, kind, 1], high)
            if state is not None:
                leaves.append(state.values[0:3][:, state.live][:, ::every])
        if palette is not None and palette.entries.size:
            largest[4] = max(largest[4], float(np.abs(palette.entries).max()))
            for c, row in enumerate(palette.entries, start=N_CORE):
                low, high = psi[n_levels, channel_class(c)]
                psi[n_levels, channel_class(c)] = min(low, row.min()), max(high, row.max())
        points = np.concatenate([np.zeros((3, 0)), *leaves], axis=1)
        return Ranges(
            extent=_extent(points),
            largest=tuple(largest),
            furthest=max(float(np.abs(middle_of(tile)).max()) for tile in tiles),
            psi=tuple(tuple(np.ptp(row, axis=1)) for row in psi),
            sharing=0.0 if palette is None else _sharing(tiles),
        )


def _sharing(tiles: Sequence[EvolutionTree]) -> float:
    picks = [np.empty(0, np.int32)]
    for tile in tiles:
        picks += [state.picks[state.live] for state in [*tile.states()][-1:]]
    some = np.concatenate(picks)
    some = some[some > 0]
    return max(len(some) / max(len(np.unique(some)), 1), 1.0)


def _extent(points: F64) -> float:
    """What 98 % of points (3, n) span along the widest axis; of few, all but the outermost."""
    n = points.shape[1]
    if n == 0:
        return 1.0
    if n < FEW:
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


def wanted_steps(settings: Settings, ranges: Ranges, n_levels: int) -> F64:
    """(1 + n_levels, classes) steps in scene units: of adds, then of psi per level."""
    classes = len(ranges.psi[0])
    if settings.table:
        return np.array(settings.table)
    if settings.range_bits:
        by_level: F64 = np.array([ranges.psi[n_levels], *ranges.psi[:n_levels]])
        by_level[:, 4:] = by_level[:, 4:].max(1, keepdims=True)  # a range per group
        by_level[0, : 5 if ranges.sharing else None] /= 256  # not entries, which are leaves' own
        # Where nothing changes any step will do: one that asks for no finer grid.
        by_level = np.where(by_level > 0, by_level, np.maximum(by_level.max(0), 1e-6))
        by_level /= 2**settings.range_bits - 1
        return by_level
    base = np.array(settings.steps[:classes])
    if settings.relative:
        base[0] *= ranges.extent
    factor = np.array(settings.coarser[:classes])
    above = np.minimum(np.arange(n_levels - 1, -1, -1), MOST_COARSER)
    parts = np.where(factor > 0, factor, 1.0) ** above[:, None]
    shared = np.where(np.arange(classes) == 0, parts.sum(0), np.sqrt(np.square(parts).sum(0)))
    psi = base * parts / np.where(factor > 0, shared, 1.0)
    steps: F64 = np.concatenate([psi[:1] * settings.adds, psi])
    if ranges.sharing:
        # No level adds to the errors of entries; bits of one serve all splats that share it.
        steps[:, 5:] = base[5:] / math.sqrt(max(ranges.sharing, 1.0))
    return steps


def grid_exponents(settings: Settings, ranges: Ranges, steps: F64) -> tuple[int, ...]:
    """G per group: fine enough for the steps, coarse enough for the values."""
    exponents = []
    for group in range(N_GROUPS):
        finest = float(steps[:, group if group < 4 else slice(4, None)].min())
        limit = MAX_EXACT if settings.near_lossless else MAX_STATE
        room = limit / max(ranges.largest[group], 1e-300)
        wanted = 40 if settings.near_lossless else math.ceil(math.log2(FINEST_STEP / finest))
        if group == 0:
            room = min(room, MAX_ORIGIN / max(ranges.furthest, 1e-300))
        exponent = min(max(wanted, -16), math.floor(math.log2(room)), 40)
        if exponent < -16:
            raise NotRepresentableError(
                f"a value of {ranges.largest[group]:.3g} is too large for any grid"
            )
        exponents.append(exponent)
    return tuple(exponents)


def _quantiser(step: float) -> Quantiser:
    """The quantiser whose step is nearest to `step` grid units, at least 1."""
    shift = max(0, math.ceil(math.log2(max(step, 1.0) / 65535)))
    return Quantiser(max(1, round(step / (1 << shift))), min(shift, 24))


@dataclass(frozen=True)
class Grid:
    """Grids and quantisers of a stream."""

    sh_degree: int
    exponents: tuple[int, ...]
    quantisers: tuple[tuple[Quantiser, ...], ...]
    scale: F64  # (D, 1) grid units of a scene unit
    classes: tuple[int, ...]  # per channel

    @staticmethod
    def of(
        sh_degree: int,
        n_levels: int,
        exponents: tuple[int, ...],
        steps: F64,
        settings: Settings,
    ) -> Grid:
        """The grids with these exponents and, on them, the quantisers nearest to `steps`."""
        classes = tuple(channel_class(c) for c in range(n_channels(sh_degree)))
        by_class = np.array([2.0 ** exponents[group_of_class(k)] for k in range(steps.shape[1])])
        units = np.ones_like(steps) if settings.near_lossless else steps * by_class
        return Grid(
            sh_degree=sh_degree,
            exponents=exponents,
            quantisers=tuple(tuple(_quantiser(u) for u in row) for row in units.tolist()),
            scale=np.array([[2.0 ** exponents[group_of_class(k)]] for k in classes]),
            classes=classes,
        )

    def channel_quantisers(self, row: int) -> list[Quantiser]:
        """The quantiser of each channel: row 0 of adds, 1 + level of psi."""
        return [self.quantisers[row][kind] for kind in self.classes]


class TooFineError(EvogsError):
    """A number of this group leaves its range on its grid."""

    def __init__(self, group: int) -> None:
        super().__init__(group)
        self.group = group


class AccuracyWarning(UserWarning):
    """Values span so much that a grid is coarser than the step asked for."""


def warn_if_coarser(grid: Grid, steps: F64, settings: Settings) -> None:
    """Warn the caller of `quantise` where a grid is coarser than the steps asked for.

    Of a tree in integers, where its quanta are not steps of the grid.
    """
    if settings.near_lossless:
        return
    if settings.table and not settings.closed_loop:
        for group in range(N_GROUPS):
            part = slice(group, group + 1 if group < 4 else None)
            found = [[q.step for q in row[part]] for row in grid.quantisers]
            if np.any(np.array(found) * 2.0 ** -grid.exponents[group] != steps[:, part]):
                warnings.warn(
                    f"{GROUPS[group]}: no grid holds the quanta of the tree: it is rounded again",
                    AccuracyWarning,
                    stacklevel=3,
                )
        return
    for group in range(N_GROUPS):
        asked = float(steps[:, group].min())
        got = min(row[group].step for row in grid.quantisers) * 2.0 ** -grid.exponents[group]
        if got > 1.1 * asked:
            warnings.warn(
                f"{GROUPS[group]}: values span so much that the step is {got:.3g}, not {asked:.3g}:"
                " drop outliers or use more tiles",
                AccuracyWarning,
                stacklevel=3,
            )
