"""The loops of `closed_loop` and `apply_step` over the slots of a step, compiled.

Optional: without numba the codec uses numpy, which gives the same numbers.

Letters: D channels, C of them, P refines and splits of a step, S splits, A adds.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.arithmetic import MAX_DELTA, MAX_PRODUCT, MAX_X
from evogs_codec.model.splats import F32, F64, I32, I64

__all__ = ["advance", "apply", "differences"]

_jit = jit(error_model="numpy")


@_jit
def advance(
    target: F64, slots: I64, splits: I64, psi: F32, alpha: F32, group_of: I64, scale: F64, n: int
) -> None:
    """Apply the refines and splits of a step to the float tree on the grid.

    Arguments, several to a line:
        target: (D, n slots), in and out.
        slots, splits: (P,) slots of refines and splits, and (S,) which of them are splits.
        psi, alpha: (D, P) and (5, S) of the step.
        group_of: (D,) row of `alpha` of each channel.
        scale: (D,) grid units of a scene unit.
        n: the slot of the first C2.
    """
    for channel in range(len(target)):
        row, own, by, a = target[channel], psi[channel], scale[channel], alpha[group_of[channel]]
        for k in range(len(splits)):
            i = splits[k]
            row[n + k] = row[slots[i]] - np.float64(a[k]) * (np.float64(own[i]) * by)
        for i in range(len(slots)):
            row[slots[i]] += np.float64(own[i]) * by


@_jit
def differences(
    target: F64, x: I32, slots: I64, splits: I64, steps: F64, n: int, u: F64, v: F64
) -> None:
    """How far C1s and refined splats, and C2s, are to be from their parents, in steps.

    Arguments, several to a line:
        target, x: (C, n slots) the float tree on the grid, and what a decoder has.
        slots, splits, n: as of `advance`.
        steps: (C,) grid units.
        u, v: (C, P) and (C, S), out.
    """
    for channel in range(len(u)):
        row, known, step = target[channel], x[channel], steps[channel]
        for i in range(len(slots)):
            u[channel, i] = (row[slots[i]] - np.float64(known[slots[i]])) / step
        for k in range(len(splits)):
            v[channel, k] = (row[n + k] - np.float64(known[slots[splits[k]]])) / step


@_jit
def apply(
    x: I32, slots: I64, splits: I64, n: int, psi: I32, steps: I64,
    group_of: I64, a: I32, shifts: I64, adds: I32, add_steps: I64,
) -> int:  # fmt: skip
    """Apply a step to the integers that a decoder has.

    Returns the first channel in which a bound of spec 7.3 is broken, or -1.

    Arguments, several to a line:
        x: (D, n slots), in and out.
        slots, splits, n: as of `advance`.
        psi, steps: (D, P) integers of refines and splits, (D,) grid units of one.
        group_of: (D,) row of `a` and `shifts` of each channel.
        a, shifts: (5, S) alpha of each split in units of 2**-shift.
        adds, add_steps: (D, A) integers of adds, (D,) grid units of one.
    """
    for channel in range(len(x)):
        row, own, step = x[channel], psi[channel], steps[channel]
        group = group_of[channel]
        shift = shifts[group]
        half = (np.int64(1) << shift) >> 1
        for i in range(len(slots)):
            if abs(np.int64(own[i]) * step) > MAX_DELTA:
                return channel
        for k in range(len(splits)):
            i = splits[k]
            product = np.int64(a[group, k]) * (np.int64(own[i]) * step)
            if abs(product) > MAX_PRODUCT - half:
                return channel
            second = row[slots[i]] - ((product + half) >> shift)
            if abs(second) > MAX_X:
                return channel
            row[n + k] = second
        for i in range(len(slots)):
            first = row[slots[i]] + np.int64(own[i]) * step
            if abs(first) > MAX_X:
                return channel
            row[slots[i]] = first
        new = n + len(splits)
        for k in range(adds.shape[1]):
            added = np.int64(adds[channel, k]) * add_steps[channel]
            if abs(added) > MAX_DELTA:  # which is less than MAX_X
                return channel
            row[new + k] = added
    return -1
