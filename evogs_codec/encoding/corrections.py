"""Corrections: steps that only refine what steps of their level have just written.

A lifted tree has them where two children are on no line with their parent: it is split into itself
and a splat that is not seen, and a correction makes both what they are to be.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = ["corrections", "only_refines"]


def only_refines(step: Step) -> bool:
    """Whether a step neither splits, adds nor drops."""
    return not step.n_new and bool(np.all(step.kinds == Kind.REFINE))


def corrections(tree: EvolutionTree) -> list[bool]:
    """Which steps are corrections."""
    found, level, n = [], -1, 0
    written = np.zeros(sum(step.n_new for step in tree.steps), bool)
    for step in tree.steps:
        if step.level != level:
            written[:] = False
        level = step.level
        found.append(
            bool(len(step.slots)) and only_refines(step) and bool(written[step.slots].all())
        )
        written[step.slots] = True
        written[n : n + step.n_new] = True
        n += step.n_new
    return found
