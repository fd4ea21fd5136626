"""The entries of a palette in integers, in an order in which they take few bytes (spec 12).

Letters: C SH channels above band 0, n entries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.encoding.grids import Grid, TooFineError
from evogs_codec.encoding.rate_distortion import cheapest
from evogs_codec.format.pack import decorrelate
from evogs_codec.format.planes import MAX_STORED, entropy, zigzag
from evogs_codec.model.channels import N_CORE, channel_class
from evogs_codec.model.coded_tree import CodedStep, CodedTile
from evogs_codec.model.splats import F32, I32, I64
from evogs_codec.model.tree import Palette, take_picks

__all__ = [
    "NEVER",
    "CodedEntries",
    "coded_entries",
    "entries_in_order",
    "first_levels",
    "quantised_entries",
]

NEVER = 1 << 30  # above all levels


@dataclass(frozen=True, eq=False)
class CodedEntries:
    """A palette in integers.

    Attributes:
        q: (C, n).
        levels: (n,) int32, never falling: the first that picks each.
        number: (1 + entries of the tree,) the number of every pick now.
    """

    q: I32
    levels: I32
    number: I32

    def renumbered(self, tile: CodedTile) -> CodedTile:
        """The tile with picks in the numbers that entries have now.

        A step that gives its slots no other picks than they have without any holds none.
        """
        picks, n = np.zeros(sum(step.n_new for step in tile.steps), np.int32), 0
        steps: list[CodedStep] = []
        for step in tile.steps:
            now = replace(
                step,
                picks=self.number[step.picks],
                changed_picks=self.number[step.changed_picks],
            )
            if not len(now.changed_picks):
                without = replace(now, picks=now.picks[:0])
                take_picks(without, picks, n)
                now = without if np.array_equal(now.picks, picks[n : n + step.n_new]) else now
            take_picks(now, picks, n)
            n += step.n_new
            steps.append(now)
        return replace(tile, steps=tuple(steps))


def quantised_entries(palette: Palette, grid: Grid, weights: F32 | None, price: float) -> I32:
    """(C, n) q of the entries of a palette, by the steps of adds.

    Args:
        palette: of the tree.
        grid: with these steps.
        weights: (degree, n) mean squared error of the pictures per squared error of a number of an
            entry, per SH band; then bits are saved where they do little.
        price: mean squared error that a bit is worth.

    Raises:
        TooFineError: a number leaves its range.
    """
    kinds = np.array([channel_class(N_CORE + c) for c in range(len(palette.entries))])
    quantisers = [grid.quantisers[0][kind] for kind in kinds]
    units = np.array([q.step for q in quantisers])[:, None] / 2.0 ** grid.exponents[4]
    u = palette.entries / units
    if weights is None:
        q = np.rint(u)
    else:
        q = cheapest(u, weights[kinds - 5] * (np.square(units) / price))
    limit = np.array([[min(k.max_q, MAX_STORED // 2 - 1)] for k in quantisers])
    if np.any(np.abs(q) > limit):
        raise TooFineError(4)
    return q.astype(np.int32)


def coded_entries(q: I32, n_coarse: int, tiles: Sequence[CodedTile]) -> CodedEntries:
    """The entries of q (C, n) that tiles pick, those that have become equal as one."""
    return entries_in_order(q, first_levels(tiles, q.shape[1]), n_coarse)


def first_levels(tiles: Sequence[CodedTile], n: int) -> I64:
    """(n,) the first level that picks each entry; `NEVER` if none does."""
    first = np.full(1 + n, NEVER)
    for tile in tiles:
        for step in tile.steps:
            np.minimum.at(first, step.picks, step.level)
            np.minimum.at(first, step.changed_picks, step.level)
    return first[1:]


def entries_in_order(q: I32, first: I64, n_coarse: int) -> CodedEntries:
    """Entries by level, in a level those of coarse splats first, then in lexical order.

    Few entries of coarse levels in front let their picks take few bits. In lexical order, by the
    channels with most entropy first, entries stored as differences take few.

    Args:
        q: (C, n).
        first: (n,) of `first_levels`.
        n_coarse: of them, the first ones, were made for coarse splats.
    """
    rows, _ = decorrelate(q, slice(None))
    bits = [entropy(zigzag(row)) if row.size else 0.0 for row in rows]
    order = np.lexsort(rows[np.argsort(bits)])
    is_new = np.ones(len(order), bool)
    is_new[1:] = np.any(q[:, order[1:]] != q[:, order[:-1]], axis=0)
    group = np.empty(len(order), np.int64)  # equal ones, in lexical order
    group[order] = np.cumsum(is_new) - 1
    kept = q[:, order[is_new]]
    level = np.full(kept.shape[1], NEVER)
    np.minimum.at(level, group, first)
    is_own = np.ones(kept.shape[1], bool)
    is_own[group[:n_coarse]] = False
    place = np.lexsort([is_own, level])
    place = place[(level[place] < NEVER) & kept[:, place].any(axis=0)]
    number = np.zeros(kept.shape[1], np.int32)  # that of zeros is 0
    number[place] = np.arange(1, 1 + len(place))
    return CodedEntries(
        kept[:, place],
        level[place].astype(np.int32),
        np.concatenate([[0], number[group]]).astype(np.int32),
    )
