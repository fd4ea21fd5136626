"""The entries of a palette in integers, in an order in which they take few bytes (spec 3.7).

Letters: C SH channels above band 0, n entries.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evogs_codec.coded import CodedTile, channel_class
from evogs_codec.grids import Grid, TooFine
from evogs_codec.packet_header import N_CORE
from evogs_codec.packing import decorrelate
from evogs_codec.planes import MAX_STORED, entropy, zigzag
from evogs_codec.splats import F32, I32
from evogs_codec.trading import cheapest
from evogs_codec.tree import Palette

__all__ = ["coded_entries", "renumbered"]


def coded_entries(
    palette: Palette, grid: Grid, weights: F32 | None, price: float
) -> tuple[I32, I32]:
    """The q (C, n) of the entries that differ, and the number (1 + entries,) of every pick now.

    Args:
        palette: of the tree.
        grid: its steps of adds are those of entries.
        weights: (degree, entries) mean squared error of the pictures per squared error of a number
            of an entry, per SH band; then bits are saved where they do little.
        price: mean squared error that a bit is worth.

    Raises:
        TooFine: a number leaves its range.
    """
    kinds = np.array([channel_class(N_CORE + c) for c in range(len(palette.entries))])
    quantisers = [grid.quantisers[0][kind] for kind in kinds]
    units = np.array([q.step for q in quantisers])[:, None] / 2.0 ** grid.exponents[4]
    u = palette.entries / units
    if weights is None:
        q = np.rint(u)
    else:
        q = cheapest(u, weights[kinds - 5] * (np.square(units) / price))
    limit = np.array([[min(k.max_q, MAX_STORED // 8 - 1)] for k in quantisers])
    if np.any(np.abs(q) > limit):
        raise TooFine(4)
    return _in_order(q.astype(np.int32), palette.n_coarse)


def _in_order(q: I32, n_coarse: int) -> tuple[I32, I32]:
    """Entries that are equal become one, zeros the pick 0; the rest stand in lexical order.

    By the channels with most entropy first: stored as differences these take next to nothing. The
    first `n_coarse` stay in front: small picks of coarse splats take fewer bits.
    """
    rows, _ = decorrelate(q, slice(None))
    bits = [entropy(zigzag(row)) if row.size else 0.0 for row in rows]
    is_late = np.arange(q.shape[1]) >= n_coarse
    order = np.lexsort([*rows[np.argsort(bits)], is_late])
    is_new = np.ones(len(order), bool)
    is_new[1:] = np.any(q[:, order[1:]] != q[:, order[:-1]], axis=0)
    is_new &= q[:, order].any(axis=0)
    number = np.zeros(1 + len(order), np.int32)
    number[1 + order] = np.where(q[:, order].any(axis=0), np.cumsum(is_new), 0)
    return q[:, order[is_new]], number


def renumbered(tile: CodedTile, number: I32) -> CodedTile:
    """The tile with picks in the numbers that entries have now."""
    steps = tuple(replace(step, picks=number[step.picks]) for step in tile.steps)
    return replace(tile, steps=steps)
