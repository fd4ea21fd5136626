"""The palette in parts: no packet of it is a long wait for a better picture.

Entries show nothing before they are picked. Where those of a level take many bytes beside the whole
stream, they are several packets of that level (spec 12.2), and others come between them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.components import PALETTE
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I32

__all__ = ["apart", "in_parts", "palette_packets"]

MAX_OF_PACKET = 0.02  # of the bytes of a stream that a packet of the palette takes, at most
MAX_WAIT = 0.05  # of them until a picture is better, where packets allow it
MAX_PASSED = 0.2  # of them that a packet of the palette passes, at most
MAX_ADDED = 0.003  # of them that the parts of a level may add: small streams have fewer parts
LIST_BYTES = 100  # bytes of a list's code tables in a further packet; 50 to 120 were measured


def palette_packets(tree: CodedTree) -> list[PacketId]:
    """Packets of the palette (spec 12), as if they were of tile 0."""
    return [PacketId(0, PALETTE, k) for k in range(len(tree.palette_levels))]


def in_parts(tree: CodedTree, sizes: Mapping[PacketId, int]) -> CodedTree:
    """The tree with large packets of the palette divided; itself if none is.

    Args:
        tree: with a palette or without.
        sizes: bytes of each packet.
    """
    if tree.entries is None:
        return tree
    packets, n_bytes = palette_packets(tree), sum(sizes.values())
    most = 1 + int(MAX_ADDED * n_bytes / (LIST_BYTES * len(tree.entries)))
    ends: list[int] = []
    for packet, rows in zip(packets, tree.palette_rows, strict=True):
        n_entries = rows.stop - rows.start
        n_parts = min(max(math.ceil(sizes[packet] / (MAX_OF_PACKET * n_bytes)), 1), most, n_entries)
        ends += _ends(rows, tree.entry_uses[rows], n_parts)
    return replace(tree, palette_ends=tuple(ends)) if len(ends) > len(packets) else tree


def _ends(rows: slice, uses: I32, n_parts: int) -> list[int]:
    """Where about `n_parts` packets of some entries end: after those of a first use, if they can.

    Args:
        rows: of the entries.
        uses: of them, or none.
        n_parts: packets of about the same number of entries.
    """
    ends: list[int] = []
    at, length = rows.start, (rows.stop - rows.start) / n_parts
    for end in [*(rows.start + 1 + np.flatnonzero(np.diff(uses))).tolist(), rows.stop]:
        if end == rows.stop or (n_parts > 1 and end - at >= length / 2):
            n = max(1, round((end - at) / length))
            ends += [at + (end - at) * (k + 1) // n for k in range(n)]
            at = end
    return ends


def apart(
    order: Sequence[PacketId], sizes: Mapping[PacketId, int], shows: Collection[PacketId]
) -> list[PacketId]:
    """The same packets, those of the palette earlier where they are a long wait.

    From the last on, each stays where it is at most `MAX_WAIT` with what follows until a picture is
    better; else it goes on to the next place where it is, or as far as `MAX_PASSED`.

    Args:
        order: a legal order, which it stays: packets of the palette require but one another.
        sizes: bytes of each packet.
        shows: packets after which pictures are better.
    """
    n_bytes = sum(sizes.values())
    waiting: deque[tuple[PacketId, int]] = deque()  # with the bytes of tiles behind it in `order`
    found: list[PacketId] = []
    wait = behind = 0
    for packet in reversed(order[1:]):
        if packet.component == PALETTE:
            waiting.append((packet, behind))
        else:
            found.append(packet)
            behind += sizes[packet]
            wait = sizes[packet] + (0 if packet in shows else wait)
        while waiting:
            first, since = waiting[0]
            # As it would be, were it not for `MAX_ADDED`.
            small = min(sizes[first], MAX_OF_PACKET * n_bytes)
            if wait + small > MAX_WAIT * n_bytes and behind - since < MAX_PASSED * n_bytes:
                break
            found.append(first)
            wait += sizes[first]
            waiting.popleft()
    return [*order[:1], *reversed([*found, *(packet for packet, _ in waiting)])]
