"""The entries of a palette in integers, in an order in which they take few bytes (spec 12).

Letters: C SH channels above band 0, n entries.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.encoding.grids import Grid, TooFineError
from evogs_codec.encoding.rate_distortion import cheapest
from evogs_codec.format.pack import decorrelate
from evogs_codec.format.planes import MAX_STORED, entropy, zigzag
from evogs_codec.model.channels import N_CORE, channel_class
from evogs_codec.model.coded_tree import CodedStep, CodedTile
from evogs_codec.model.palette import Palette
from evogs_codec.model.splats import F32, I32, I64
from evogs_codec.model.tree import take_picks

__all__ = [
    "NEVER",
    "CodedEntries",
    "coded_entries",
    "entries_in_order",
    "first_uses",
    "quantised_entries",
    "renumbered",
]

NEVER = 1 << 30  # above all uses
MAX_STEPS = 256  # of a level, at most
MIN_OF_PART = 1000  # entries that are no part of their own


@dataclass(frozen=True, eq=False)
class CodedEntries:
    """A palette in integers.

    Attributes:
        q: (C, n).
        levels: (n,) int32, never falling: the first that picks each.
        uses: (n,) int32, never falling: the first use of each (`first_uses`).
        number: (1 + entries of the tree,) the number of every pick now.
    """

    q: I32
    levels: I32
    uses: I32
    number: I32


def renumbered(tile: CodedTile, number: I32) -> CodedTile:
    """The tile with picks in the numbers that entries have now (`CodedEntries.number`).

    A step that gives its slots no other picks than they have without any holds none.
    """
    picks, n = np.zeros(sum(step.n_new for step in tile.steps), np.int32), 0
    steps: list[CodedStep] = []
    for step in tile.steps:
        now = replace(step, picks=number[step.picks], changed_picks=number[step.changed_picks])
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
    return entries_in_order(q, first_uses(tiles, q.shape[1]), n_coarse)


def first_uses(tiles: Sequence[CodedTile], n: int) -> I64:
    """(n,) the first use of each entry; `NEVER` if none picks it.

    A use is a level and a step: `MAX_STEPS` times the level, and the number of the step among those
    of the level in its tile.
    """
    first = np.full(1 + n, NEVER)
    for tile in tiles:
        steps: Counter[int] = Counter()
        for step in tile.steps:
            use = step.level * MAX_STEPS + min(steps[step.level], MAX_STEPS - 1)
            np.minimum.at(first, step.picks, use)
            np.minimum.at(first, step.changed_picks, use)
            steps[step.level] += 1
    return first[1:]


def entries_in_order(q: I32, first: I64, n_coarse: int) -> CodedEntries:
    """Entries by first use; of a use those of coarse splats first, then in lexical order.

    Few entries of coarse levels in front let their picks take few bits. In lexical order, by the
    channels with most entropy first, entries stored as differences take few.

    Args:
        q: (C, n).
        first: (n,) of `first_uses`.
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
    use = np.full(kept.shape[1], NEVER)
    np.minimum.at(use, group, first)
    use = _without_few(use)
    is_own = np.ones(kept.shape[1], bool)
    is_own[group[:n_coarse]] = False
    place = np.lexsort([is_own, use])
    place = place[(use[place] < NEVER) & kept[:, place].any(axis=0)]
    number = np.zeros(kept.shape[1], np.int32)  # that of zeros is 0
    number[place] = np.arange(1, 1 + len(place))
    return CodedEntries(
        kept[:, place],
        (use[place] // MAX_STEPS).astype(np.int32),
        use[place].astype(np.int32),
        np.concatenate([[0], number[group]]).astype(np.int32),
    )


def _without_few(uses: I64) -> I64:
    """(n,) the same uses; few entries are used with those of their level before them.

    In a part of its own, an entry is not stored as its difference from one of another part.
    """
    found = uses.copy()
    part, n = -1, Counter(uses.tolist())
    for use in sorted(n):
        if part // MAX_STEPS != use // MAX_STEPS or n[use] >= MIN_OF_PART:
            part = use
        found[uses == use] = part
    return found
