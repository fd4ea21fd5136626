"""A lifted tree as the splats of each level and the splits between them, and back.

Letters: n splats of a level, S of them split, D channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec import EvolutionTree
from evogs_codec.lifting.parents import Moments
from evogs_codec.lifting.splitting import alpha_of, split_steps
from evogs_codec.model.splats import F32, F64, I64
from evogs_codec.model.tree import Kind, Step

__all__ = ["Generation", "levels_of", "tree_of"]


@dataclass(frozen=True, eq=False)
class Generation:
    """The splits from a level to the next.

    Attributes:
        slots: (S,) of the parents, then of the C1s; the C2s take the slots after the n.
        alpha: (5, S).
        n_before: n, splats of the coarser level.
    """

    slots: I64
    alpha: F32 | F64
    n_before: int

    def children(self, finer: F64) -> tuple[F64, F64]:
        """C1s and C2s (D, S), of the splats of the finer level."""
        return finer[:, self.slots], finer[:, self.n_before :]

    def coarser(self, finer: F64, parents: F64) -> F64:
        """(D, n) the splats of the coarser level, of those of the finer and the parents (D, S)."""
        out = finer[:, : self.n_before].copy()
        out[:, self.slots] = parents
        return out

    def pairs(self, finer: Moments) -> tuple[Moments, Moments]:
        """Moments of the C1s and the C2s."""
        return finer.take(self.slots), finer.take(np.arange(self.n_before, len(finer.mass)))

    def coarser_moments(self, finer: Moments, parents: Moments) -> Moments:
        """What `coarser` is to splats."""
        rows = np.arange(self.n_before)
        rows[self.slots] = self.n_before + np.arange(len(self.slots))
        return finer.take(np.arange(self.n_before)).followed_by(parents).take(rows)


def levels_of(tree: EvolutionTree) -> tuple[list[F64], list[Generation]]:
    """The splats (D, n) of each level, and the splits after each but the last.

    Raises:
        ValueError: a level is more than splits, and refines of what they give: it is not lifted.
    """
    levels: list[F64] = []
    generations: list[Generation] = []
    for number, (step, state) in enumerate(zip(tree.steps, tree.states(), strict=True)):
        if number and step.level == len(levels):
            if step.n_adds or np.any(step.kinds != Kind.SPLIT):
                raise ValueError(f"step {number}: a level of a lifted tree begins with splits")
            slots = step.slots.astype(np.int64)
            generations.append(Generation(slots, alpha_of(step), levels[-1].shape[1]))
        elif number and (step.n_adds or np.any(step.kinds != Kind.REFINE)):
            raise ValueError(f"step {number}: after its splits, a level of a lifted tree refines")
        levels[step.level :] = [state.values.copy()]
    return levels, generations


def tree_of(
    sh_degree: int, levels: Sequence[F64], generations: Sequence[Generation]
) -> EvolutionTree:
    """The inverse of `levels_of`."""
    steps = [Step.of_adds(0, levels[0].astype(np.float32))]
    pairs = zip(generations, levels, levels[1:], strict=False)
    for level, (generation, before, after) in enumerate(pairs, 1):
        parents = before[:, generation.slots]
        children = generation.children(after)
        slots, n_before = generation.slots, generation.n_before
        steps += split_steps(level, slots, n_before, parents, *children, generation.alpha)
    return EvolutionTree(sh_degree, tuple(steps))
