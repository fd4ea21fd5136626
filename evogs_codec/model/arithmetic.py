"""The integer arithmetic of records (spec 7.3, 7.4); paper equations 3 to 5.

    C1 = P + Delta        C2 = P - RoundShift(a * Delta, K)        Delta = (q * M) << E

Encoder and decoder share these functions, so the encoder quantises against what a decoder has.
Arrays are int32: every bound is checked before the product it protects is made.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F64, I32, I64
from evogs_codec.model.tree import Kind

__all__ = ["MAX_DELTA", "MAX_PRODUCT", "MAX_X", "AlphaTable", "Quantiser", "StepPlan"]

MAX_DELTA = 1 << 28  # R-7.3-1
MAX_PRODUCT = 1 << 30  # R-7.3-2
MAX_X = (1 << 30) - 1  # R-7.3-3


class RangeError(Exception):
    """A bound of spec 7.1 or 7.3 is broken; the decoder turns it into E_RANGE."""


@dataclass(frozen=True)
class Quantiser:
    """Delta = (q * mantissa) << shift (spec 5.3)."""

    mantissa: int
    shift: int

    @property
    def step(self) -> int:
        """Grid units of one q."""
        return self.mantissa << self.shift

    @property
    def max_q(self) -> int:
        """Largest |q| that R-7.3-1 allows."""
        return (MAX_DELTA >> self.shift) // self.mantissa

    def delta(self, q: I32, bound: int | None = None) -> I32:
        """Delta of q; `bound` is a known bound of |q|.

        Raises:
            RangeError: |Delta| exceeds 2**28.
        """
        if (_largest(q) if bound is None or bound > self.max_q else 0) > self.max_q:
            raise RangeError("|Delta| exceeds 2^28")
        # Where only 0 is in range, the step may need more than 32 bits.
        return q if self.step == 1 or self.max_q == 0 else q * np.int32(self.step)


@dataclass(frozen=True)
class AlphaTable:
    """alpha = entries[index] / 2**shift (spec 5.4)."""

    shift: int
    entries: tuple[int, ...]

    @cached_property
    def values(self) -> F64:
        """The alphas, exact; not to be written to."""
        values = np.array(self.entries, np.float64) / (1 << self.shift)
        values.setflags(write=False)
        return values


SYMMETRIC = AlphaTable(0, (1,))  # a level and group without a table


@dataclass(frozen=True, eq=False)
class StepPlan:
    """Where the records of a step act; shared by all channels.

    Attributes:
        targets: (P,) slots of refines and splits, or the slice that means the same.
        splits: rows of `targets` that are splits; None if all are.
        drops: slots of drops.
        n_before: slots before the step.
        n_splits, n_adds: counts.
    """

    targets: I64 | slice
    splits: I64 | None
    drops: I64
    n_before: int
    n_splits: int
    n_adds: int

    @property
    def n_after(self) -> int:
        """Slots after the step."""
        return self.n_before + self.n_splits + self.n_adds

    @property
    def target_slots(self) -> I64:
        """(P,) slots of refines and splits."""
        targets = self.targets
        if isinstance(targets, slice):
            return np.arange(targets.start, targets.stop)
        return targets

    @property
    def split_slots(self) -> I64:
        """(S,) slots of the splits: where C2s were born from."""
        targets = self.target_slots
        return targets if self.splits is None else targets[self.splits]

    @staticmethod
    def of(
        slots: I32 | I64, kinds: npt.NDArray[np.integer], n_before: int, n_adds: int
    ) -> StepPlan:
        """Plan of records with these slots (increasing) and kinds."""
        has_psi = kinds != Kind.DROP
        with_psi = slots if has_psi.all() else slots[has_psi]
        splits = np.flatnonzero(kinds[has_psi] == Kind.SPLIT)
        n = len(with_psi)
        contiguous = n and int(with_psi[-1]) - int(with_psi[0]) == n - 1
        targets = (
            slice(int(with_psi[0]), int(with_psi[-1]) + 1)
            if contiguous
            else with_psi.astype(np.int64)
        )
        return StepPlan(
            targets=targets,
            splits=None if len(splits) == n else splits,
            drops=slots[~has_psi].astype(np.int64),
            n_before=n_before,
            n_splits=len(splits),
            n_adds=n_adds,
        )


def round_shift(v: I32, n: int) -> I32:
    """RoundShift of spec 4.2: floor shift, ties toward +infinity."""
    return v if n == 0 else (v + np.int32(1 << (n - 1))) >> n


def second_offset(delta: I32, a: I32 | int, shift: int) -> I32:
    """RoundShift(a * Delta, K) for (S,) Delta of splits and their a.

    Raises:
        RangeError: |a * Delta| + rounding exceeds 2**30 (R-7.3-2).
    """
    room = MAX_PRODUCT - ((1 << shift) >> 1)
    if isinstance(a, int):
        if a == 1 and shift == 0:
            return delta
        if a and _largest(delta) > room // abs(a):
            raise RangeError("|alpha * Delta| exceeds 2^30")
        return round_shift(delta * np.int32(a), shift)
    if delta.size and np.any(np.abs(delta.astype(np.int64) * a) > room):
        raise RangeError("|alpha * Delta| exceeds 2^30")
    return round_shift(delta * a, shift)


def apply_channel(
    x: I32,
    plan: StepPlan,
    psi: I32 | None,
    a: I32 | int,
    shift: int,
    adds: I32 | None,
    *,
    low: int = -MAX_X,
    high: int = MAX_X,
) -> None:
    """Apply a step to one channel in place, but for its drops; a missing psi or adds means all 0.

    Slots below `plan.n_before` are written last, after all checks: on an error they are as before.

    Args:
        x: (n,) with at least `plan.n_after` slots.
        plan: the step.
        psi: (P,) Delta of refines and splits.
        a: (S,) or one for all: alpha of the splits in units of 2**-shift.
        shift: K.
        adds: (A,) Delta of the adds.
        low: the least number that the step may write.
        high: the largest.

    Raises:
        RangeError: R-7.3-2, or a number outside low..high (R-7.3-3, R-7.3-4).
    """
    n_new = plan.n_before + plan.n_splits
    parents = x[plan.targets]
    if plan.n_adds:
        x[n_new : plan.n_after] = 0 if adds is None else adds
        _check_range(x[n_new : plan.n_after], low, high)
    if psi is None:
        x[plan.n_before : n_new] = parents if plan.splits is None else parents[plan.splits]
        return
    first = parents + psi
    if plan.splits is not None:
        parents, psi = parents[plan.splits], psi[plan.splits]
    if plan.n_splits:
        x[plan.n_before : n_new] = parents - second_offset(psi, a, shift)
        _check_range(x[plan.n_before : n_new], low, high)
    _check_range(first, low, high)
    x[plan.targets] = first


def _check_range(x: I32, low: int, high: int) -> None:
    if x.size and (int(x.min()) < low or int(x.max()) > high):
        raise RangeError(f"a number of a splat is outside {low}..{high}")


def _largest(x: I32) -> int:
    return max(int(x.max()), -int(x.min())) if x.size else 0
