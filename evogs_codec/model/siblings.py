"""Sibling differences: the psi of refines, stored as what siblings differ by (spec 7.1).

A split makes two siblings of one splat, its slot and a new one, and both lack what it lacked. So
one number of their layer of precision moves both, and the other moves them apart:

    psi of the slot born = common - d        psi of the slot it was born from = common + d

Letters: P records of a step of refines, C channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evogs_codec.model.arithmetic import RangeError
from evogs_codec.model.splats import F32, I32, I64

__all__ = ["MAX_SIBLING", "Siblings", "parent_records"]

MAX_SIBLING = 1 << 28  # R-7.1-2
FEW_ROUNDS = 32  # rounds that are quick one after the other


def parent_records(slots: npt.NDArray[np.integer], born_from: npt.NDArray[np.integer]) -> I32:
    """(P,) for each record, that of the slot its slot was born from; -1 where the step has none.

    Args:
        slots: (P,) of the records, increasing.
        born_from: (n,) by slot, -1 for adds.
    """
    parents = born_from[slots].astype(np.int32)
    found: I32 = np.minimum(np.searchsorted(slots, parents), len(slots) - 1).astype(np.int32)
    found[(parents < 0) | (slots[found] != parents)] = -1
    return found


@dataclass(frozen=True, eq=False)
class Siblings:
    """How the differences of a step add up.

    Row i of 2P is what record i holds when its own number came, row P + i what its parent holds
    then. Each is a number added to the row before it, so sums along chains give them all.

    Attributes:
        before: (2P,) the row before each; 2P where there is none.
        last: (P,) the row that each record ends with.
        is_second: (P,) records that have a parent.
        parents: (P,) which, or -1.
    """

    before: I32
    last: I32
    is_second: npt.NDArray[np.bool_]
    parents: I32

    @staticmethod
    def of(slots: npt.NDArray[np.integer], born_from: npt.NDArray[np.integer]) -> Siblings:
        """From the slots (P,) of the records, and where each slot of the tile was born from."""
        parents = parent_records(slots, born_from)
        n = len(parents)
        seconds = np.flatnonzero(parents >= 0)
        seconds = seconds[np.argsort(parents[seconds], kind="stable")]  # those of a parent together
        of = parents[seconds]
        goes_on = np.append(of[1:] == of[:-1], np.zeros(min(len(of), 1), bool))
        before, last = np.full(2 * n, 2 * n, np.int32), np.arange(n, dtype=np.int32)
        before[seconds] = of
        before[seconds[1:][goes_on[:-1]]] = n + seconds[:-1][goes_on[:-1]]
        before[n + seconds] = before[seconds]
        last[of[~goes_on]] = n + seconds[~goes_on]
        return Siblings(before, last, parents >= 0, parents)

    @cached_property
    def _turns(self) -> I32:
        """(P,) the round of each record that has a parent, from 1 on; 0 of others."""
        n = len(self.last)
        before = np.append(self.before, np.int32(2 * n))
        turns = (before < 2 * n).astype(np.int32)
        while (before < 2 * n).any():  # each turn of the loop doubles how far a row looks back
            turns += turns[before]
            before = before[before]
        return turns[:n]

    @cached_property
    def rounds(self) -> list[tuple[I64, I64]]:
        """Pairs of records, first and second sibling, in rounds that each need those before it.

        No record is in two pairs of a round.
        """
        seconds = np.flatnonzero(self.is_second)
        seconds = seconds[np.argsort(self._turns[seconds], kind="stable")]
        ends = np.flatnonzero(np.diff(self._turns[seconds])) + 1
        rounds = np.split(seconds, ends) if len(seconds) else []
        return [(self.parents[part].astype(np.int64), part) for part in rounds]

    def slopes(self, of_psi: F32) -> F32:
        """(C, P) slopes of differences, from those of the psi that they give."""
        found = of_psi.copy()
        for first, second in reversed(self.rounds):
            of_first, of_second = found[:, first], found[:, second]
            found[:, first], found[:, second] = of_first + of_second, of_first - of_second
        return found

    def sums(self, differences: I32) -> I32:
        """(C, P) psi of differences (C, P).

        Raises:
            RangeError: a number leaves its range (R-7.1-2).
        """
        is_quick = int(self._turns.max(initial=0)) <= FEW_ROUNDS
        psi = self._round_by_round(differences) if is_quick else self._by_doubling(differences)
        # Where a number on the way is too large, so is one of the two that are made of it.
        if psi.size and max(int(psi.max()), -int(psi.min())) > MAX_SIBLING:
            raise RangeError("a sum of sibling differences exceeds 2^28")
        return psi.astype(np.int32, copy=False)

    def _round_by_round(self, differences: I32) -> I32:
        """In int32: `FEW_ROUNDS` differences are below 2**30 together."""
        psi = differences.copy()
        for first, second in self.rounds:
            common, d = psi[:, first], psi[:, second]
            psi[:, first], psi[:, second] = common + d, common - d
        return psi

    def _by_doubling(self, differences: I32) -> I64:
        """Of long chains, in time that does not grow with their length times that of the step."""
        n = len(self.last)
        rows = np.zeros((len(differences), 2 * n + 1), np.int64)
        rows[:, :n] = np.where(self.is_second, -differences, differences)
        rows[:, n : 2 * n] = np.where(self.is_second, differences, 0)
        before = np.append(self.before, np.int32(2 * n))
        while (before < 2 * n).any():
            rows += rows[:, before]
            before = before[before]
        psi: I64 = rows[:, self.last]
        return psi
