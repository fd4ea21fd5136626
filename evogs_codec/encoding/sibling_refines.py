"""Refines of a layer of precision, as sibling differences (spec 7.1).

What leaves lack is mostly what their ancestors lacked, wherever their own numbers are worth less
than a step. One number of all siblings then does the work of many.

Letters: C channels, P records.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.encoding.rate_distortion import cheapest
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F64

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
    rounds = siblings.rounds
    pairs = []
    for first, second in reversed(rounds):
        pair = means[:, first], means[:, second], worth[:, first], worth[:, second]
        pairs.append(pair)
        means[:, first] = (pair[0] + pair[1]) / 2
        worth[:, first] = pair[2] + pair[3]
    differences, psi = np.zeros_like(wanted), np.zeros_like(wanted)
    own = np.flatnonzero(~siblings.is_second)
    differences[:, own] = psi[:, own] = cheapest(means[:, own], worth[:, own])
    for (first, second), pair in zip(rounds, reversed(pairs), strict=True):
        of_first, of_second, worth_first, worth_second = pair
        common, both = psi[:, first], np.maximum(worth_first + worth_second, 1e-300)
        apart = worth_first * (of_first - common) - worth_second * (of_second - common)
        d = cheapest(apart / both, both)
        psi[:, first], psi[:, second], differences[:, second] = common + d, common - d, d
    return differences, psi
