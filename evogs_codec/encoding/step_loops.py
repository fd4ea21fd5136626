"""The loops of `closed_loop` over the slots of a step, compiled: no arrays for what is on the way.

Optional: without numba the codec uses numpy, which gives the same numbers.

Letters: D channels, C of them, P refines and splits of a step, S splits.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from evogs_codec.model.splats import F32, F64, I32, I64

__all__ = ["advance", "differences"]

_jit: Any = numba.njit(nogil=True, cache=True, boundscheck=False, error_model="numpy")


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
