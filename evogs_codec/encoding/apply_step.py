"""What a decoder does with a step (spec 7.4), for an encoder that has the integers at hand.

Letters: D channels, n slots, P refines and splits of a step, S splits, A adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
import numpy.typing as npt

from evogs_codec.model.arithmetic import (
    MAX_DELTA,
    AlphaTable,
    Quantiser,
    RangeError,
    StepPlan,
    apply_channel,
)
from evogs_codec.model.channels import channel_class, group_of_class
from evogs_codec.model.splats import I32, I64

__all__ = ["apply_step", "loops", "rows_of_splits"]


def apply_step(
    x: I32,
    plan: StepPlan,
    of_psi: Sequence[Quantiser],
    of_adds: Sequence[Quantiser],
    tables: Sequence[AlphaTable],
    psi: I32,
    alpha: npt.NDArray[np.integer],
    adds: I32,
    first: int = 0,
) -> int | None:
    """Apply a step to the slots, but for its drops.

    Args:
        x: (D, n) slots, in and out; of no use any more after an error.
        plan: where the records act.
        of_psi: quantisers of the level, per class.
        of_adds: of adds, per class.
        tables: of alpha, per group.
        psi: (D, P) integers of refines and splits.
        alpha: (5, S) indices of the tables.
        adds: (D, A) integers.
        first: the channel of the first row, where the rows are some channels in a row.

    Returns:
        The first row in which a bound of spec 7.3 is broken; None if none is.
    """
    kinds = [channel_class(first + row) for row in range(len(x))]
    a = [np.array(table.entries, np.int32)[own] for table, own in zip(tables, alpha, strict=True)]
    compiled = loops()
    if compiled is None:
        for channel, kind in enumerate(kinds):
            group = group_of_class(kind)
            try:
                delta, new = of_psi[kind].delta(psi[channel]), of_adds[kind].delta(adds[channel])
                apply_channel(x[channel], plan, delta, a[group], tables[group].shift, new)
            except RangeError:
                return channel
        return None
    broken: int = compiled.apply(
        x,
        plan.target_slots,
        rows_of_splits(plan),
        plan.n_before,
        psi,
        _steps(of_psi, kinds),
        np.array([group_of_class(kind) for kind in kinds]),
        np.array(a, np.int32).reshape(len(tables), plan.n_splits),
        np.array([table.shift for table in tables], np.int64),
        adds,
        _steps(of_adds, kinds),
    )
    return None if broken < 0 else broken


def _steps(quantisers: Sequence[Quantiser], kinds: Sequence[int]) -> I64:
    """(D,) grid units of an integer, none so many that a product overflows: 0 alone is in range."""
    return np.array([min(quantisers[kind].step, MAX_DELTA + 1) for kind in kinds], np.int64)


def loops() -> ModuleType | None:
    """The compiled loops; None where numba, which is an extra, is missing."""
    try:
        from evogs_codec.encoding import step_loops
    except ImportError:
        return None
    return step_loops


def rows_of_splits(plan: StepPlan) -> I64:
    """(S,) rows of its targets."""
    return np.arange(plan.n_splits) if plan.splits is None else plan.splits
