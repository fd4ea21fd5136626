"""Progression: the order of the packets of a file, so that every prefix is near the best.

Packets come in falling order of the error of pictures that they take away per byte, as far as what
they require allows (spec 3.5).

Letters: K steps of a tile.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.encoding.palette_parts import apart, palette_packets
from evogs_codec.format import layout
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.components import PICKS
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import Kind

__all__ = [
    "TileGains",
    "gains_of_tile",
    "leaf_shares",
    "order_of_tiles",
    "order_with_palette",
    "packet_order",
]


@dataclass(frozen=True)
class TileGains:
    """What decides the place of the packets of a tile.

    Attributes:
        n_leaves: of the tile.
        steps: (K, B) what the packet of each step and component takes off the squared error of
            pictures of the tile.
        levels: (K,) of the steps.
    """

    n_leaves: int
    steps: F64
    levels: Sequence[int]


def packet_order(tree: CodedTree, sizes: Mapping[PacketId, int]) -> list[PacketId]:
    """All packets, in falling order of gain per byte; one that requires another after it.

    Args:
        tree: with the gains of its steps; without, it goes step by step.
        sizes: bytes of each packet.
    """
    tiles = [gains_of_tile(tree, tile) for tile in tree.tiles]
    if tree.entries is None:
        return order_of_tiles(tiles, tree.components.of_tiles, sizes)
    shows = _showing(tree) if tree.palette_ends else None
    return order_with_palette(tiles, tree, sizes, shows)


def order_with_palette(
    tiles: Sequence[TileGains],
    palette: CodedTree,
    sizes: Mapping[PacketId, int],
    shows: Collection[PacketId] | None,
) -> list[PacketId]:
    """The packets of tiles as `packet_order` has them, and those of the palette.

    Args:
        tiles: all of a stream.
        palette: the tree of the stream, of which only the entries need be there.
        sizes: bytes of each packet.
        shows: packets of tiles after which pictures are better, if those of the palette are to come
            earlier where they are a long wait.
    """
    most = _most_of_picks(tiles, palette, sizes)
    caps = [[most.get(level, np.inf) for level in tile.levels] for tile in tiles]
    components = palette.components.of_tiles
    order: list[PacketId] = []
    waiting = list(zip(palette_packets(palette), palette.palette_levels, strict=True))
    for packet in order_of_tiles(tiles, components, sizes, caps if most else None):
        label = tiles[packet.tile].levels[packet.step]
        while waiting and packet.component == PICKS and waiting[0][1] <= label:
            order.append(waiting.pop(0)[0])
        order.append(packet)
    order += [packet for packet, _ in waiting]  # what no pick requires
    return order if shows is None else apart(order, sizes, shows)


def order_of_tiles(
    tiles: Sequence[TileGains],
    components: Sequence[int],
    sizes: Mapping[PacketId, int],
    caps: Sequence[Sequence[float]] | None = None,
) -> list[PacketId]:
    """The packets of tiles as `packet_order` has them.

    Args:
        tiles: all of a stream.
        components: of tiles, by column.
        sizes: bytes of each packet.
        caps: per tile (K,) gain per byte of picks at most.
    """
    keyed = []
    n_leaves = max(sum(tile.n_leaves for tile in tiles), 1)
    for number, tile in enumerate(tiles):
        core = np.full(len(tile.steps), np.inf)
        for column, component in enumerate(components):
            packets = [PacketId(number, component, k) for k in range(len(tile.steps))]
            gains = tile.steps[:, column] * (tile.n_leaves / n_leaves)
            slopes = np.minimum(_falling(gains, [sizes[packet] for packet in packets]), core)
            if caps is not None and component == PICKS:
                slopes = np.minimum.accumulate(np.minimum(slopes, caps[number]))
            core = slopes if component == 0 else core
            keyed += [
                ((-slope, p.step, number), p) for slope, p in zip(slopes, packets, strict=True)
            ]
    return [packet for _, packet in sorted(keyed)]


def gains_of_tile(tree: CodedTree, tile: CodedTile) -> TileGains:
    """The gains of the steps of a tile; 0 where they have none."""
    nothing = (0.0,) * len(tree.components.of_tiles)
    gains = [step.gain or nothing for step in tile.steps]
    return TileGains(
        _n_leaves(tile),
        np.reshape(gains, (len(gains), len(nothing))),
        [step.level for step in tile.steps],
    )


def _showing(tree: CodedTree) -> set[PacketId]:
    """Packets of tiles that gain something; all of them of a step without gains."""
    components = tree.components.of_tiles
    return {
        PacketId(number, component, k)
        for number, tile in enumerate(tree.tiles)
        for k, step in enumerate(tile.steps)
        for column, component in enumerate(components)
        if not step.gain or step.gain[column] > 0
    }


def _most_of_picks(
    tiles: Sequence[TileGains], tree: CodedTree, sizes: Mapping[PacketId, int]
) -> dict[int, float]:
    """By level, the gain per byte of its best packets of picks with the palette they require.

    Whichever comes first brings all entries of the level: none comes before they pay for them.
    """
    most: dict[int, float] = {}
    column = tree.components.columns[PICKS]
    n_leaves = max(sum(tile.n_leaves for tile in tiles), 1)
    n_entries: dict[int, int] = {}
    for palette, level in zip(palette_packets(tree), tree.palette_levels, strict=True):
        n_entries[level] = n_entries.get(level, 0) + sizes[palette]
    for level, n_of_entries in n_entries.items():
        packets = [
            (
                tile.n_leaves / n_leaves * tile.steps[k, column],
                sizes[PacketId(number, PICKS, k)],
            )
            for number, tile in enumerate(tiles)
            for k, own in enumerate(tile.levels)
            if own == level
        ]
        if not packets:
            continue
        gains, n_bytes = np.array(sorted(packets, key=lambda p: -p[0] / max(p[1], 1))).T
        most[level] = float(np.max(np.cumsum(gains) / (n_of_entries + np.cumsum(n_bytes))))
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


def _falling(gains: Iterable[float], sizes: Sequence[float]) -> F64:
    """(K,) gain per byte along a chain; what pays less than the next counts together with it."""
    runs: list[tuple[float, float, int]] = []  # gain, bytes, packets
    for gain, size in zip(gains, sizes, strict=True):
        run = gain, size + layout.size_of(layout.PACKET_ENTRY), 1
        while runs and runs[-1][0] * run[1] <= run[0] * runs[-1][1]:
            last = runs.pop()
            run = last[0] + run[0], last[1] + run[1], last[2] + run[2]
        runs.append(run)
    return np.repeat([gain / size for gain, size, _ in runs], [n for _, _, n in runs])
