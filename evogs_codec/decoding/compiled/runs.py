"""Slots in runs, compiled: what is gathered from them, put into them and added to them (spec 7.4).

Runs are (2, any): the first slot and the length of each. Those of `n` records begin at run `run`;
each function gives back the run after them.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import I32, I64

__all__ = ["gather", "refine_runs", "scatter", "split_runs"]

_jit = jit()


@_jit
def gather(row: I32, runs: I64, run: int, out: I32, n: int) -> int:
    """The numbers of the slots, one after the other."""
    i = 0
    while i < n:
        slot, length = runs[0, run], runs[1, run]
        to, part = out[i : i + length], row[slot : slot + length]
        for j in range(length):
            to[j] = part[j]
        i += length
        run += 1
    return run


@_jit
def scatter(values: I32, runs: I64, run: int, row: I32, n: int) -> None:
    """The inverse of `gather`."""
    i = 0
    while i < n:
        slot, length = runs[0, run], runs[1, run]
        to, part = row[slot : slot + length], values[i : i + length]
        for j in range(length):
            to[j] = part[j]
        i += length
        run += 1


@_jit
def refine_runs(row: I32, q: I32, unit: np.int32, runs: I64, run: int, n: int) -> int:
    """C1 of n refines, whose numbers are known to stay in range."""
    i = 0
    while i < n:
        slot, length = runs[0, run], runs[1, run]
        to, part = row[slot : slot + length], q[i : i + length]
        for j in range(length):
            to[j] = np.int32(to[j] + np.int32(part[j] * unit))
        i += length
        run += 1
    return run


@_jit
def split_runs(
    row: I32, q: I32, unit: np.int32, alphas: I32, shift: int, seconds: I32, runs: I64, run: int
) -> int:
    """C1 and C2 of splits, as many as `seconds`; products and numbers are known to fit."""
    half, bits = np.int32((1 << shift) >> 1), np.int32(shift & 31)
    i, n = 0, len(seconds)
    while i < n:
        slot, length = runs[0, run], runs[1, run]
        to, part, born = row[slot : slot + length], q[i : i + length], seconds[i : i + length]
        a = alphas[i : i + length]
        for j in range(length):
            p, d = to[j], np.int32(part[j] * unit)
            product = np.int32(np.int32(a[j] * d) + half)
            to[j], born[j] = np.int32(p + d), np.int32(p - (product >> bits))
        i += length
        run += 1
    return run
