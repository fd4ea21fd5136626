"""Distilling: coarse levels of a lifted tree, improved against pictures of the scene itself.

A lifted parent lies on the line through its children, which is a poor place for its scale: it has
to cover both, and children that are alike leave it no way to grow. Lifting corrects the worst
pairs: a refine after the split puts C2 right. Here a share of the others are corrected too, those
of which the pictures show most. Gradient descent finds the scales of all corrected parents. All
other numbers stay as lifting chose them. From the finest level up, so that all children are known.

Letters: n splats of a level, S of them parents of splats of the next, D channels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from evogs_codec import EvolutionTree, SplatParams
from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.lifting.parents import (
    OFF_LINE,
    Moments,
    line_parents,
    median_mass,
    merged,
    moments,
)
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.splats import F64, I64
from evogs_codec.render import Camera, draw, gradients
from evogs_codec.render.views import Colour, Views, view_of
from reference_trainer.distil.generations import Generation, levels_of, tree_of
from reference_trainer.models.kernels import adam

__all__ = ["Change", "Distilled", "distil"]

MORE_OFF_LINE = 0.1  # of the pairs of a level
RATE, LAST_RATE = 0.03, 0.003  # of a log-scale, at the first and the last iteration
BETA1, BETA2, EPS = 0.9, 0.99, 1e-15
WHITE = (1.0, 1.0, 1.0)
SCALE = GROUP_CHANNELS[2]


@dataclass(frozen=True)
class Change:
    """What became of a level.

    Attributes:
        level: which.
        before: PSNR over the held-out views with the parents that lifting gave it, dB.
        found: with those that descent found.
    """

    level: int
    before: float
    found: float

    @property
    def gains(self) -> bool:
        """Whether the level has the parents that were found."""
        return self.found > self.before


@dataclass(frozen=True, eq=False)
class Distilled:
    """A tree with the leaves of the lifted one, and the changes of its levels, coarsest first."""

    tree: EvolutionTree
    changes: tuple[Change, ...]


def distil(
    tree: EvolutionTree,
    cameras: Sequence[Camera],
    held_out: Sequence[Camera],
    *,
    iterations: int,
    background: Colour = WHITE,
    progress: Progress | None = None,
) -> Distilled:
    """A lifted tree with coarse levels that look more like its last one.

    Args:
        tree: as `lift` makes them.
        cameras: of the pictures that are descended on.
        held_out: a level that does not gain in these views keeps its parents.
        iterations: of each level, a picture each.
        background: behind the splats.
        progress: called with the stage "refine" and the part that is done.

    Raises:
        ValueError: the tree is not lifted, there are no cameras, or less than 2 iterations.
    """
    if not cameras or not held_out:
        raise ValueError("there are no cameras, or none is held out")
    if iterations < 2:
        raise ValueError(f"{iterations} iterations, expected at least 2")
    levels, generations = levels_of(tree)
    if not generations:
        return Distilled(tree, ())
    report = partial(progress or no_progress, "refine")
    views, judge = (Views(tree.leaves(), part, background) for part in (cameras, held_out))
    n_done = count(1)
    descent = _Descent(
        views, iterations, lambda: report(next(n_done) / (iterations * len(generations)))
    )
    mass = moments(levels[-1])
    unit_mass = median_mass(mass)
    changes = []
    for level, generation in reversed(list(enumerate(generations))):
        target = merged(*generation.pairs(mass))
        finer = levels[level + 1]
        found, alpha = descent.coarser(finer, generation, target, unit_mass)
        kept = generation.coarser(finer, levels[level][:, generation.slots])
        change = Change(level, judge.psnr(_splats(kept)), judge.psnr(_splats(found)))
        if change.gains:
            generations[level] = replace(generation, alpha=alpha)
        levels[level] = found if change.gains else kept
        changes.append(change)
        mass = generation.coarser_moments(mass, target)
    report(1.0)
    return Distilled(tree_of(tree.sh_degree, levels, generations), tuple(reversed(changes)))


@dataclass(frozen=True)
class _Descent:
    """How levels are found.

    Attributes:
        views: what is descended on.
        iterations: of each level.
        tick: called after each.
    """

    views: Views
    iterations: int
    tick: Callable[[], None]

    def coarser(
        self, finer: F64, generation: Generation, target: Moments, unit_mass: float
    ) -> tuple[F64, F64]:
        """The coarser level (D, n) and its alpha (5, S); `target`, `unit_mass` as `line_parents`.

        The scales of all parents descend, to see which of them pay; then of those alone, and of
        those that lifting corrects.
        """
        parents, alpha = line_parents(*generation.children(finer), target, unit_mass)
        slots, first = generation.slots, self.iterations // 2
        free = self.descended(generation.coarser(finer, parents), slots, first)
        change = free[SCALE, slots] - parents[SCALE]
        shown = self.views.sensitivity(_splats(free))[SCALE, slots]
        worth = (shown * np.square(change)).sum(axis=0)
        is_mended = alpha[2] == OFF_LINE
        worth[is_mended] = np.inf
        n_mended = np.count_nonzero(is_mended) + round(MORE_OFF_LINE * len(worth))
        rows = np.sort(np.argsort(-worth, kind="stable")[:n_mended])
        parents[SCALE, rows] = free[SCALE, slots[rows]]
        alpha[2, rows] = OFF_LINE
        found = generation.coarser(finer, parents)
        return self.descended(found, slots[rows], self.iterations - first), alpha

    def descended(self, level: F64, slots: I64, iterations: int) -> F64:
        """A level (D, n) after gradient descent on the squared error, by the scales in `slots`."""
        if not len(slots):
            return level
        splats = _splats(level)
        scales = splats.log_scales.copy()
        moving = scales[slots]
        m, v = np.zeros_like(moving), np.zeros_like(moving)
        for t in range(iterations):
            view = view_of(t, len(self.views.cameras))
            splats = replace(splats, log_scales=scales)
            drawing = draw(splats, self.views.cameras[view], self.views.background)
            error = drawing.image - self.views.pictures[view]
            gradient = gradients(drawing, splats, error * np.float32(2 / error.size)).log_scales
            rate = np.full(3, RATE * (LAST_RATE / RATE) ** (t / iterations), np.float32)
            adam(moving, gradient[slots], m, v, rate, BETA1, BETA2, EPS, t + 1)
            scales[slots] = moving
            self.tick()
        out = level.copy()
        out[SCALE] = scales.T
        return out


def _splats(level: F64) -> SplatParams:
    return SplatParams.from_channels(level)
