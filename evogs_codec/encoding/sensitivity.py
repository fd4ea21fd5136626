"""Importance: what an error in a number of a tree does to the picture, record by record.

An error of a parent is an error of its children: C1 and C2 lie on a line through P. So the weight
of a record is that of all leaves below it, as far as their own psi cannot correct it.

Letters: K classes (spec 3.2), n slots, N splats of a cut, P refines and splits of a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.encoding.error_factors import USUAL_FACTORS, ErrorFactors
from evogs_codec.encoding.pictures import Pictures
from evogs_codec.model.channels import (
    N_GROUPS,
    channel_class,
    n_channels,
    n_classes,
)
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32, F64, SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = [
    "SEEN_SHARE_OF_CIRCLE",
    "Importance",
    "Sensitivity",
    "StepWeights",
    "cuts_of",
    "steps_of_entries",
]

# (D, N) per number of a splat: mean squared change of the pictures to its squared change.
Sensitivity: TypeAlias = Callable[[SplatParams], F32]

# What a linear estimate misses, as splats change places in depth and footprints bend. Measured by
# noise of a step in one class: positions 2.4 and 9 times, rotations 1.2 and 2.2, scales 1.2 and 1.9
# (a lifted scene, a trained tree); the others 1.0 to 1.9.
BEYOND_LINEAR = (4.0, 2.0, 2.0, 1.4, 1.0, 1.0, 1.0, 1.0)
SEEN_SHARE = 0.98  # the rest of a weight is the mean of the class: the views do not show everything
SEEN_SHARE_OF_CIRCLE = 0.9  # the same, where no view stands below or far above
MIN_WEIGHT = 0.1  # part of the weight that asks for the largest step; no weight is below it
# Beyond this logit, or its negative, a splat is opaque in float32, or not there, and pictures show
# no error that leaves it so. It weighs `MIN_WEIGHT` of the mean all the same, and stays what it is.
OPAQUE_LOGIT = 17.0
SQUARED_STEPS_PER_BIT = 6.0 / math.log(2)  # of the price of a bit is what a squared step is worth
CORRECTED_LATER = 0.05  # weight of an error that psi of the children may correct: that costs bits
# Beyond these a step has nothing to do with the linear estimate; position: part of the extent.
LARGEST_STEPS = (0.02, 0.3, 0.5, 1.0, 0.5, 0.7, 0.7, 0.7)
_ROTATION, _OPACITY = 1, 3


@dataclass(frozen=True, eq=False)
class StepWeights:
    """Mean squared error of the pictures per squared error of a number that a step makes.

    Attributes:
        level: of the step.
        targets: (K, P) of the splats that are refined or become C1.
        new: (K, n_new) of the C2s, then of the adds.
        siblings: of a step of refines whose psi may be sibling differences.
        empty: classes of which adds have zeros.
    """

    level: int
    targets: F32
    new: F32
    siblings: Siblings | None = None
    empty: frozenset[int] = frozenset()

    def times(self, factor: np.float32 | F32) -> StepWeights:
        """All weights times a number, or times those of their classes (K, 1)."""
        return replace(self, targets=self.targets * factor, new=self.new * factor)

    def without(self, classes: Collection[int]) -> StepWeights:
        """0 for all numbers of some classes, which adds do not have either."""
        targets, new = self.targets.copy(), self.new.copy()
        targets[list(classes)], new[list(classes)] = 0, 0
        return replace(self, targets=targets, new=new, empty=self.empty.union(classes))

    def more(self, lack: F32) -> StepWeights:
        """`lack` (K, 1) added to all weights."""
        return replace(self, targets=self.targets + lack, new=self.new + lack)


@dataclass(frozen=True, eq=False)
class Importance:
    """Of a whole tree.

    Attributes:
        weights: of every step of every tile; None of one that is coded as it is.
        means: (1 + n_levels, K) mean over the numbers of the adds, then of psi of each level.
        entries: (degree, n) of the numbers of the entries of a palette, per SH band; None without.
            Their means stand in `means`, after those of the classes of core.
        leaves: per tile (K, N) of the leaves of the last level, each on its own.
        seen: part of a weight that the views decide; the rest is the mean of the class.
        factors: of these estimates, by the price of a bit; None: they are right.
    """

    weights: tuple[tuple[StepWeights | None, ...], ...]
    means: F64
    leaves: tuple[F32, ...]
    entries: F32 | None = None
    seen: float = SEEN_SHARE
    factors: ErrorFactors | None = None

    @staticmethod
    def of(
        tiles: Sequence[EvolutionTree],
        n_levels: int,
        sensitivity: Sensitivity,
        *,
        first: int = 0,
        seen: float = SEEN_SHARE,
        progress: Progress = no_progress,
    ) -> Importance:
        """By the pictures of every level of arranged tiles, from the level `first` on.

        A level before the last may lose as much as the last, although it has fewer splats.
        """
        cuts = cuts_of(tiles, n_levels, sensitivity, first=first, seen=seen, progress=progress)
        return Importance.of_cuts(tiles, n_levels, cuts, seen=seen)

    @staticmethod
    def of_cuts(
        tiles: Sequence[EvolutionTree],
        n_levels: int,
        cuts: Sequence[Sequence[F32]],
        *,
        seen: float = SEEN_SHARE,
    ) -> Importance:
        """By the cuts of the last levels (`cuts_of`)."""
        first = n_levels - len(cuts)
        counts = [sum(part.shape[1] for part in cut) for cut in cuts]
        shares = [n / max(counts[-1], 1) for n in counts]
        weights = tuple(
            _of_tile(tile, first, [share * cut[k] for share, cut in zip(shares, cuts, strict=True)])
            for k, tile in enumerate(tiles)
        )
        means = _means(tiles, weights, n_levels)
        if tiles[0].palette is None:
            return Importance(weights, means, tuple(cuts[-1]), seen=seen)
        entries = _of_entries(tiles, first, shares, cuts)
        of_each = entries.mean(1) if entries.size else np.zeros(len(entries), np.float32)
        of_bands = np.broadcast_to(of_each, (1 + n_levels, len(entries)))
        means = np.concatenate([means, of_bands], axis=1)
        return Importance(weights, means, tuple(cuts[-1]), entries, seen)

    def measured(
        self,
        tiles: Sequence[EvolutionTree],
        pictures: Pictures,
        extent: float,
        known: dict[int, F64] | None = None,
    ) -> Importance:
        """With what estimates of these tiles miss in pictures of their leaves.

        Args:
            tiles: arranged.
            pictures: of their leaves.
            extent: of the scene.
            known: what is measured already, which is added to (`ErrorFactors`).
        """
        factors = ErrorFactors(
            SplatParams.joined([tile.shared_leaves() for tile in tiles]),
            np.concatenate(self.leaves, axis=1),
            lambda price: self.steps_of_leaves(price, extent),
            pictures,
            tiles[0].palette is not None,
            {} if known is None else known,
        )
        return replace(self, factors=factors)

    def as_others(self) -> Importance:
        """With the factors of other scenes (`USUAL_FACTORS`), where nothing is measured."""
        factors = np.ones(self.means.shape[1], np.float32)
        factors[: len(USUAL_FACTORS)] = USUAL_FACTORS
        return self.times(factors)

    def at(self, price: float) -> Importance:
        """With what its estimates miss at a price of a bit."""
        if self.factors is None:
            return self
        factors = np.ones(self.means.shape[1], np.float32)
        found = self.factors.at(price)
        factors[: len(found)] = found
        return replace(self.times(factors), factors=None)

    def times(self, factors: F32) -> Importance:
        """All weights times those of their classes (K,); of entries the means alone."""
        column = factors[:, None]
        return replace(
            self,
            weights=tuple(
                tuple(w and w.times(column[: len(w.targets)]) for w in steps)
                for steps in self.weights
            ),
            means=self.means * factors,
            leaves=tuple(weights * column[: len(weights)] for weights in self.leaves),
        )

    def steps(self, price: float, extent: float) -> F64:
        """(1 + n_levels, K) steps at which a bit more saves `price` of mean squared error.

        With step s and weight w an error costs w s^2 / 12, a quarter of that with another bit.
        Rotations of lifted splats are (1, g): 1 is a multiple of the step of adds, or all splats
        would turn together.
        """
        steps = self._steps(self.means, price, extent)
        steps[0, _ROTATION] = 1 / np.ceil(1 / steps[0, _ROTATION])
        return steps

    def steps_of_leaves(self, price: float, extent: float) -> F64:
        """(K,) likewise, of psi that change one leaf each."""
        return self._steps(self._means_of_leaves(), price, extent)

    def raised(self, price: float, extent: float) -> tuple[tuple[StepWeights | None, ...], ...]:
        """The weights, and more where the largest step is taken.

        Pictures that hardly show an error say nothing of one that is many steps large. What would
        have asked for that step is added, as far as splats that no view shows have it elsewhere,
        and `MIN_WEIGHT` of it at least.
        """
        lack = self._lack(self.means, price, extent)[1:, :, None]
        if not lack.any():
            return self.weights
        return tuple(
            tuple(w and w.more(lack[w.level, : len(w.targets)]) for w in steps)
            for steps in self.weights
        )

    def raised_leaves(self, price: float, extent: float) -> list[F32]:
        """Per tile (K, N) likewise, of leaves."""
        lack = self._lack(self._means_of_leaves(), price, extent)[:, None]
        return [weights + lack for weights in self.leaves]

    def _means_of_leaves(self) -> F64:
        """(K,)."""
        together: F64 = np.concatenate(self.leaves, axis=1).mean(axis=1, dtype=np.float64)
        return together

    def _steps(self, means: F64, price: float, extent: float) -> F64:
        found = np.sqrt(SQUARED_STEPS_PER_BIT * price / np.maximum(means, 1e-300))
        steps: F64 = np.minimum(found, self._largest(extent))
        return steps

    def _lack(self, means: F64, price: float, extent: float) -> F32:
        """What `raised` adds to weights with these means."""
        asking = SQUARED_STEPS_PER_BIT * price / np.square(self._largest(extent))
        part = max(1 - self.seen, MIN_WEIGHT)
        lack: F32 = (part * np.maximum(asking - means, 0)).astype(np.float32)
        return lack

    def _largest(self, extent: float) -> F64:
        """(K,) steps."""
        largest = np.array(LARGEST_STEPS[: self.means.shape[1]])
        largest[0] *= extent
        return largest


def cuts_of(
    tiles: Sequence[EvolutionTree],
    n_levels: int,
    sensitivity: Sensitivity,
    *,
    first: int = 0,
    seen: float = SEEN_SHARE,
    progress: Progress = no_progress,
) -> list[list[F32]]:
    """Per level from `first` on, tile by tile, (K, N) what errors of its leaves are worth.

    K has all SH bands that are shown, also of tiles that have them in a palette.
    """
    shown = zip(*(_shown(tile, first) for tile in tiles), strict=True)
    cuts = []
    for k, parts in zip(range(first, n_levels), shown, strict=False):
        cuts.append(_cut(parts, sensitivity, seen))
        progress("draw", ((k + 1) / n_levels) ** 2)  # the last levels have most of the splats
    return cuts


def steps_of_entries(means: F64, price: float) -> F64:
    """(degree,) steps of entries of a palette with these mean weights, as of `Importance.steps`."""
    found = np.sqrt(SQUARED_STEPS_PER_BIT * price / np.maximum(means, 1e-300))
    steps: F64 = np.minimum(found, LARGEST_STEPS[N_GROUPS : N_GROUPS + len(means)])
    return steps


def _of_entries(
    tiles: Sequence[EvolutionTree],
    first: int,
    shares: Sequence[float],
    cuts: Sequence[Sequence[F32]],
) -> F32:
    """(degree, n) of each entry: the sum of those of the splats that pick it, of drawn levels."""
    palette = tiles[0].palette
    assert palette is not None, "who has entries has a palette"
    sums = np.zeros((palette.degree, 1 + palette.entries.shape[1]))
    for number, tile in enumerate(tiles):
        ends = [step.level for step in tile.steps[1:]] + [first + len(cuts)]
        for step, end, state in zip(tile.steps, ends, tile.states(slice(0)), strict=True):
            for level in range(max(step.level, first), end):
                weights = shares[level - first] * cuts[level - first][number][5:]
                for band, row in enumerate(weights):
                    sums[band] += np.bincount(state.picks[state.live], row, sums.shape[1])
    return sums[:, 1:].astype(np.float32)


def _shown(tile: EvolutionTree, first: int) -> Iterator[SplatParams]:
    """The leaves of each level from `first` on; a tile may end before the last level."""
    shown = SplatParams.from_channels(np.zeros((n_channels(tile.shown_degree), 0)))
    for shown in tile.levels(min(first, tile.n_levels - 1)):
        yield shown
    yield from repeat(shown)


def _cut(parts: Sequence[SplatParams], sensitivity: Sensitivity, seen: float) -> list[F32]:
    """(K, N) weights of the leaves of a level, tile by tile, of all bands that splats have."""
    splats = SplatParams.joined(parts)
    if not len(splats):
        return [np.zeros((5 + part.sh_degree, 0), np.float32) for part in parts]
    found = sensitivity(splats)
    kinds = np.array([channel_class(c) for c in range(len(found))])
    weights = np.stack(
        [BEYOND_LINEAR[k] * found[kinds == k].mean(0) for k in range(kinds.max() + 1)]
    ).astype(np.float32)
    means = weights.mean(1, keepdims=True)
    weights = seen * weights + (1 - seen) * means
    is_decided = np.abs(splats.opacity_logits) >= OPAQUE_LOGIT
    weights[_OPACITY] = np.maximum(weights[_OPACITY], MIN_WEIGHT * means[_OPACITY] * is_decided)
    ends = np.cumsum([len(part) for part in parts])
    return np.split(weights, ends[:-1], axis=1)


def _of_tile(tile: EvolutionTree, first: int, cuts: Sequence[F32]) -> tuple[StepWeights, ...]:
    """Weights of each step, from the last to the first, from those of the leaves of levels."""
    live = list(_live(tile))
    later = np.zeros(
        (n_classes(tile.sh_degree), sum(step.n_new for step in tile.steps)), np.float32
    )
    out: list[StepWeights] = []
    for k in reversed(range(len(tile.steps))):
        step, n_after = tile.steps[k], len(live[k])
        last = k + 1 == len(tile.steps)
        end = first + len(cuts) if last else tile.steps[k + 1].level
        for level in range(max(step.level, first), end):
            # They are leaves of these levels.
            later[:, np.flatnonzero(live[k])] += cuts[level - first][: len(later)]
        n = n_after - step.n_new
        has_psi = step.kinds != Kind.DROP
        new = later[:, n:n_after].copy()
        out.append(StepWeights(step.level, later[:, step.slots[has_psi]], new))
        _pass_on(later, step, n)
    return tuple(reversed(out))


def _live(tile: EvolutionTree) -> Iterator[npt.NDArray[np.bool_]]:
    """Which slots are live after each step."""
    live = np.zeros(0, bool)
    for step in tile.steps:
        live = np.append(live, np.ones(step.n_new, bool))
        live[step.slots[step.kinds == Kind.DROP]] = False
        yield live


def _pass_on(later: F32, step: Step, n: int) -> None:
    """Weights after a step become those before it, in place; n slots were there before."""
    splits = step.slots[step.kinds == Kind.SPLIT]
    groups = np.minimum(np.arange(len(later)), 4)
    alpha = step.alpha[groups].astype(np.float32)
    # Of a shift of both C1 and C2 psi corrects all but its part across (alpha, 1).
    kept = np.maximum(np.square(1 + alpha) / (2 * (1 + np.square(alpha))), CORRECTED_LATER)
    later[:, splits] = kept * (later[:, splits] + later[:, n : n + len(splits)])
    later[:, step.slots[step.kinds == Kind.REFINE]] *= CORRECTED_LATER
    later[:, step.slots[step.kinds == Kind.DROP]] = 0
    later[:, n : n + step.n_new] = 0


def _means(
    tiles: Sequence[EvolutionTree], weights: Sequence[Sequence[StepWeights]], n_levels: int
) -> F64:
    """(1 + n_levels, K); where a level has nothing of its own, the mean of all."""
    sums = np.zeros((1 + n_levels, n_classes(tiles[0].sh_degree)))
    counts = np.zeros(1 + n_levels)
    for tile, steps in zip(tiles, weights, strict=True):
        for step, own in zip(tile.steps, steps, strict=True):
            n_splits = step.alpha.shape[1]
            for row, part in (
                (0, own.new[:, n_splits:]),
                (1 + step.level, own.targets),
                (1 + step.level, own.new[:, :n_splits]),
            ):
                sums[row] += part.sum(1, dtype=np.float64)
                counts[row] += part.shape[1]
    overall = sums.sum(0) / max(counts.sum(), 1)
    means: F64 = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], overall)
    return means
