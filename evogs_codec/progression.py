"""Progression: the order of the packets of a file, so that every prefix is near the best.

What a packet takes off the error of pictures, by its bytes, decides when it comes, as far as what
it requires allows (spec 3.5).

Letters: K steps of a tile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from evogs_codec import layout
from evogs_codec.coded import CodedTile, CodedTree
from evogs_codec.packet_header import PICKS
from evogs_codec.splats import F64
from evogs_codec.tree import Kind

__all__ = ["PALETTE_PLACE", "Place", "leaf_shares", "packet_order"]

Place: TypeAlias = tuple[int, int, int]  # tile, step, component
Key: TypeAlias = tuple[float, int, int]  # what places are sorted by
PALETTE_PLACE: Place = (0, 0, 2)  # of a palette, which is one packet (spec 3.7)


def packet_order(tree: CodedTree, sizes: Mapping[Place, int]) -> list[Place]:
    """All packets, in falling order of gain per byte; one that requires another after it.

    Args:
        tree: with the gains of its steps; without, it goes step by step.
        sizes: bytes of each packet.
    """
    keyed = []
    for number, (share, tile) in enumerate(zip(leaf_shares(tree), tree.tiles, strict=True)):
        core = np.full(len(tile.steps), np.inf)
        for component in range(tree.n_components):
            places = [(number, k, component) for k in range(len(tile.steps))]
            gains = [share * step.gain[component] if step.gain else 0.0 for step in tile.steps]
            slopes = np.minimum(_falling(gains, [sizes[place] for place in places]), core)
            core = slopes if component == 0 else core
            keyed += [((-slope, p[1], number), p) for slope, p in zip(slopes, places, strict=True)]
    if PALETTE_PLACE not in sizes or tree.entries is None:
        return [place for _, place in sorted(keyed)]
    return _after_palette(tree, keyed, sizes)


def _after_palette(
    tree: CodedTree, keyed: Sequence[tuple[Key, Place]], sizes: Mapping[Place, int]
) -> list[Place]:
    """The places in order: no pick pays more than all do with the palette, which is before them."""
    gain = sum(
        share * step.gain[PICKS]
        for share, tile in zip(leaf_shares(tree), tree.tiles, strict=True)
        for step in tile.steps
        if step.gain
    )
    size = sum(n for place, n in sizes.items() if place[2] != 0)
    all_together = -gain / max(size, 1)
    capped = [
        ((max(key[0], all_together), *key[1:]), place) if place[2] == PICKS else (key, place)
        for key, place in keyed
    ]
    places = [place for _, place in sorted(capped)]
    first = next((k for k, place in enumerate(places) if place[2] == PICKS), len(places))
    return [*places[:first], PALETTE_PLACE, *places[first:]]


def leaf_shares(tree: CodedTree) -> list[float]:
    """The part of the leaves that is in each tile."""
    n_leaves = [_n_leaves(tile) for tile in tree.tiles]
    return [n / max(sum(n_leaves), 1) for n in n_leaves]


def _n_leaves(tile: CodedTile) -> int:
    """Live splats after the last step."""
    splits, drops = (
        sum(int(np.count_nonzero(step.kinds == kind)) for step in tile.steps)
        for kind in (Kind.SPLIT, Kind.DROP)
    )
    return sum(int(step.adds.shape[1]) for step in tile.steps) + splits - drops


def _falling(gains: Sequence[float], sizes: Sequence[int]) -> F64:
    """(K,) gain per byte along a chain; what pays less than the next counts together with it."""
    runs: list[tuple[float, int, int]] = []  # gain, bytes, packets
    for gain, size in zip(gains, sizes, strict=True):
        run = gain, size + layout.size_of(layout.PACKET_ENTRY), 1
        while runs and runs[-1][0] * run[1] <= run[0] * runs[-1][1]:
            last = runs.pop()
            run = last[0] + run[0], last[1] + run[1], last[2] + run[2]
        runs.append(run)
    return np.repeat([gain / size for gain, size, _ in runs], [n for _, _, n in runs])
