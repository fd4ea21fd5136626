"""Grids and quantisers of a stream, chosen from what a tree holds (spec 3.1, 5.3).

A grid is fine enough for the steps asked for and coarse enough for the largest value.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.settings import FixedSteps, Settings, StepTable
from evogs_codec.errors import EvogsError, InputError
from evogs_codec.model.arithmetic import Quantiser
from evogs_codec.model.channels import (
    GROUPS,
    N_GROUPS,
    channel_class,
    group_of_class,
    n_channels,
)
from evogs_codec.model.splats import F64, I32

__all__ = [
    "MAX_EXACT",
    "AccuracyWarning",
    "Grid",
    "NotRepresentableError",
    "TooFineError",
    "coarse_step",
    "expect_near",
    "grid_exponents",
    "largest_of_rows",
    "too_coarse",
    "warn_if_coarser",
    "warn_if_moved",
    "with_a_coarser_row",
    "with_fewer_units",
]

FINEST_STEP = 16  # grid units of the finest step: steps are then right to a few per cent
MAX_STATE = 1 << 27  # |X| aimed at: leaves room for errors and for Delta of adds (R-7.3-1)
FAR_MOVED, NEAR_MOVED = 0.3, 0.1  # of its size a splat is moved: too far, and as it should be
MAX_FINER = 1000.0  # as advice
MAX_ORIGIN = 1 << 52  # R-5.5-1
MAX_EXACT = 1 << 22  # near-lossless: differences of two states fit 24 bits
COARSEST_GRID = -16  # grid exponent (R-5.1-7)
FURTHEST_MIDDLE = MAX_ORIGIN * 2.0**-COARSEST_GRID  # of a tile, on that grid, scene units


class NotRepresentableError(InputError):
    """The tree has numbers that no grid of the format holds."""


def grid_exponents(settings: Settings, ranges: Ranges, steps: F64) -> tuple[int, ...]:
    """G per group: fine enough for the steps, coarse enough for the values."""
    exponents = []
    for group in range(N_GROUPS):
        finest = float(steps[:, group if group < 4 else slice(4, None)].min())
        limit = MAX_EXACT if settings.is_near_lossless else MAX_STATE
        room = limit / max(ranges.largest[group], 1e-300)
        wanted = 40 if settings.is_near_lossless else math.ceil(math.log2(FINEST_STEP / finest))
        if group == 0:
            room = min(room, MAX_ORIGIN / max(ranges.furthest, 1e-300))
        exponent = min(max(wanted, COARSEST_GRID), math.floor(math.log2(room)), 40)
        if exponent < COARSEST_GRID:
            expect_near(ranges.furthest if group == 0 else 0.0)
            raise NotRepresentableError(
                f"a value of {ranges.largest[group]:.3g} is too large for any grid"
            )
        exponents.append(exponent)
    return tuple(exponents)


def expect_near(coordinate: float) -> None:
    """Refuse a scene that no stream can hold, by its largest coordinate.

    Raises:
        NotRepresentableError: it is beyond the range of the origin of a tile on any grid.
    """
    if coordinate > FURTHEST_MIDDLE:
        raise NotRepresentableError(
            f"a position {coordinate:.3g} units from zero is too far for any stream, which ends at"
            f" {FURTHEST_MIDDLE:.3g}: move the scene nearer"
        )


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
    def of(sh_degree: int, exponents: tuple[int, ...], steps: F64, settings: Settings) -> Grid:
        """The grids with these exponents and, on them, the quantisers nearest to `steps`."""
        classes = tuple(channel_class(c) for c in range(n_channels(sh_degree)))
        by_class = np.array([2.0 ** exponents[group_of_class(k)] for k in range(steps.shape[1])])
        units = np.ones_like(steps) if settings.is_near_lossless else steps * by_class
        return Grid(
            sh_degree=sh_degree,
            exponents=exponents,
            quantisers=tuple(tuple(_quantiser(u) for u in row) for row in units.tolist()),
            scale=np.array([[2.0 ** exponents[group_of_class(k)]] for k in classes]),
            classes=classes,
        )

    @cached_property
    def channel_quantisers(self) -> tuple[tuple[Quantiser, ...], ...]:
        """The quantisers of each channel: row 0 of adds, 1 + level of psi."""
        return tuple(tuple(row[kind] for kind in self.classes) for row in self.quantisers)


class TooFineError(EvogsError):
    """A number of a group leaves its range.

    Attributes:
        group: of the number.
        row: of `Grid.quantisers`, whose steps are too fine for 24 bits a number; None where the
            grid is too fine.
        times: by class, how many times as coarse a step of that row has to be.
    """

    def __init__(
        self, group: int, row: int | None = None, times: Mapping[int, float] | None = None
    ) -> None:
        super().__init__(group, row, times)
        self.group, self.row, self.times = group, row, dict(times or {})


class AccuracyWarning(UserWarning):
    """A grid is coarser than the steps asked for, or fixed steps move splats far for their size."""


def with_fewer_units(exponents: tuple[int, ...], group: int) -> tuple[int, ...]:
    """Of the grids of all groups, that of one with half as many units.

    Raises:
        NotRepresentableError: there is none.
    """
    if exponents[group] <= COARSEST_GRID:
        raise NotRepresentableError(f"{GROUPS[group]}: a value is too large for any grid")
    return tuple(e - (g == group) for g, e in enumerate(exponents))


def with_a_coarser_row(steps: F64, grid: Grid, error: TooFineError) -> F64:
    """These steps (1 + n_levels, K), those of a row as much coarser as an error says.

    What a coarse step is off, a refine after it corrects.
    """
    assert error.row is not None, "of a grid that is too fine units are halved"
    coarser = steps.copy()
    for kind, times in error.times.items():
        quantiser = grid.quantisers[error.row][kind]
        exponent = grid.exponents[group_of_class(kind)]
        coarser[error.row, kind] = times * quantiser.step * 2.0**-exponent
    return coarser


def too_coarse(got: F64, asked: F64, unit: F64 | float) -> npt.NDArray[np.bool_]:
    """Whether steps are coarser than asked for by more than rounding to grid units."""
    found: npt.NDArray[np.bool_] = (got > 1.1 * asked) & ((asked < unit) | (got > asked + unit / 2))
    return found


def coarse_step(group: int, got: float, asked: float) -> str:
    """What is said of a step of a group that is too coarse."""
    return (
        f"{GROUPS[group]}: values span so much that the step is {got:.3g}, not {asked:.3g}:"
        " drop outliers or use more tiles"
    )


def warn_if_coarser(grid: Grid, steps: F64, settings: Settings) -> None:
    """Warn the caller of `quantise` where a grid is coarser than the steps asked for.

    Of a tree in integers, where its quanta are not steps of the grid.
    """
    if settings.is_near_lossless:
        return
    if isinstance(settings.accuracy, StepTable) and not settings.closed_loop:
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
        unit = 2.0 ** -grid.exponents[group]
        asked = float(steps[:, group].min())
        got = min(row[group].step for row in grid.quantisers) * unit
        if too_coarse(np.array(got), np.array(asked), unit):
            warnings.warn(coarse_step(group, got, asked), AccuracyWarning, stacklevel=3)


def warn_if_moved(steps: F64, settings: Settings, ranges: Ranges) -> None:
    """Warn the caller of `quantise` where fixed steps (1 + n_levels, K) move small splats far."""
    by = float(steps[-1, 0]) / 2
    if isinstance(settings.accuracy, FixedSteps) and by > FAR_MOVED * ranges.size:
        finer = by / max(NEAR_MOVED * ranges.size, 1e-300)
        advice = f"--finer {math.ceil(finer)}, or " if finer <= MAX_FINER else ""
        warnings.warn(
            f"position: splats are moved by up to {by:.3g} along an axis, and one in 20 has"
            f" a size of {ranges.size:.3g} at most: try {advice}no preset, so that views decide",
            AccuracyWarning,
            stacklevel=3,
        )


def largest_of_rows(of: F64 | I32) -> F64 | I32:
    """(C,) magnitude of the rows (C, n); no number is the least of its type."""
    largest: F64 | I32 = np.maximum(of.max(axis=1, initial=0), -of.min(axis=1, initial=0))
    return largest
