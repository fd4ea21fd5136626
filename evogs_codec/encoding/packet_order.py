"""Progression: the order of the packets of a file, so that every prefix is near the best.

What a packet takes off the error of pictures, by its bytes, decides when it comes, as far as what
it requires allows (spec 3.5).

Letters: K steps of a tile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from evogs_codec.format import layout
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.components import PALETTE, PICKS
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import Kind

__all__ = ["leaf_shares", "packet_order", "palette_packets"]


def packet_order(tree: CodedTree, sizes: Mapping[PacketId, int]) -> list[PacketId]:
    """All packets, in falling order of gain per byte; one that requires another after it.

    Args:
        tree: with the gains of its steps; without, it goes step by step.
        sizes: bytes of each packet.
    """
    keyed = []
    most = _most_of_picks(tree, sizes)
    for number, (share, tile) in enumerate(zip(leaf_shares(tree), tree.tiles, strict=True)):
        core = np.full(len(tile.steps), np.inf)
        for column, component in enumerate(tree.components.of_tiles):
            packets = [PacketId(number, component, k) for k in range(len(tile.steps))]
            gains = [share * step.gain[column] if step.gain else 0.0 for step in tile.steps]
            slopes = np.minimum(_falling(gains, [sizes[packet] for packet in packets]), core)
            if most and component == PICKS:
                caps = [most.get(step.level, np.inf) for step in tile.steps]
                slopes = np.minimum.accumulate(np.minimum(slopes, caps))
            core = slopes if component == 0 else core
            keyed += [
                ((-slope, p.step, number), p) for slope, p in zip(slopes, packets, strict=True)
            ]
    order: list[PacketId] = []
    palette = list(zip(palette_packets(tree), tree.palette_levels, strict=True))
    for _, packet in sorted(keyed):
        label = tree.tiles[packet.tile].steps[packet.step].level
        while palette and packet.component == PICKS and palette[0][1] <= label:
            order.append(palette.pop(0)[0])
        order.append(packet)
    return [*order, *(packet for packet, _ in palette)]  # what no pick requires


def palette_packets(tree: CodedTree) -> list[PacketId]:
    """Packets of the palette (spec 12), as if they were of tile 0."""
    return [PacketId(0, PALETTE, k) for k in range(len(tree.palette_levels))]


def _most_of_picks(tree: CodedTree, sizes: Mapping[PacketId, int]) -> dict[int, float]:
    """By level, the gain per byte of its best packets of picks with the palette they require.

    Whichever comes first brings all entries of the level: none comes before they pay for them.
    """
    most: dict[int, float] = {}
    shares, column = leaf_shares(tree), tree.components.columns[PICKS]
    for palette, level in zip(palette_packets(tree), tree.palette_levels, strict=True):
        packets = [
            (
                shares[number] * step.gain[column] if step.gain else 0.0,
                sizes[PacketId(number, PICKS, k)],
            )
            for number, tile in enumerate(tree.tiles)
            for k, step in enumerate(tile.steps)
            if step.level == level
        ]
        if not packets:
            continue
        gains, n_bytes = np.array(sorted(packets, key=lambda p: -p[0] / max(p[1], 1))).T
        most[level] = float(np.max(np.cumsum(gains) / (sizes[palette] + np.cumsum(n_bytes))))
    return most


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


def _falling(gains: Sequence[float], sizes: Sequence[float]) -> F64:
    """(K,) gain per byte along a chain; what pays less than the next counts together with it."""
    runs: list[tuple[float, float, int]] = []  # gain, bytes, packets
    for gain, size in zip(gains, sizes, strict=True):
        run = gain, size + layout.size_of(layout.PACKET_ENTRY), 1
        while runs and runs[-1][0] * run[1] <= run[0] * runs[-1][1]:
            last = runs.pop()
            run = last[0] + run[0], last[1] + run[1], last[2] + run[2]
        runs.append(run)
    return np.repeat([gain / size for gain, size, _ in runs], [n for _, _, n in runs])
