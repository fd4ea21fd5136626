"""A trained frontier as steps of an `EvolutionTree`: splits whose children live, and what is left.

A split with one live child becomes a refine, or nothing where that child is dead too: pruning has
no record of its own inside a level. Leaves of earlier levels that die are dropped.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, SplatParams
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.splats import F32
from evogs_codec.model.tree import Kind, Step
from reference_trainer.models.blocks import Block, Collinear, Refined
from reference_trainer.models.frontier import Frontier

__all__ = ["drops", "frontier_steps", "opacity_refines", "roots"]

Array = npt.NDArray[Any]
I64 = npt.NDArray[np.int64]
BOTH, FIRST, SECOND, NONE = 3, 1, 2, 0  # which children of a split live
OPACITY_CHANNEL = 10


def roots(splats: SplatParams, level: int = 0) -> Step:
    """The step that adds `splats`, their quaternions normalised and w >= 0.

    Rotations change by additions, so their size must mean the same for every splat.
    """
    channels = splats.channels()
    quats = channels[3:7].astype(np.float64)
    length = np.linalg.norm(quats, axis=0)
    quats[0, length == 0] = length[length == 0] = 1
    channels[3:7] = quats / length * np.where(quats[0] < 0, -1, 1)
    return Step.of_adds(level, channels)


def drops(slots: I64, level: int, d: int) -> Step:
    """The step that empties `slots`, in rising order; D channels."""
    kinds = np.full(len(slots), Kind.DROP, np.uint8)
    empty = np.empty((d, 0), np.float32)
    alpha = np.empty((N_GROUPS, 0), np.float32)
    return Step(level, slots.astype(np.int32), kinds, empty, alpha, empty)


def opacity_refines(slots: I64, changes: F32, level: int, d: int) -> Step:
    """The step that adds `changes` to the opacity logits of `slots`, in rising order."""
    psi = np.zeros((d, len(slots)), np.float32)
    psi[OPACITY_CHANNEL] = changes
    refines = np.full(len(slots), Kind.REFINE, np.uint8)
    return _step(level, slots, refines, psi, np.empty((N_GROUPS, 0)))


def frontier_steps(tree: EvolutionTree, frontier: Frontier, level: int) -> tuple[Step, ...]:
    """The steps of `level`, on the tree whose leaves the frontier was made of."""
    *_, state = tree.states()
    base = np.flatnonzero(state.live)
    n_slots = len(state.live)
    d = len(state.values)
    alive = frontier.live.copy()
    living = [_living(block, alive) for block in reversed(frontier.blocks)][::-1]
    # Slots of the frontier become slots of the tree, one step after the other.
    name = np.full(len(frontier.live), -1, np.int64)
    name[: len(base)] = base
    values = np.empty((len(frontier.live), d), np.float32)
    values[: len(base)] = state.values[:, base].T
    steps = []
    dead = np.flatnonzero(~alive[: len(base)])
    if len(dead):
        steps.append(drops(name[dead], level, d))
    for block, lives in zip(frontier.blocks, living, strict=True):
        parents = values[block.slots]
        changes = block.changes(parents)
        made, new = _steps_of(block, lives, changes, name, n_slots, level)
        steps += made
        n_slots += new
        values[block.slots] = parents + changes[0]
        if block.n_new:
            values[block.first : block.first + block.n_new] = parents + changes[1]
    return tuple(steps) or (Step.of_adds(level, np.empty((d, 0), np.float32)),)


def _living(block: Block, alive: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """(m,) which children have live leaves; `alive` after the block becomes that before it."""
    if not block.n_new:
        return (FIRST * alive[block.slots]).astype(np.uint8)
    second = block.first + np.arange(block.n_new)
    lives = FIRST * alive[block.slots] + SECOND * alive[second]
    alive[block.slots] = lives != NONE
    return lives.astype(np.uint8)


def _steps_of(
    block: Block,
    lives: npt.NDArray[np.uint8],
    changes: tuple[Array, Array],
    name: I64,
    n_slots: int,
    level: int,
) -> tuple[list[Step], int]:
    """The steps of a block and how many slots they make; names the children's slots."""
    second = block.first + np.arange(len(block.slots))
    rows = np.flatnonzero(lives != NONE)
    rows = rows[np.argsort(name[block.slots[rows]])]
    slots = name[block.slots[rows]]
    splits = rows[lives[rows] == BOTH]
    new = n_slots + np.arange(len(splits))
    # Where only C2 lives, it takes the slot, and C1 has none.
    only_second = rows[lives[rows] == SECOND]
    name[second[only_second]] = name[block.slots[only_second]]
    name[second[splits]] = new
    kinds = np.where(lives[rows] == BOTH, Kind.SPLIT, Kind.REFINE).astype(np.uint8)
    psi = np.where(lives[rows, None] == SECOND, changes[1][rows], changes[0][rows])
    if isinstance(block, Refined):
        return [_step(level, slots, kinds, psi.T, np.empty((N_GROUPS, 0)))], 0
    if isinstance(block, Collinear):
        alpha = block.alpha.value.detach().cpu().numpy()[splits]
        return [_step(level, slots, kinds, psi.T, alpha.T)], len(splits)
    # Two free children are a split with alpha 0, whose C2 is the parent, and a refine of that.
    alpha = np.zeros((N_GROUPS, len(splits)), np.float32)
    refines = np.full(len(splits), Kind.REFINE, np.uint8)
    steps = [
        _step(level, slots, kinds, psi.T, alpha),
        _step(level, new, refines, changes[1][splits].T, alpha[:, :0]),
    ]
    return steps, len(splits)


def _step(level: int, slots: I64, kinds: Array, psi: Array, alpha: Array) -> Step:
    return Step(
        level,
        slots.astype(np.int32),
        kinds,
        np.ascontiguousarray(psi, np.float32),
        np.ascontiguousarray(alpha, np.float32),
        np.empty((len(psi), 0), np.float32),
    )
