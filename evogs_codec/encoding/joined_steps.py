"""Steps of a level that come as one, so that no prefix ends between them.

A level comes in several steps, so that pictures become better bit by bit. Where they become worse
after one of them, a run of steps is joined. A joined run takes hardly more bytes than its steps; to
hold it back (`held_steps`) takes far more.

Letters: D channels, K classes (spec 3.2), n slots, R records of a step, N leaves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.encoding.corrections import corrections
from evogs_codec.encoding.held_steps import Run, splits_or_refines
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32, I64
from evogs_codec.model.tree import EvolutionTree, Kind, Step, columns_of

__all__ = ["Joined", "composed", "joined", "joined_tiles"]


@dataclass(frozen=True, eq=False)
class Joined:
    """A tile of which some steps have come as one.

    Attributes:
        tile: with the same leaves, in other slots.
        weights: of its steps.
        order: (n,) the number that each slot had; None of a tile that is as it was.
    """

    tile: EvolutionTree
    weights: tuple[StepWeights | None, ...]
    order: I64 | None

    def leaves(self, of: F32) -> F32:
        """What leaves (K, N) have, given in the order that they had."""
        if self.order is None:
            return of
        live = np.empty(len(self.order), bool)
        live[self.order] = self.tile.lineage()[1]
        number = np.cumsum(live) - 1
        return of[:, number[self.order[live[self.order]]]]


@dataclass(frozen=True, eq=False)
class _Part:
    """Some records of a step, in the numbers that slots had.

    Attributes:
        step: with these records.
        own: their weights; None of what is coded as it is.
        new: (n_new,) the slots that it makes.
    """

    step: Step
    own: StepWeights | None
    new: I64

    def take(self, rows: I64) -> _Part:
        """These records, in this order, and all adds."""
        step, own = self.step, self.own
        changed, splits = columns_of(step.kinds, rows)
        n_splits = step.alpha.shape[1]
        born = np.concatenate([splits, np.arange(n_splits, step.n_new)])
        some = replace(
            step,
            slots=step.slots[rows],
            kinds=step.kinds[rows],
            psi=step.psi[:, changed],
            alpha=step.alpha[:, splits],
            picks=step.picks[born] if len(step.picks) else step.picks,
            changed_picks=step.changed_picks[changed]
            if len(step.changed_picks)
            else step.picks[:0],
        )
        if own is not None:
            own = replace(own, targets=own.targets[:, changed], new=own.new[:, born])
        return _Part(some, own, self.new[born])

    @staticmethod
    def of_all(parts: Sequence[_Part]) -> _Part:
        """The records of parts without adds, one part after the other."""
        steps, weights = [part.step for part in parts], [part.own for part in parts]

        def of_each(name: str) -> list[np.ndarray]:
            return [getattr(step, name) for step in steps]

        step = replace(
            steps[0],
            slots=np.concatenate(of_each("slots")),
            kinds=np.concatenate(of_each("kinds")),
            psi=np.concatenate(of_each("psi"), axis=1),
            alpha=np.concatenate(of_each("alpha"), axis=1),
            picks=np.concatenate(of_each("picks")),
            changed_picks=np.concatenate(of_each("changed_picks")),
        )
        own = weights[0]
        known = [one for one in weights if one is not None]
        if own is not None:
            own = replace(
                own,
                targets=np.concatenate([one.targets for one in known], axis=1),
                new=np.concatenate([one.new for one in known], axis=1),
            )
        return _Part(step, own, np.concatenate([part.new for part in parts]))


def joined(tile: EvolutionTree, weights: Sequence[StepWeights | None], run: Run) -> Joined | None:
    """A tile with as few steps in a run as write no slot twice; None where they are no fewer.

    None, too, of a run of several levels, of one that begins with a correction or has adds or
    drops, and where steps differ in whether they have picks or weights.

    Args:
        tile: arranged.
        weights: of its steps.
        run: of its steps.
    """
    rows = run.rows(tile)
    if len(rows) < 2:
        return None
    begin, end = int(rows[0]), int(rows[-1]) + 1
    steps = tile.steps[begin:end]
    if len({step.level for step in steps}) > 1 or corrections(tile)[begin]:
        return None
    if not all(map(splits_or_refines, steps)):
        return None
    parts = list(_parts(tile, weights))
    one_by_one = _generations(tile, begin, end)
    n_generations = 1 + max(int(of_step.max(initial=0)) for of_step in one_by_one)
    if n_generations == len(steps):
        return None
    found = []
    for generation in range(n_generations):
        of_run = zip(parts[begin:end], one_by_one, strict=True)
        some = [part.take(np.flatnonzero(of_step == generation)) for part, of_step in of_run]
        some = [part for part in some if len(part.step.slots)]
        if not _are_alike(some):
            return None
        found.append(_Part.of_all(some))
    return _renumbered(tile, [*parts[:begin], *found, *parts[end:]])


def joined_tiles(
    tiles: Sequence[EvolutionTree], weights: Sequence[Sequence[StepWeights | None]], run: Run
) -> list[Joined] | None:
    """`joined` of each tile; None unless all that have several steps of the run can be.

    Args:
        tiles: arranged.
        weights: of the steps of each.
        run: of their steps.
    """
    found = []
    for tile, own in zip(tiles, weights, strict=True):
        one = joined(tile, own, run)
        if one is None and len(run.rows(tile)) > 1:
            return None
        found.append(Joined(tile, tuple(own), None) if one is None else one)
    return None if all(one.order is None for one in found) else found


def composed(first: Sequence[I64 | None], then: Sequence[I64 | None]) -> Sequence[I64 | None]:
    """Per tile, the number that each slot had before it was numbered twice; None if it has it."""
    return [
        one if other is None else other if one is None else one[other]
        for one, other in zip(first, then, strict=True)
    ]


def _parts(tile: EvolutionTree, weights: Sequence[StepWeights | None]) -> Iterator[_Part]:
    """The steps of a tile."""
    n = 0
    for step, own in zip(tile.steps, weights, strict=True):
        yield _Part(step, own, np.arange(n, n + step.n_new))
        n += step.n_new


def _generations(tile: EvolutionTree, begin: int, end: int) -> list[I64]:
    """Of each step of a run, (R,) how many of the steps before it in the run write its slots."""
    depth = np.zeros(sum(step.n_new for step in tile.steps[:end]), np.int64)
    n = sum(step.n_new for step in tile.steps[:begin])
    found = []
    for step in tile.steps[begin:end]:
        own = depth[step.slots]
        found.append(own)
        depth[step.slots] = own + 1
        depth[n : n + step.n_new] = own[step.kinds == Kind.SPLIT] + 1
        n += step.n_new
    return found


def _are_alike(parts: Sequence[_Part]) -> bool:
    """Whether all have picks and weights, or none."""
    has = [
        (
            len(part.step.picks) == part.step.n_new,
            len(part.step.changed_picks) == part.step.psi.shape[1],
            part.own is None,
        )
        for part in parts
    ]
    return len(set(has)) == 1


def _renumbered(tile: EvolutionTree, parts: Iterable[_Part]) -> Joined:
    """A tile of these parts, whose slots are numbered as they come."""
    n_slots = sum(step.n_new for step in tile.steps)
    name = np.full(n_slots, -1, np.int32)
    steps, weights, n = [], [], 0
    for whole in parts:
        part = whole.take(np.argsort(name[whole.step.slots], kind="stable"))
        steps.append(replace(part.step, slots=name[part.step.slots]))
        weights.append(part.own)
        name[part.new] = n + np.arange(len(part.new), dtype=np.int32)
        n += len(part.new)
    found = replace(tile, steps=tuple(steps))
    born_from, _ = found.lineage()
    for k, own in enumerate(weights):
        if own is not None and own.siblings is not None:
            weights[k] = replace(own, siblings=Siblings.of(steps[k].slots, born_from))
    return Joined(found, tuple(weights), np.argsort(name).astype(np.int64))
