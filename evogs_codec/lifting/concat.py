"""Trees side by side as one tree.

Letters: n slots of a tree, R records of a step, S of them splits, D channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from evogs_codec.model.splats import I64
from evogs_codec.model.tree import EvolutionTree, Step, columns_of

__all__ = ["joined"]

Place: TypeAlias = tuple[int, int]  # level, number of the step in it


def joined(trees: Sequence[EvolutionTree]) -> tuple[EvolutionTree, list[I64]]:
    """The tree whose k-th step of a level has the records of the k-th step there of each tree.

    Args:
        trees: at least one, all of the same degree.

    Returns:
        The tree, and for each of `trees` (n,) where its slots are in it.
    """
    by_place = [_steps_by_place(tree) for tree in trees]
    slot_of: list[I64] = [np.empty(0, np.int64) for _ in trees]
    steps, n = [], 0
    for place in sorted(set().union(*by_place)):
        here = [k for k, steps_of in enumerate(by_place) if place in steps_of]
        parts = [by_place[k][place] for k in here]
        slots = np.concatenate(
            [slot_of[k][part.slots] for k, part in zip(here, parts, strict=True)]
        )
        order = np.argsort(slots)
        kinds = np.concatenate([part.kinds for part in parts])
        psi, splits = columns_of(kinds, order)
        step = Step(
            place[0],
            slots[order].astype(np.int32),
            kinds[order],
            np.concatenate([part.psi for part in parts], axis=1)[:, psi],
            np.concatenate([part.alpha for part in parts], axis=1)[:, splits],
            np.concatenate([part.adds for part in parts], axis=1),
        )
        steps.append(step)
        second = np.empty(len(splits), np.int64)
        second[splits] = n + np.arange(len(splits))
        at_split, at_add = 0, n + len(splits)
        for k, part in zip(here, parts, strict=True):
            n_splits = part.alpha.shape[1]
            c2 = second[at_split : at_split + n_splits]
            slot_of[k] = np.concatenate([slot_of[k], c2, at_add + np.arange(part.n_adds)])
            at_split, at_add = at_split + n_splits, at_add + part.n_adds
        n += step.n_new
    return EvolutionTree(trees[0].sh_degree, tuple(steps)), slot_of


def _steps_by_place(tree: EvolutionTree) -> dict[Place, Step]:
    numbers: dict[int, int] = {}
    out = {}
    for step in tree.steps:
        numbers[step.level] = numbers.get(step.level, -1) + 1
        out[step.level, numbers[step.level]] = step
    return out
