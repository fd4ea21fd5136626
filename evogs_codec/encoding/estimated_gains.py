"""What records gain in pictures, estimated without any pictures (for `arrange`).

A picture errs where many splats err together, so its squared error at a place falls less with each
record there: the first half of the records of a neighbourhood removes three quarters of it.

Letters: R records, D >= 11 channels, m neighbours.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32, F64

__all__ = ["area", "changes", "ranks", "visibility"]

NEIGHBOURS = 16  # runs of records whose errors add up


def visibility(values: F64 | F32) -> F64:
    """(R,) opacity times area of the two longest axes: how much of a picture a splat can be."""
    if not values.size:
        return np.zeros(values.shape[-1])
    opacity = 1.0 / (1.0 + np.exp(-np.clip(values[10].astype(np.float64), -40, 40)))
    visible: F64 = opacity * area(values)
    return visible


def changes(parents: F64, first: F64, second: F64, splits: npt.NDArray[np.bool_]) -> F64:
    """(R,) how much of a picture changes when parents (D, R) become what comes after them.

    What the children show more or less than their parent, and what of them lies elsewhere.

    Args:
        parents: (D, R) before.
        first: (D, R) in their slots afterwards.
        second: (D, S) the C2s of the splits.
        splits: (R,) which are splits.
    """
    extent = np.maximum(area(parents), 1e-300)
    shows = -visibility(parents)
    moves = np.zeros(len(shows))
    for rows, children in ((slice(None), first), (splits, second)):
        seen = visibility(children)
        way = np.square(children[0:3] - parents[0:3, rows]).sum(0) / extent[rows]
        shows[rows] += seen
        moves[rows] += seen * way / (1 + way)
    out: F64 = np.hypot(shows, moves)
    return out


def ranks(change: F64, visible: F64, run: int) -> F64:
    """(R,) gain of each record when its neighbours that change more have come before.

    With changes a of the records of a neighbourhood that shows v, the squared error is
    (sum of a)^2 / v; a record takes off about a times the sum of those not yet there.

    Args:
        change: (R,) in an order in which neighbours are near each other.
        visible: (R,) of what comes after each record.
        run: so many records in a row rank as one.
    """
    starts = np.arange(0, len(change), run)
    if not len(starts):
        return np.zeros(0)
    n_blocks = -(-len(starts) // NEIGHBOURS)
    block = np.zeros((n_blocks, NEIGHBOURS))
    block.flat[: len(starts)] = np.add.reduceat(change, starts)
    seen = np.zeros_like(block)
    seen.flat[: len(starts)] = np.add.reduceat(visible, starts)
    order = np.argsort(-block, axis=1, kind="stable")
    falling = np.take_along_axis(block, order, axis=1)
    to_come = np.cumsum(falling[:, ::-1], axis=1)[:, ::-1]
    gain = np.empty_like(block)
    np.put_along_axis(gain, order, falling * to_come, axis=1)
    gain /= np.maximum(seen.sum(1, keepdims=True), 1e-300)
    out: F64 = np.repeat(gain.flat[: len(starts)], run)[: len(change)]
    return out


def area(values: F64 | F32) -> F64:
    """(R,) product of the two longest axes."""
    scales = np.sort(values[7:10].astype(np.float64), axis=0)
    product: F64 = np.exp(np.clip(scales[1] + scales[2], -80, 80))
    return product
