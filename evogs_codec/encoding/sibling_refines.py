"""Refines of a layer of precision, as sibling differences (spec 7.1).

What leaves lack is mostly what their ancestors lacked, wherever their own numbers are worth less
than a step. One number of all siblings then does the work of many.

Letters: C channels, P records.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.encoding.rate_distortion import cheapest, loops
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F64, I64

__all__ = ["cheapest_differences"]


def cheapest_differences(wanted: F64, weights: F64, siblings: Siblings) -> tuple[F64, F64]:
    """Sibling differences (C, P) near `wanted`, and the psi (C, P) that they give.

    From the first ancestors down, each sees what those above it left: least sum of weights times
    squared error, and of bits.

    Args:
        wanted: (C, P) psi, in steps.
        weights: (C, P) bits that a squared error of one step is worth.
        siblings: of the records.
    """
    means, worth = wanted.copy(), weights.copy()
    compiled = loops()
    go_up, apart, go_down = (
        (_go_up, _apart, _go_down)
        if compiled is None
        else (compiled.go_up, compiled.apart, compiled.go_down)
    )
    rounds = siblings.rounds
    pairs = []
    for first, second in reversed(rounds):
        pair = np.empty((4, len(wanted), len(first)))
        go_up(means, worth, first, second, pair)
        pairs.append(pair)
    differences, psi = np.zeros_like(wanted), np.zeros_like(wanted)
    own = np.flatnonzero(~siblings.is_second)
    differences[:, own] = psi[:, own] = cheapest(means[:, own], worth[:, own])
    for (first, second), pair in zip(rounds, reversed(pairs), strict=True):
        u, both = np.empty(pair.shape[1:]), np.empty(pair.shape[1:])
        apart(pair, psi, first, u, both)
        go_down(psi, differences, first, second, cheapest(u, both))
    return differences, psi


def _go_up(means: F64, worth: F64, first: I64, second: I64, pair: F64) -> None:
    """`rate_loops.go_up` in numpy."""
    pair[:] = means[:, first], means[:, second], worth[:, first], worth[:, second]
    means[:, first] = (pair[0] + pair[1]) / 2
    worth[:, first] = pair[2] + pair[3]


def _apart(pair: F64, psi: F64, first: I64, wanted: F64, both: F64) -> None:
    """`rate_loops.apart` in numpy."""
    common = psi[:, first]
    both[:] = np.maximum(pair[2] + pair[3], 1e-300)
    wanted[:] = (pair[2] * (pair[0] - common) - pair[3] * (pair[1] - common)) / both


def _go_down(psi: F64, differences: F64, first: I64, second: I64, d: F64) -> None:
    """`rate_loops.go_down` in numpy."""
    common = psi[:, first]
    psi[:, first], psi[:, second], differences[:, second] = common + d, common - d, d
