"""Arranging a tree for a stream: tiles, what gains most first, Morton order (spec 3.4, 3.5).

The result is the same tree in other slots: every step of the input becomes, in every tile, one or
a few steps, the records that gain most in pictures first; of a tree in integers, those that
leave SH as they are last, where that saves bytes. Roots are in Morton order within a
step, and so, since new slots are numbered in the order of their parents, are their descendants,
roughly.

Letters: R records of a step that name a slot, S splits, A adds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from evogs_codec.common.morton import morton_order
from evogs_codec.encoding.corrections import only_refines
from evogs_codec.encoding.estimated_gains import changes, ranks, visibility
from evogs_codec.encoding.tiling import tiles_of_slots
from evogs_codec.model.channels import N_CORE
from evogs_codec.model.splats import F64, I32, I64
from evogs_codec.model.tree import EvolutionTree, Kind, Step, columns_of

__all__ = ["Renumbered", "arrange", "leaf_order"]

SPLATS_PER_TILE = 131_072  # packets of a few 100 kB; spec 3.5 allows any number
MIN_FIRST_BIN = 512  # adds of level 0 in a step at least: the first scene comes early
MIN_RECORD_BIN = 16_384  # records of later steps in a step at least; in small tiles fewer
SMALL_TILE_BINS = 9  # of the slots of a small tile, one in so many
MAX_BINS = 4
ZERO_BITS = 0.75  # of a 0 among numbers that are not, about; a list of zeros takes none
LIST_BITS = 320  # that a list of integers takes beside theirs, about
RANKED_RUN = 64  # records of neighbouring slots that rank as one: gathering fewer runs is quicker


def arrange(tree: EvolutionTree, n_tiles: int | None = None) -> list[EvolutionTree]:
    """One tree per tile with the same leaves at each level.

    Args:
        tree: any tree.
        n_tiles: tiles wanted; fewer come back if there are fewer roots. By default one below
            about 200,000 leaves, then as many as keep packets of a good size.

    Raises:
        ValueError: `n_tiles` is below 1.
    """
    return [replace(tree, steps=tuple(b.steps), quanta=()) for b in _builders(tree, n_tiles)]


def leaf_order(
    tree: EvolutionTree, n_tiles: int | None = None, others: Sequence[I64 | None] | None = None
) -> I64:
    """Which leaf of a tree each splat of its stream is.

    Args:
        tree: what was encoded.
        n_tiles: as it was given to `encode`.
        others: per tile, the number that each slot would have without layers; None, of a tile or of
            all, where it has the same.

    Returns:
        (N,) `decode(encode(tree, settings)).leaves()` has at place k, rounded, what
        `tree.leaves()` has at the k-th of these places.

    Raises:
        ValueError: `n_tiles` is below 1.
    """
    if not tree.n_leaves:
        return np.empty(0, np.int64)
    orders = [builder.order for builder in _builders(tree, n_tiles)]
    if others is not None:
        pairs = zip(orders, others, strict=True)
        orders = [own if other is None else own[other] for own, other in pairs]
    slots = np.concatenate(orders)
    _, live = tree.lineage()
    number = np.cumsum(live) - 1
    return number[slots[live[slots]]].astype(np.int64)


def _n_tiles(n_leaves: int, wanted: int | None) -> int:
    if wanted is None:
        return 1 if n_leaves < 200_000 else -(-n_leaves // SPLATS_PER_TILE)
    if wanted < 1:
        raise ValueError(f"n_tiles is {wanted}, expected at least 1")
    return wanted


def _builders(tree: EvolutionTree, n_tiles: int | None) -> list[_TileBuilder]:
    """One per tile, with its steps."""
    is_rounded = bool(tree.quanta)
    tree = replace(tree, steps=tuple(_adds_before_refines(tree.steps)), quanta=())
    tile_of_slot = tiles_of_slots(tree, _n_tiles(tree.n_leaves, n_tiles))
    n = int(tile_of_slot.max()) + 1 if len(tile_of_slot) else 1
    builders = [_TileBuilder(tile_of_slot == tile, is_rounded) for tile in range(n)]
    states = tree.states(slice(11))
    values = np.zeros((11, 0))
    for group in _groups(tree.steps):
        main = group[0]
        n_before = values.shape[1]
        parents = values[:, main.slots]
        for _ in group:
            values = next(states).values
        first, second = values[:, main.slots], values[:, n_before : n_before + main.alpha.shape[1]]
        splits = main.kinds == Kind.SPLIT
        change = changes(parents, first, second, splits)
        shown = visibility(first)
        shown[splits] += visibility(second)
        for builder in builders:
            builder.take(group, n_before, change, shown)
    return builders


def _groups(steps: Sequence[Step]) -> Iterator[list[Step]]:
    """Steps, each with those behind it that only refine what it has just written.

    Without them it may do harm, so that they belong together in a prefix.
    """
    group: list[Step] = []
    written, n_slots = np.zeros(sum(step.n_new for step in steps), bool), 0
    for step in steps:
        may_belong = bool(group) and step.level == group[0].level and only_refines(step)
        if not (may_belong and written[step.slots].all()):
            if group:
                yield group
            group = []
            written[:] = False
            written[step.slots[step.kinds != Kind.DROP]] = True
            written[n_slots : n_slots + step.n_new] = True
        group.append(step)
        n_slots += step.n_new
    if group:
        yield group


def _adds_before_refines(steps: Sequence[Step]) -> list[Step]:
    """The same steps; what makes room for adds of its level does so when they are there."""
    out = list(steps)
    for k in range(len(out) - 1):
        first, then = out[k : k + 2]
        if only_refines(first) and not len(then.slots) and first.level == then.level:
            out[k : k + 2] = [then, first]
    return out


class Renumbered:
    """Steps of a tree in another order, or some of them, and the new numbers of their slots.

    Attributes:
        steps: so far.
        name: (n_slots,) the new number of each slot of the tree, -1 before it has one.
        n_slots: that have one.
    """

    def __init__(self, n_slots: int) -> None:
        self.steps: list[Step] = []
        self.name = np.full(n_slots, -1, np.int32)
        self.n_slots = 0

    @property
    def order(self) -> I64:
        """(n,) the slot of the tree that each new number is of."""
        slots = np.flatnonzero(self.name >= 0)
        return slots[np.argsort(self.name[slots])].astype(np.int64)

    def add(self, source: Step, n_before: int, rows: I64, adds: I64) -> I32:
        """Append these rows and adds of a step; returns the slots of the tree that they write.

        A step without any is left out: it only repeats its level or keeps none.

        Args:
            source: a step of the tree.
            n_before: slots of the tree before it.
            rows: which of its records, in the order of the new numbers of their slots.
            adds: which of its adds.
        """
        if not len(rows) and not len(adds):
            return np.empty(0, np.int32)
        changed, splits = columns_of(source.kinds, rows)
        born = np.concatenate([splits, source.alpha.shape[1] + adds])
        picks, changed_picks = source.picks, source.changed_picks
        self.steps.append(
            Step(
                level=source.level,
                slots=self.name[source.slots[rows]],
                kinds=source.kinds[rows],
                psi=source.psi[:, changed],
                alpha=source.alpha[:, splits],
                adds=source.adds[:, adds],
                picks=picks[born] if len(picks) else picks,
                changed_picks=changed_picks[changed] if len(changed_picks) else changed_picks,
            )
        )
        new = n_before + born
        self.name[new] = self.n_slots + np.arange(len(new), dtype=np.int32)
        self.n_slots += len(new)
        return np.concatenate([source.slots[rows], new.astype(np.int32)])


class _TileBuilder(Renumbered):
    """A tile of a tree.

    Attributes:
        own: (n_slots,) which slots of the tree are the tile's.
        is_rounded: the numbers of the tree are multiples of quanta: zeros are stored as such.
    """

    def __init__(self, own: npt.NDArray[np.bool_], is_rounded: bool) -> None:
        super().__init__(len(own))
        self.own, self.is_rounded = own, is_rounded

    def take(self, group: Sequence[Step], n_before: int, change: F64, shown: F64) -> None:
        """What the tile has of a group becomes steps.

        Args:
            group: a step and its corrections.
            n_before: slots before it.
            change: (R,) of its records, as `ranks` wants them.
            shown: (R,) likewise.
        """
        main, own = group[0], self.own
        small = int(np.count_nonzero(own)) // SMALL_TILE_BINS
        least = MIN_FIRST_BIN if main.level == 0 else min(MIN_RECORD_BIN, max(MIN_FIRST_BIN, small))
        rows = np.flatnonzero(own[main.slots])
        rows = rows[np.argsort(self.name[main.slots[rows]], kind="stable")]
        n_splits = main.alpha.shape[1]
        adds = np.flatnonzero(own[n_before + n_splits : n_before + main.n_new])
        adds = adds[morton_order(main.adds[0:3, adds])]
        seen = visibility(main.adds[:, adds])
        n_bins = _n_bins(len(rows), least)
        parts = _by_sh(main, rows, n_bins) if self.is_rounded else [(rows, n_bins)]
        row_bins = [
            part[found]
            for part, n in parts
            for found in _joined(_bins(ranks(change[part], shown[part], RANKED_RUN), n))
        ]
        add_bins = _bins(ranks(seen, seen, 1), _n_bins(len(adds), least))
        for k in range(max(len(row_bins), len(add_bins))):
            part = row_bins[k] if k < len(row_bins) else rows[:0]
            some = adds[add_bins[k]] if k < len(add_bins) else adds[:0]
            written = self.add(main, n_before, part, some)
            for correction in group[1:]:
                follow = np.flatnonzero(np.isin(correction.slots, written))
                follow = follow[np.argsort(self.name[correction.slots[follow]])]
                self.add(correction, n_before + main.n_new, follow, adds[:0])


def _joined(bins: Sequence[I64]) -> Sequence[I64]:
    """Parts of the records of a level; of more than two, the last two are one.

    Records that change least gain hardly more in a picture than the rounding of their coarse steps
    loses: with the last part alone, some cameras see a worse picture than without it.
    """
    if len(bins) <= 2:
        return bins
    return [*bins[:-2], np.sort(np.concatenate(bins[-2:]))]


def _by_sh(step: Step, rows: I64, n_bins: int) -> list[tuple[I64, int]]:
    """Rows whose psi change SH above band 0, then those that leave them, each with its bins.

    All as one where that saves little: a bit a record says which it is, and 1 bin becomes 2, which
    take lists of their own.
    """
    bands, has_psi = step.psi[N_CORE:], step.kinds != Kind.DROP
    changes_sh = np.zeros(len(step.slots), bool)
    changes_sh[has_psi] = bands.any(axis=0)
    first, then = rows[changes_sh[rows]], rows[~changes_sh[rows]]
    saved = ZERO_BITS * len(then) * len(bands)
    costs = len(rows) + (LIST_BITS * len(step.psi) if n_bins == 1 else 0)
    if not len(first) or saved <= costs:
        return [(rows, n_bins)]
    n = min(max(round(n_bins * len(first) / len(rows)), 1), max(n_bins - 1, 1))
    return [(first, n), (then, max(n_bins - n, 1))]


def _n_bins(n_rows: int, least: int) -> int:
    """In so many parts of at least `least` rows each."""
    return min(MAX_BINS, max(1, n_rows // least))


def _bins(rank: F64, n_bins: int) -> Sequence[I64]:
    """Rows in falling order of rank, in parts."""
    order = np.argsort(-rank, kind="stable")
    return [np.sort(part) for part in np.array_split(order, n_bins)]
