"""The records of a tree in another order: what a client has after so many of them, and its bytes.

A record is a row of a step that names a slot, or an add. Letters: R records of a tree, D channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, Kind, Step
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.splats import F64, I64
from evogs_codec.model.tree import columns_of

__all__ = ["Records", "by_energy", "by_opacity", "reordered"]

OPACITY_CHANNEL = 10
NUMBER = 4  # bytes


@dataclass(frozen=True, eq=False)
class Records:
    """The R records of a tree, step by step, in each those with a slot and then the adds.

    Attributes:
        level, step: (R,) where they are.
        row: (R,) of the slots of the step, or column of its adds.
        adds: (R,) bool, which are adds.
        needs: (R,) the record that must be there before, -1 for none.
        n_bytes: (R,) uncompressed, as `evaluate.storage` counts.
        energy: (R,) norm of psi; infinite for a drop, which costs nothing, 0 for an add.
        opacity: (R,) logit of the splat that it makes, of C1 where it makes two.
    """

    level: I64
    step: I64
    row: I64
    adds: npt.NDArray[np.bool_]
    needs: I64
    n_bytes: I64
    energy: F64
    opacity: F64

    @staticmethod
    def of(tree: EvolutionTree) -> Records:
        """The records of a tree."""
        parts: list[tuple[npt.NDArray[Any], ...]] = []
        writer = np.full(sum(step.n_new for step in tree.steps), -1, np.int64)
        learned = {s.level for s in tree.steps if s.alpha.size and np.ptp(s.alpha, axis=1).any()}
        n_records = n_slots = 0
        for number, (step, state) in enumerate(zip(tree.steps, tree.states(), strict=True)):
            r, n_adds, n_splits = len(step.slots), step.n_adds, step.alpha.shape[1]
            n = r + n_adds
            index = n_records + np.arange(n)
            needs = np.concatenate([writer[step.slots], np.full(n_adds, -1)])
            writer[step.slots] = index[:r]
            writer[n_slots : n_slots + n_splits] = index[:r][step.kinds == Kind.SPLIT]
            writer[n_slots + n_splits : n_slots + step.n_new] = index[r:]
            energy = np.zeros(n)
            energy[:r] = np.inf
            energy[:r][step.kinds != Kind.DROP] = np.linalg.norm(
                step.psi.astype(np.float64), axis=0
            )
            opacity = np.concatenate(
                [state.values[OPACITY_CHANNEL, step.slots], step.adds[OPACITY_CHANNEL]]
            )
            parts.append(
                (
                    np.full(n, step.level),
                    np.full(n, number),
                    np.concatenate([np.arange(r), np.arange(n_adds)]),
                    np.arange(n) >= r,
                    needs,
                    _bytes(step, step.level in learned),
                    energy,
                    opacity,
                )
            )
            n_records, n_slots = n_records + n, n_slots + step.n_new
        return Records(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def by_energy(records: Records) -> I64:
    """(R,) the paper's order: level by level, largest psi first; roots by opacity."""
    return _ordered(records, np.where(records.adds, records.opacity, records.energy))


def by_opacity(records: Records) -> I64:
    """(R,) level by level, whatever makes the most opaque splat first."""
    return _ordered(records, records.opacity)


def reordered(
    tree: EvolutionTree, records: Records, order: I64, ends: Sequence[int]
) -> tuple[EvolutionTree, list[int]]:
    """The same tree in steps of another order.

    Args:
        tree: any tree.
        records: its records.
        order: (R,) of records, level by level, each after the one that it needs.
        ends: rising positions in `order`, of which the last is R; no step goes across one.

    Returns:
        The tree, and its number of steps at each end.
    """
    name = np.full(sum(step.n_new for step in tree.steps), -1, np.int64)
    first_new = np.cumsum([0, *(step.n_new for step in tree.steps)])
    steps: list[Step] = []
    counts: list[int] = []
    n_slots = start = 0
    for end in ends:
        chosen = order[start:end]
        for number in np.unique(records.step[chosen]).tolist():
            own = chosen[records.step[chosen] == number]
            source = tree.steps[number]
            rows = records.row[own[~records.adds[own]]]
            rows = rows[np.argsort(name[source.slots[rows]])]
            adds = records.row[own[records.adds[own]]]
            step, splits = _part(source, rows, adds, name)
            n_splits = source.alpha.shape[1]
            new = np.concatenate([splits, n_splits + adds])
            name[first_new[number] + new] = n_slots + np.arange(len(new))
            n_slots += len(new)
            steps.append(step)
        counts.append(len(steps))
        start = end
    return EvolutionTree(tree.sh_degree, tuple(steps)), counts


def _bytes(step: Step, learned_alpha: bool) -> I64:
    """(R,) bytes of the records of a step."""
    d = len(step.psi)
    refines = (step.kinds == Kind.REFINE)[step.kinds != Kind.DROP]
    changed = _changed_channels(step.psi[:, refines])
    split = d + len(step.alpha) if learned_alpha else d
    of_kind = {Kind.REFINE: changed, Kind.SPLIT: split, Kind.DROP: 0}
    numbers = np.zeros(len(step.slots), np.int64)
    for kind, n in of_kind.items():
        numbers[step.kinds == kind] = n
    return NUMBER * np.concatenate([numbers, np.full(step.n_adds, d)])


def _changed_channels(psi: npt.NDArray[np.float32]) -> int:
    """Channels of the groups that any refine of a step changes."""
    return sum(len(psi[part]) for part in GROUP_CHANNELS if psi[part].any())


def _ordered(records: Records, priority: F64) -> I64:
    """Level by level, highest priority first, but never before what it needs."""
    highest = priority.copy()
    for number in np.unique(records.step).tolist():
        own = np.flatnonzero((records.step == number) & (records.needs >= 0))
        needs = records.needs[own]
        inside = records.level[needs] == records.level[own]
        own, needs = own[inside], needs[inside]
        highest[own] = np.minimum(highest[own], highest[needs])
    return np.lexsort((np.arange(len(highest)), -highest, records.level))


def _part(source: Step, rows: I64, adds: I64, name: I64) -> tuple[Step, I64]:
    """These rows and adds of a step, in the slots' new names; and which splits they are."""
    psi, splits = columns_of(source.kinds, rows)
    step = Step(
        source.level,
        name[source.slots[rows]].astype(np.int32),
        source.kinds[rows],
        np.ascontiguousarray(source.psi[:, psi]),
        np.ascontiguousarray(source.alpha[:, splits]),
        np.ascontiguousarray(source.adds[:, adds]),
    )
    return step, splits
