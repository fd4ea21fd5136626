"""What an encoder is asked for: an accuracy, alpha tables, a level of Zstandard.

A step is the distance of two neighbouring values, in the units of the group: an error of half of it
at most, of a twelfth of its square on average.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from evogs_codec.encoding.ranges import Ranges
from evogs_codec.model.splats import F64

__all__ = [
    "ALPHA_BITS",
    "MAX_PSNR",
    "N_ALPHA",
    "PRESETS",
    "SCENE_PRESET",
    "SCENE_PRICE",
    "TREE_PRESET",
    "TREE_PSNR",
    "Accuracy",
    "FixedSteps",
    "NearLossless",
    "RangeBits",
    "Settings",
    "StepTable",
]

# Rendered views of a stream against those of its tree, dB: a tree 35 dB from photographs loses
# 0.1 dB.
TREE_PSNR = 52.0
MAX_PSNR = 120.0  # dB that may be asked for
# What a bit of every splat is worth by default, in mean squared error of rendered views: then
# scenes of any number of splats have about the same PSNR.
SCENE_PRICE = 4e-6
N_ALPHA, ALPHA_BITS = 256, 10  # as many alphas as a table holds; which are used, their bits decide
MAX_COARSER = 6  # levels above the last, beyond which steps stay as they are


@dataclass(frozen=True)
class FixedSteps:
    """A step per class, the same for every tree.

    Attributes:
        steps: per class (spec 3.2) the step that a splat coded on its own would have.
        relative: the position step is a part of the extent of the scene.
        coarser: per class the factor of the step per level below the last. Where a child inherits
            the error of its parent, the step is shared out over the levels: for positions largest
            errors add up, for the rest mean squares. 0: the same step at all levels.
        adds: factor of the step of adds to that of psi at level 0.
    """

    steps: tuple[float, ...]
    relative: bool = False
    coarser: tuple[float, ...] = (0.0,) * 8
    adds: float = 1.0

    def finer(self, factor: float) -> FixedSteps:
        """The same with all steps divided by `factor`."""
        return replace(self, steps=tuple(step / factor for step in self.steps))

    def wanted_steps(self, ranges: Ranges, n_levels: int) -> F64:
        """(1 + n_levels, classes) steps in scene units: of adds, then of psi per level."""
        classes = len(ranges.psi[0])
        base = np.array(self.steps[:classes])
        if self.relative:
            base[0] *= ranges.extent
        factor = np.array(self.coarser[:classes])
        above = np.minimum(np.arange(n_levels - 1, -1, -1), MAX_COARSER)
        parts = np.where(factor > 0, factor, 1.0) ** above[:, None]
        shared = np.where(np.arange(classes) == 0, parts.sum(0), np.sqrt(np.square(parts).sum(0)))
        psi = base * parts / np.where(factor > 0, shared, 1.0)
        steps: F64 = np.concatenate([psi[:1] * self.adds, psi])
        if ranges.sharing:
            # No level adds to the errors of entries; bits of one serve all splats that share it.
            steps[:, 5:] = base[5:] / math.sqrt(max(ranges.sharing, 1.0))
        return steps


@dataclass(frozen=True)
class RangeBits:
    """Steps that divide the range of psi of a level and group into 2**bits - 1.

    Those of adds divide theirs 256 times finer.
    """

    bits: int

    def wanted_steps(self, ranges: Ranges, n_levels: int) -> F64:
        """(1 + n_levels, classes) steps in scene units: of adds, then of psi per level."""
        by_level: F64 = np.array([ranges.psi[n_levels], *ranges.psi[:n_levels]])
        by_level[:, 4:] = by_level[:, 4:].max(1, keepdims=True)  # a range per group
        by_level[0, : 5 if ranges.sharing else None] /= 256  # not entries, which are leaves' own
        # Where nothing changes any step will do: one that asks for no finer grid.
        by_level = np.where(by_level > 0, by_level, np.maximum(by_level.max(0), 1e-6))
        by_level /= 2**self.bits - 1
        return by_level


@dataclass(frozen=True)
class NearLossless:
    """One grid unit per generation; the grids are as fine as 24 bits allow."""

    def wanted_steps(self, ranges: Ranges, n_levels: int) -> F64:
        """(1 + n_levels, classes) of 1: the steps are a grid unit, whatever the grids are."""
        return np.ones((1 + n_levels, len(ranges.psi[0])))


@dataclass(frozen=True)
class StepTable:
    """The steps: of adds, then of psi per level; per class, in the units of the group."""

    rows: tuple[tuple[float, ...], ...]

    @staticmethod
    def of(steps: F64) -> StepTable:
        """From an array (1 + n_levels, classes)."""
        return StepTable(tuple(map(tuple, steps.tolist())))

    def finer(self, factor: float) -> StepTable:
        """The same with all steps divided by `factor`."""
        return StepTable(tuple(tuple(step / factor for step in row) for row in self.rows))

    def wanted_steps(self, _ranges: Ranges, _n_levels: int) -> F64:
        """(1 + n_levels, classes) steps in scene units: of adds, then of psi per level."""
        return np.array(self.rows)


Accuracy: TypeAlias = FixedSteps | RangeBits | NearLossless | StepTable


@dataclass(frozen=True)
class Settings:
    """How to quantise a tree.

    Attributes:
        accuracy: which steps.
        n_alpha: entries of an alpha table at most, where the tree's own alphas are more.
        alpha_bits: K of tables that are fitted.
        closed_loop: quantise against what the decoder has.
        zstd_level: 1 to 22; higher levels take fewer bytes and more time.
        whole_origins: origins of tiles are multiples of the position step of adds, so that adds
            that are multiples stay as they are.
    """

    accuracy: Accuracy
    n_alpha: int = 32
    alpha_bits: int = 5
    closed_loop: bool = True
    zstd_level: int = 18
    whole_origins: bool = False

    @staticmethod
    def by_views(steps: F64) -> Settings:
        """With steps (1 + n_levels, classes) that follow from views, and the alphas that pay."""
        return Settings(StepTable.of(steps), n_alpha=N_ALPHA, alpha_bits=ALPHA_BITS)

    @staticmethod
    def of_quanta(quanta: tuple[tuple[float, ...], ...]) -> Settings:
        """For a tree whose numbers are multiples of `quanta` (`EvolutionTree`).

        The multiples go into the stream as they are, without a loop that would change them to
        correct what the grid rounds off products of alpha.
        """
        return Settings(
            StepTable(quanta),
            n_alpha=N_ALPHA,
            alpha_bits=ALPHA_BITS,
            closed_loop=False,
            whole_origins=True,
        )

    @property
    def is_near_lossless(self) -> bool:
        """Whether the steps are a grid unit."""
        return isinstance(self.accuracy, NearLossless)

    def finer(self, factor: float) -> Settings:
        """The same with all steps divided by `factor`: 2 halves all errors.

        Raises:
            ValueError: the accuracy has no steps of its own.
        """
        accuracy = self.accuracy
        if isinstance(accuracy, FixedSteps | StepTable):
            return replace(self, accuracy=accuracy.finer(factor))
        raise ValueError(f"{accuracy} has no steps to divide")


_SCENE = Settings(
    FixedSteps(
        steps=(1.18e-4, 0.0027, 0.105, 0.14, 0.036, 0.118, 0.118, 0.118),
        relative=True,
        # A lifted parent has the rotation of a child, whose error it does not pass on.
        coarser=(0.5, 0.0, 0.7, 0.7, 0.7, 0.7, 0.7, 0.7),
    )
)
_TRAINED = Settings(FixedSteps(steps=(0.0005, 0.02, 0.06, 0.12, 0.03, 0.03, 0.03, 0.03), adds=0.5))

SCENE_PRESET, TREE_PRESET = "scene", "trained"  # where nothing can be rendered

PRESETS = {
    # Accuracy of SPZ version 4, position relative to the extent: for lifted scenes.
    "scene": _SCENE,
    # Closed loop at the steps where a trained tree starts to lose image quality.
    "trained": _TRAINED,
    # The paper's proof of concept: 8 bits by range, open loop.
    "paper": Settings(RangeBits(8), closed_loop=False, n_alpha=256),
    "near-lossless": Settings(NearLossless(), n_alpha=256, alpha_bits=7),
}
