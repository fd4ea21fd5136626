"""Steps that are held back: pictures stay as they were until the last of them.

A level may look worse than the one before it, and so may the state in which some of its splats are
split. Where it does, its splits only make room: one child is the parent, the other is not seen. A
refine at the end of the run makes all splats what they are to be, at once.

Letters: D channels, K classes (spec 3.2), R records of the refine, S splits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS
from evogs_codec.model.hiding import hiding
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F64, I32, I64
from evogs_codec.model.tree import EvolutionTree, Kind, Slots, Step

__all__ = ["Run", "held"]

# Of a split that only makes room; rotation has alpha 0 in lifted trees, position and SH have 1.
ALPHAS = ((1.0,), (0.0,), (0.0,), (0.0,), (1.0,))

_OPACITY = GROUP_CHANNELS[3].start
Weights = Sequence[StepWeights | None]


@dataclass(frozen=True)
class Run:
    """Steps that are held back together, of each tile.

    Attributes:
        first, last: a level and which of its steps; a tile may have fewer in that level.
    """

    first: tuple[int, int]
    last: tuple[int, int]

    def rows(self, tile: EvolutionTree) -> I64:
        """Which steps of a tile they are: in a row, perhaps none."""
        found, level, number = [], -1, 0
        for row, step in enumerate(tile.steps):
            number = number + 1 if step.level == level else 0
            level = step.level
            if self.first <= (level, number) <= self.last:
                found.append(row)
        return np.array(found, np.int64)


def held(
    tile: EvolutionTree, weights: Weights, runs: Sequence[Run]
) -> tuple[EvolutionTree, tuple[StepWeights | None, ...]]:
    """A tile with these runs held back, and the weights of its steps.

    The state after each run is that of the tile. Steps that only make room have no weights: their
    numbers are coded as they are.
    """
    for run in runs:
        rows = run.rows(tile)
        if len(rows) > 1 and all(_splits_or_refines(tile.steps[row]) for row in rows):
            tile, weights = _with_run(tile, weights, int(rows[0]), int(rows[-1]) + 1)
    return tile, tuple(weights)


def _splits_or_refines(step: Step) -> bool:
    return not step.n_adds and not np.any(step.kinds == Kind.DROP)


def _with_run(
    tile: EvolutionTree, weights: Weights, begin: int, end: int
) -> tuple[EvolutionTree, Weights]:
    """With the steps from `begin` to `end` held back."""
    run = tile.steps[begin:end]
    (*_, goal) = islice(tile.states(), end)
    goal = replace(goal, values=goal.values.copy())
    before = replace(tile, steps=tile.steps[:begin])
    rooms = list(_rooms(before, run))
    roomy = replace(tile, steps=(*before.steps, *rooms))
    (*_, state) = roomy.states()
    slots = np.unique(np.concatenate([_written(step, n) for step, n in _counted(tile, begin, end)]))
    refine = replace(
        Step.of_refines(run[-1].level, slots, goal.values[:, slots] - state.values[:, slots]),
        changed_picks=goal.picks[slots] if tile.palette is not None else goal.picks[:0],
    )
    own = _weights_of(tile, weights, begin, end, slots)
    steps = (*roomy.steps, refine, *tile.steps[end:])
    return replace(tile, steps=steps), (
        *weights[:begin],
        *(None for _ in rooms),
        own,
        *weights[end:],
    )


def _rooms(before: EvolutionTree, run: Sequence[Step]) -> Iterator[Step]:
    """Splits as of the run, after which pictures are those of before."""
    values, picks = _last(before)
    for step in run:
        slots = step.slots[step.kinds == Kind.SPLIT]
        if not len(slots):
            continue
        psi = np.zeros((len(step.psi), len(slots)))
        psi[_OPACITY] = hiding(values[_OPACITY, slots])
        room = Step.of_splits(step.level, slots, psi, np.tile(np.array(ALPHAS), len(slots)))
        yield replace(room, picks=picks[slots]) if before.palette is not None else room
        seconds = values[:, slots]
        values[:, slots] += room.psi
        values = np.concatenate([values, seconds], axis=1)
        picks = np.concatenate([picks, picks[slots]])


def _last(tree: EvolutionTree) -> tuple[F64, I32]:
    """Values (D, n) and picks (n,) of the slots after all steps of a tree, copied."""
    state: Slots
    (*_, state) = tree.states()
    return state.values.copy(), state.picks.copy()


def _counted(tile: EvolutionTree, begin: int, end: int) -> Iterator[tuple[Step, int]]:
    """These steps, and how many slots there are before each."""
    n = sum(step.n_new for step in tile.steps[:begin])
    for step in tile.steps[begin:end]:
        yield step, n
        n += step.n_new


def _written(step: Step, n: int) -> I64:
    """Slots that a step writes, where there were n."""
    return np.append(step.slots, np.arange(n, n + step.n_new)).astype(np.int64)


def _weights_of(
    tile: EvolutionTree, weights: Weights, begin: int, end: int, slots: I64
) -> StepWeights:
    """Of the refine of these slots (R,): of each, those of the last step that wrote it."""
    n_slots = sum(step.n_new for step in tile.steps[:end])
    found = np.zeros((N_GROUPS + tile.sh_degree, n_slots), np.float32)
    for (step, n), own in zip(_counted(tile, begin, end), weights[begin:end], strict=True):
        if own is not None:  # what only makes room is refined in the same run
            found[:, _written(step, n)] = np.concatenate([own.targets, own.new], axis=1)
    born_from, _ = tile.lineage()
    siblings = Siblings.of(slots.astype(np.int32), born_from)
    return StepWeights(tile.steps[end - 1].level, found[:, slots], found[:, :0], siblings)
