"""Arranging a tree for a stream: tiles, important records first, Morton order (spec 3.4, 3.5).

The result is the same tree in other slots: every step of the input becomes, in every tile, one or
a few steps, the most visible records first. Roots are in Morton order within a step, and so, since
new slots are numbered in the order of their parents, are their descendants, roughly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.morton import every_third_bit
from evogs_codec.splats import F32, F64, I32, I64
from evogs_codec.tree import EvolutionTree, Kind, Step

__all__ = ["arrange", "default_tiles"]

SPLATS_PER_TILE = 131_072  # packets of a few 100 kB; spec 3.5 allows any number
FIRST_BIN = 512  # adds of level 0 in a step at least: the first scene comes early
RECORD_BIN = 16_384  # records of later steps in a step at least
MAX_BINS = 4
RUN = 64  # records of neighbouring slots that are ranked together


def default_tiles(n_leaves: int) -> int:
    """One tile below about 200,000 splats, then as many as keep packets of a good size."""
    return 1 if n_leaves < 200_000 else -(-n_leaves // SPLATS_PER_TILE)


def arrange(tree: EvolutionTree, n_tiles: int) -> list[EvolutionTree]:
    """One tree per tile with the same leaves at each level.

    Args:
        tree: any tree.
        n_tiles: tiles wanted; fewer come back if there are fewer roots.
    """
    tile_of_slot = _assign_tiles(tree, n_tiles)
    n = int(tile_of_slot.max()) + 1 if len(tile_of_slot) else 1
    builders = [_TileBuilder() for _ in range(n)]
    new_slot = np.full(len(tile_of_slot), -1, np.int32)
    before = 0
    weights = np.zeros(0)
    for step, state in zip(tree.steps, tree.states(), strict=True):
        has_psi = step.kinds != Kind.DROP
        psi_row = np.cumsum(has_psi) - 1
        is_split = step.kinds == Kind.SPLIT
        split_row = np.cumsum(is_split) - 1
        add_tile = tile_of_slot[before + step.alpha.shape[1] : before + step.n_new]
        record_tile = tile_of_slot[step.slots]
        add_weight = visibility(step.adds)
        least = FIRST_BIN if step.level == 0 else RECORD_BIN
        for tile, builder in enumerate(builders):
            rows = np.flatnonzero(record_tile == tile)
            adds = np.flatnonzero(add_tile == tile)
            rows = rows[np.argsort(new_slot[step.slots[rows]], kind="stable")]
            row_bins = _bins(weights[step.slots[rows]], least, RUN)
            add_bins = _bins(add_weight[adds], least, 1)
            for k in range(max(len(row_bins), len(add_bins), 1)):
                part = rows[row_bins[k]] if k < len(row_bins) else rows[:0]
                some = adds[add_bins[k]] if k < len(add_bins) else adds[:0]
                some = some[np.argsort(morton(step.adds[0:3, some]), kind="stable")]
                splits = split_row[part[is_split[part]]]
                first = builder.n_slots
                builder.add(
                    Step(
                        level=step.level,
                        slots=new_slot[step.slots[part]],
                        kinds=step.kinds[part],
                        psi=step.psi[:, psi_row[part[has_psi[part]]]],
                        alpha=step.alpha[:, splits],
                        adds=step.adds[:, some],
                    )
                )
                new_slot[before + splits] = first + np.arange(len(splits), dtype=np.int32)
                old = before + step.alpha.shape[1] + some
                new_slot[old] = first + len(splits) + np.arange(len(some), dtype=np.int32)
        before += step.n_new
        weights = visibility(state.values)
    return [EvolutionTree(tree.sh_degree, tuple(builder.steps)) for builder in builders]


def visibility(values: F64 | F32) -> F64:
    """(n,) opacity times area of the two longest axes: how much of a picture a splat can be."""
    if not values.size:
        return np.zeros(values.shape[-1])
    scales = np.sort(values[7:10].astype(np.float64), axis=0)
    opacity = 1.0 / (1.0 + np.exp(-np.clip(values[10], -40, 40)))
    visible: F64 = opacity * np.exp(np.clip(scales[1] + scales[2], -80, 80))
    return visible


def morton(positions: F32 | F64) -> npt.NDArray[np.uint64]:
    """(n,) Morton codes of (3, n) positions, 21 bits an axis of their bounding box."""
    p = np.asarray(positions, np.float64)
    if not p.shape[1]:
        return np.empty(0, np.uint64)
    low = p.min(1, keepdims=True)
    extent = float((p.max(1, keepdims=True) - low).max())
    cells = ((p - low) * ((2**21 - 1) / extent if extent > 0 else 0.0)).astype(np.uint64)
    code = np.zeros(p.shape[1], np.uint64)
    for axis in range(3):
        code |= every_third_bit(cells[axis]) << np.uint64(axis)
    return code


@dataclass
class _TileBuilder:
    """Steps of a tile so far."""

    def __post_init__(self) -> None:
        self.steps: list[Step] = []
        self.n_slots = 0

    def add(self, step: Step) -> None:
        """Append a step, unless it is empty and only repeats its level or keeps none."""
        if len(step.slots) or step.n_adds:
            self.steps.append(step)
            self.n_slots += step.n_new


def _bins(weights: F64, least: int, run: int) -> Sequence[I64]:
    """Runs of rows in falling order of weight, in up to `MAX_BINS` parts of at least `least` rows.

    A run stays together, in order, so that its slots cost next to nothing.
    """
    n_bins = min(MAX_BINS, max(1, len(weights) // least))
    starts = np.arange(0, len(weights), run)
    order = np.argsort(-np.add.reduceat(weights, starts), kind="stable") if len(starts) else starts
    number = np.arange(len(weights))
    return [number[np.isin(number // run, part)] for part in np.array_split(order, n_bins)]


def _assign_tiles(tree: EvolutionTree, n_tiles: int) -> I32:
    """(n_slots,) tile of every slot the tree ever makes: that of its root."""
    total = sum(step.n_new for step in tree.steps)
    root = np.arange(total, dtype=np.int64)  # slot of the add a slot descends from
    positions: list[F32] = [np.empty((3, 0), np.float32)]
    is_add = np.zeros(total, bool)
    before = 0
    for step in tree.steps:
        n_splits = step.alpha.shape[1]
        parents = step.slots[step.kinds == Kind.SPLIT]
        root[before : before + n_splits] = root[parents]
        is_add[before + n_splits : before + step.n_new] = True
        positions.append(step.adds[0:3])
        before += step.n_new
    adds = np.flatnonzero(is_add)
    weight = np.bincount(root, minlength=total)[adds]
    tile_of_add = _kd_tiles(np.concatenate(positions, axis=1), weight, n_tiles)
    tile = np.zeros(total, np.int32)
    tile[adds] = tile_of_add
    return tile[root]


def _kd_tiles(positions: F32, weight: npt.NDArray[np.integer], n_tiles: int) -> I32:
    """(n,) tile per root: the heaviest part is halved along its longest axis, again and again."""
    parts = [np.arange(positions.shape[1])]
    while len(parts) < n_tiles:
        heaviest = max(range(len(parts)), key=lambda k: int(weight[parts[k]].sum()))
        part = parts[heaviest]
        if len(part) < 2:
            break
        spread = np.ptp(np.percentile(positions[:, part], (2, 98), axis=1), axis=0)
        order = part[np.argsort(positions[int(np.argmax(spread)), part], kind="stable")]
        half = np.cumsum(weight[order])
        at = int(np.clip(np.searchsorted(half, half[-1] / 2), 1, len(order) - 1))
        parts[heaviest : heaviest + 1] = [np.sort(order[:at]), np.sort(order[at:])]
    tile = np.zeros(positions.shape[1], np.int32)
    for number, part in enumerate(parts):
        tile[part] = number
    return tile
