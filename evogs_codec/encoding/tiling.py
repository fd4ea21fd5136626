"""Tiling: which tile each slot of a tree belongs to (spec 3.5)."""

from __future__ import annotations

import heapq
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32, I32, I64
from evogs_codec.model.tree import EvolutionTree, Kind

__all__ = ["tiles_of_slots"]

Way: TypeAlias = tuple[int, ...]  # to a part, 0 for a first half and 1 for a second


def tiles_of_slots(tree: EvolutionTree, n_tiles: int) -> I32:
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
    """(n,) tile per root: the heaviest part is halved along its longest axis, again and again.

    Tiles have the order of the ways to them. Of parts of the same weight the first is halved.
    """
    parts: dict[Way, I64] = {(): np.arange(positions.shape[1])}
    waiting: list[tuple[int, Way]] = []
    if positions.shape[1] > 1:
        waiting.append((-int(weight.sum()), ()))
    while len(parts) < n_tiles and waiting:
        _, way = heapq.heappop(waiting)
        part = parts.pop(way)
        spread = np.ptp(np.percentile(positions[:, part], (2, 98), axis=1), axis=0)
        order = part[np.argsort(positions[int(np.argmax(spread)), part], kind="stable")]
        sums = np.cumsum(weight[order])
        at = int(np.clip(np.searchsorted(sums, sums[-1] / 2), 1, len(order) - 1))
        for half, rows in enumerate((order[:at], order[at:])):
            parts[*way, half] = np.sort(rows)
            if len(rows) > 1:
                heapq.heappush(waiting, (-int(weight[rows].sum()), (*way, half)))
    tile = np.zeros(positions.shape[1], np.int32)
    for number, (_, part) in enumerate(sorted(parts.items(), key=lambda item: item[0])):
        tile[part] = number
    return tile
