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
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.components import PICKS
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import F64, I64
from evogs_codec.model.tree import Kind

__all__ = [
    "TileGains",
    "gains_of_tile",
    "highest_picks",
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
        n_entries: (K,) entries that picks up to each step are of, where there is a palette.
    """

    n_leaves: int
    steps: F64
    levels: Sequence[int]
    n_entries: I64 | None = None


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
    needed = [_needed(tile, palette) for tile in tiles]
    caps = _caps_of_picks(tiles, needed, palette, sizes)
    components = palette.components.of_tiles
    order: list[PacketId] = []
    waiting = palette_packets(palette)
    n_before = 0
    for packet in order_of_tiles(tiles, components, sizes, caps):
        if packet.component == PICKS:
            n = max(needed[packet.tile][packet.step] - n_before, 0)
            order += waiting[n_before : n_before + n]
            n_before += n
        order.append(packet)
    order += waiting[n_before:]
    return order if shows is None else apart(order, sizes, shows)


def order_of_tiles(
    tiles: Sequence[TileGains],
    components: Sequence[int],
    sizes: Mapping[PacketId, int],
    caps: Sequence[F64] | None = None,
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
        None if tree.entries is None else highest_picks(tile.steps),
    )


def highest_picks(steps: Sequence[CodedStep]) -> I64:
    """(K,) the highest pick up to each step."""
    own = [max(s.picks.max(initial=0), s.changed_picks.max(initial=0)) for s in steps]
    return np.maximum.accumulate(np.array(own, np.int64))


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


def _needed(tile: TileGains, tree: CodedTree) -> I64:
    """(K,) packets of the palette that hold the entries of the picks of a tile."""
    assert tile.n_entries is not None, "there is a palette"
    begins = [rows.start for rows in tree.palette_rows]
    return np.searchsorted(begins, tile.n_entries)


def _caps_of_picks(
    tiles: Sequence[TileGains],
    needed: Sequence[I64],
    tree: CodedTree,
    sizes: Mapping[PacketId, int],
) -> list[F64]:
    """Per tile (K,) the gain per byte of the best packets of picks that need the same entries.

    Whichever comes first brings these entries: none comes before they pay for them.
    """
    column = tree.components.columns[PICKS]
    n_leaves = max(sum(tile.n_leaves for tile in tiles), 1)
    n_bytes = np.cumsum([0, *(sizes[packet] for packet in palette_packets(tree))])
    caps = [np.full(len(tile.levels), np.inf) for tile in tiles]
    before = 0
    for n in np.unique(np.concatenate([[0], *needed]))[1:].tolist():
        packets = [
            (tile.n_leaves / n_leaves * tile.steps[k, column], sizes[PacketId(number, PICKS, k)])
            for number, tile in enumerate(tiles)
            for k in np.flatnonzero(needed[number] == n).tolist()
        ]
        gains, of_picks = np.array(sorted(packets, key=lambda p: -p[0] / max(p[1], 1))).T
        of_entries = n_bytes[n] - n_bytes[before]
        most = np.max(np.cumsum(gains) / (of_entries + np.cumsum(of_picks)))
        for number, own in enumerate(needed):
            caps[number][own == n] = most
        before = n
    return caps


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
