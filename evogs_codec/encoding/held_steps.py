"""Steps that are held back: pictures stay as they were until the last of them.

A level may look worse than the one before it, and so may the state in which some of its splats are
split. Where it does, its splits only make room: one child is the parent, the other is not seen. A
refine at the end of the run makes all splats what they are to be, at once.

Roots cannot be held back, since nothing would be there: where some of them look worse than fewer,
all come in one step.

Letters: D channels, K classes (spec 3.2), R records of the refine, S splits.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.corrections import only_refines
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.model.channels import GROUP_CHANNELS, n_classes
from evogs_codec.model.hiding import hiding
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F64, I32, I64
from evogs_codec.model.tree import EvolutionTree, Kind, Step, take_picks

__all__ = ["ROOTS", "Run", "held", "places", "rooms", "splits_or_refines"]

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
        found = [k for k, place in enumerate(places(tile)) if self.first <= place <= self.last]
        return np.array(found, np.int64)


ROOTS = Run((0, 0), (0, sys.maxsize))


def places(tile: EvolutionTree) -> Iterator[tuple[int, int]]:
    """Of each step of a tile, its level and which of the steps of the level it is."""
    level, number = -1, 0
    for step in tile.steps:
        number = number + 1 if step.level == level else 0
        level = step.level
        yield level, number


def held(
    tile: EvolutionTree, weights: Weights, runs: Sequence[Run]
) -> tuple[EvolutionTree, tuple[StepWeights | None, ...]]:
    """A tile with these runs held back, and the weights of its steps.

    The state after each run is that of the tile. Steps that only make room have no weights: their
    numbers are coded as they are. Of a run whose first step only refines, only the splats that it
    refines are held back, until the next level has begun: the others are as good without. Steps
    of a run that only add become one.
    """
    for run in sorted(runs, key=lambda run: run.first, reverse=True):  # rows of others stay
        rows = run.rows(tile)
        if not len(rows):
            continue
        begin, end = int(rows[0]), int(rows[-1]) + 1
        if not any(len(step.slots) for step in tile.steps[begin:end]):
            tile, weights = _with_adds_at_once(tile, weights, begin, end)
            continue
        is_held = np.ones(sum(step.n_new for step in tile.steps), bool)
        if only_refines(tile.steps[begin]):
            is_held[:] = False
            is_held[tile.steps[begin].slots] = True
            next_level = sum(step.level <= tile.steps[begin].level for step in tile.steps)
            end = min(max(end, next_level + 1), len(tile.steps))
        if end - begin > 1 and all(map(splits_or_refines, tile.steps[begin:end])):
            tile, weights = _with_run(tile, weights, begin, end, is_held)
    return tile, tuple(weights)


def _with_adds_at_once(
    tile: EvolutionTree, weights: Weights, begin: int, end: int
) -> tuple[EvolutionTree, Weights]:
    """With one step in the place of those from `begin` to `end`, which only add."""
    run, own = tile.steps[begin:end], weights[begin:end]
    whole = replace(
        run[0],
        adds=np.concatenate([step.adds for step in run], axis=1),
        picks=_picks_of_all(run),
    )
    known = [one for one in own if one is not None]
    of_whole = None
    if len(known) == len(run):
        new = np.concatenate([one.new for one in known], axis=1)
        of_whole = StepWeights(whole.level, known[0].targets, new)
    steps = (*tile.steps[:begin], whole, *tile.steps[end:])
    return replace(tile, steps=steps), (*weights[:begin], of_whole, *weights[end:])


def _picks_of_all(run: Sequence[Step]) -> I32:
    """Picks of steps that only add; (0,) if none has any."""
    if not any(len(step.picks) for step in run):
        return run[0].picks
    none = [np.zeros(step.n_new, np.int32) for step in run]
    return np.concatenate(
        [step.picks if len(step.picks) else own for step, own in zip(run, none, strict=True)]
    )


def splits_or_refines(step: Step) -> bool:
    """Whether a step neither adds nor drops."""
    return not step.n_adds and not np.any(step.kinds == Kind.DROP)


def rooms(tile: EvolutionTree, begin: int) -> list[Step]:
    """The steps of a tile from `begin` on, all splits or refines, in which splits only make room.

    Pictures stay as they were before, and slots are those that the steps make.
    """
    is_held = np.ones(sum(step.n_new for step in tile.steps), bool)
    weights = (None,) * len(tile.steps)
    return [step for step, _ in _held_run(tile, begin, len(tile.steps), weights, is_held)]


def _with_run(
    tile: EvolutionTree, weights: Weights, begin: int, end: int, is_held: npt.NDArray[np.bool_]
) -> tuple[EvolutionTree, Weights]:
    """With these slots (n,), and those that come from them, held back from `begin` to `end`."""
    run = tile.steps[begin:end]
    (*_, goal) = islice(tile.states(), end)
    goal = replace(goal, values=goal.values.copy())
    held_run = list(_held_run(tile, begin, end, weights, is_held))
    held_back = replace(tile, steps=(*tile.steps[:begin], *(step for step, _ in held_run)))
    (*_, state) = held_back.states()
    written = np.concatenate([_written(step, n) for step, n in _counted(tile, begin, end)])
    slots = np.unique(written[is_held[written]])
    refine = replace(
        Step.of_refines(run[-1].level, slots, goal.values[:, slots] - state.values[:, slots]),
        changed_picks=goal.picks[slots] if tile.palette is not None else goal.picks[:0],
    )
    of_refine = _weights_of(tile, weights, begin, end, slots)
    own = (*weights[:begin], *(own for _, own in held_run), of_refine, *weights[end:])
    return replace(tile, steps=(*held_back.steps, refine, *tile.steps[end:])), own


def _held_run(
    tile: EvolutionTree, begin: int, end: int, weights: Weights, is_held: npt.NDArray[np.bool_]
) -> Iterator[tuple[Step, StepWeights | None]]:
    """The steps from `begin` to `end` where held slots (n,) only make room: pictures of them stay.

    Slots that come from these are marked too.
    """
    born_from, _ = tile.lineage()
    opacity, picks = np.zeros(len(is_held)), np.zeros(len(is_held), np.int32)
    (*_, state) = islice(tile.states(), begin)
    n = len(state.live)
    opacity[:n] = state.values[_OPACITY]
    if tile.palette is not None:
        picks[:n] = state.picks
    for step, own in zip(tile.steps[begin:end], weights[begin:end], strict=True):
        kept = (step.kinds != Kind.REFINE) | ~is_held[step.slots]
        if not kept.any():
            continue
        if not kept.all():
            step, own = _some_of(step, own, kept, born_from)
        has_psi = step.kinds != Kind.DROP
        slots, splits = step.slots[has_psi], step.kinds[has_psi] == Kind.SPLIT
        is_room = is_held[slots]
        if is_room.any():
            step = _with_rooms(step, slots, is_room, opacity, picks)
            own = None if is_room.all() else own
        parents = opacity[slots]
        opacity[slots] += step.psi[_OPACITY]
        new = slice(n, n + step.n_new)
        opacity[new] = parents[splits] - step.alpha[3] * step.psi[_OPACITY, splits]
        is_held[new] = is_room[splits]
        take_picks(step, picks, n)
        n = new.stop
        yield step, own


def _some_of(
    step: Step, own: StepWeights | None, kept: npt.NDArray[np.bool_], born_from: I64
) -> tuple[Step, StepWeights | None]:
    """A step without some of its refines, and its weights; `kept` (R,) are the others."""
    slots, changed, has_psi = step.slots[kept], step.changed_picks, step.kinds != Kind.DROP
    some = replace(
        step,
        slots=slots,
        kinds=step.kinds[kept],
        psi=step.psi[:, kept[has_psi]],
        changed_picks=changed[kept[has_psi]] if len(changed) else changed,
    )
    if own is None:
        return some, None
    siblings = own.siblings and Siblings.of(slots, born_from)
    return some, replace(own, targets=own.targets[:, kept[has_psi]], siblings=siblings)


def _with_rooms(
    step: Step, slots: I32, is_room: npt.NDArray[np.bool_], opacity: F64, picks: I32
) -> Step:
    """The step whose splits `is_room` (P,) only make room.

    Args:
        step: splits, perhaps refines and drops.
        slots: (P,) those that it splits or refines.
        is_room: (P,) which of them.
        opacity: (n,) of all slots.
        picks: (n,) likewise.
    """
    psi, alpha = step.psi.copy(), step.alpha.copy()
    of_splits = is_room[step.kinds[step.kinds != Kind.DROP] == Kind.SPLIT]
    psi[:, is_room] = 0
    psi[_OPACITY, is_room] = hiding(opacity[slots[is_room]])
    alpha[:, of_splits] = ALPHAS
    found = replace(step, psi=psi, alpha=alpha)
    if is_room.all():
        return replace(found, picks=step.picks[:0], changed_picks=step.changed_picks[:0])
    if not len(step.picks):
        return found
    new, changed = step.picks.copy(), step.changed_picks.copy()
    new[of_splits] = picks[slots[is_room]]
    if len(changed):
        changed[is_room] = picks[slots[is_room]]
    return replace(found, picks=new, changed_picks=changed)


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
    found = np.zeros((n_classes(tile.sh_degree), n_slots), np.float32)
    for (step, n), own in zip(_counted(tile, begin, end), weights[begin:end], strict=True):
        if own is not None:  # what only makes room is refined in the same run
            found[:, _written(step, n)] = np.concatenate([own.targets, own.new], axis=1)
    born_from, _ = tile.lineage()
    siblings = Siblings.of(slots.astype(np.int32), born_from)
    return StepWeights(tile.steps[end - 1].level, found[:, slots], found[:, :0], siblings)
