"""The lists of integers of a stream as stored, with what a decoder knows when it comes to each.

Letters: n integers of a list, P records with psi, S splits, all of one step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec import Directory, Kind, read_directory
from evogs_codec.coded import channel_class, component_slice
from evogs_codec.packet_header import Counts, PacketHeader, read_packet_header
from evogs_codec.packets import read_planes, unpack
from evogs_codec.planes import Coding, join_planes, planes_at
from evogs_codec.splats import I32, I64, U8
from evogs_codec.stats import CLASS_NAMES
from evogs_codec.tree import N_GROUPS

__all__ = ["IntegerList", "ListPacket", "packets"]

SIDES = ("slots", "kinds", *("alpha",) * N_GROUPS)
N_BEFORE = 3  # channels that "record" adds up


@dataclass(frozen=True, eq=False)
class IntegerList:
    """A list of which something is stored.

    Attributes:
        name: what it holds, as `evogs info` says.
        coding: how it is stored now.
        values: (n,) the stored integers, not negative: after YCoCg-R, delta and zigzag.
        sums: by context, the lists of the packet before it that the context adds up.
        given: by context, (n,) magnitudes from other packets or of the alphas.
    """

    name: str
    coding: Coding
    values: I32
    sums: dict[str, tuple[int, ...]]
    given: dict[str, I32]

    @property
    def contexts(self) -> tuple[str, ...]:
        """Those that `magnitudes` has."""
        return *self.sums, *self.given

    def magnitudes(self, context: str, before: Sequence[I32]) -> I32:
        """(n,) what a context says, from the lists of the packet before this one."""
        if context in self.given:
            return self.given[context]
        first, *others = (before[k] for k in self.sums[context])
        return sum(others, first)


@dataclass(frozen=True, eq=False)
class ListPacket:
    """A packet that is not empty.

    Attributes:
        body: its bytes.
        header: its header.
        planes: its planes.
        lists: those of which something is stored, in the order of spec 5.9.
    """

    body: memoryview
    header: PacketHeader
    planes: U8
    lists: tuple[IntegerList, ...]


def packets(data: memoryview) -> Iterator[ListPacket]:
    """The packets of a stream that have bytes, in file order."""
    directory = read_directory(data)
    tiles = [_Tile.of(directory, tile) for tile in range(len(directory.tiles))]
    for packet, row in enumerate(directory.packets):
        tile, component = tiles[int(row["tile"])], int(row["component"])
        offset = int(directory.offsets[packet])
        body = data[offset : offset + int(row["size"])]
        if component == 0:
            tile.steps.append(_Step.of(directory, packet, body, tile))
        step = tile.steps[int(directory.steps[packet])]
        psi: dict[int, I32] = {}
        if len(body):
            header = read_packet_header(body, component, step.counts, offset)
            planes = read_planes(body, header, offset)
            lists, psi = _lists(header, planes, component, step, tile)
            yield ListPacket(body, header, planes, lists)
        tile.remember(step, component, psi)


@dataclass(frozen=True, eq=False)
class _Step:
    """The records of a step.

    Attributes:
        counts: its counts.
        targets: (P,) slots.
        splits: (S,) rows of `targets`.
        alpha: (5, P) 1 + |alpha| in eighths, 0 for refines.
        first: the first slot it makes.
    """

    counts: Counts
    targets: I64
    splits: I64
    alpha: I32
    first: int

    @staticmethod
    def of(directory: Directory, packet: int, body: memoryview, tile: _Tile) -> _Step:
        """Of a core packet."""
        counts = directory.counts(packet)
        found = unpack(body, 0, counts, int(directory.offsets[packet]))
        has_psi = found.kinds != Kind.DROP
        splits = np.flatnonzero(found.kinds[has_psi] == Kind.SPLIT)
        alpha = np.zeros((N_GROUPS, counts.n_psi), np.int32)
        for group, indices in enumerate(found.alpha):
            table = directory.alpha_table(int(directory.packets["level"][packet]), group)
            stored = np.zeros(counts.n_splits, np.uint8) if indices is None else indices
            alpha[group, splits] = 1 + np.rint(8 * np.abs(table.values()))[stored]
        before = tile.steps[-1] if tile.steps else None
        first = before.first + before.counts.n_splits + before.counts.n_adds if before else 0
        return _Step(counts, found.slots[has_psi], splits, alpha, first)


@dataclass(frozen=True, eq=False)
class _Tile:
    """What a decoder may know of a tile: its steps, and (D, slots) the last psi of each slot."""

    steps: list[_Step]
    last: I32

    @staticmethod
    def of(directory: Directory, tile: int) -> _Tile:
        """Before its first packet."""
        rows = directory.packets[directory.packets["tile"] == tile]
        n_slots = int(rows["n_adds"].sum(dtype=np.int64) + rows["n_splits"].sum(dtype=np.int64))
        n_channels = component_slice(directory.n_components - 1).stop
        return _Tile([], np.zeros((n_channels, n_slots), np.int32))

    def remember(self, step: _Step, component: int, psi: dict[int, I32]) -> None:
        """Note the psi of a packet by channel; 0 where none is stored."""
        part = component_slice(component)
        for channel in range(part.start, part.stop):
            values = psi.get(channel, np.zeros(len(step.targets), np.int32))
            self.last[channel, step.targets] = values
            children = slice(step.first, step.first + len(step.splits))
            self.last[channel, children] = values[step.splits]


def _lists(
    header: PacketHeader, planes: U8, component: int, step: _Step, tile: _Tile
) -> tuple[tuple[IntegerList, ...], dict[int, I32]]:
    """The lists of a packet, and psi by channel."""
    part = component_slice(component)
    n_channels, n_sides = part.stop - part.start, len(SIDES) if component == 0 else 0
    lists: list[IntegerList] = []
    psi: dict[int, I32] = {}
    same: list[int] = []  # lists so far of the same records
    first_of_others = {n_sides, n_sides + n_channels} | ({1, 2} if n_sides else set())
    for place, (coding, n, at) in enumerate(
        zip(header.codings, header.lengths, header.starts, strict=True)
    ):
        if place in first_of_others:
            same = []
        if coding.n_planes == 0:
            continue
        z = join_planes(planes_at(planes, at, coding, n), coding, n).astype(np.int32)
        given: dict[str, I32] = {}
        if place < n_sides:
            name = SIDES[place]
        else:
            channel = part.start + (place - n_sides) % n_channels
            kind = channel_class(channel)
            name = CLASS_NAMES[kind]
            if place < n_sides + n_channels:
                given["parent"] = tile.last[channel, step.targets]
                given["alpha"] = step.alpha[min(kind, N_GROUPS - 1)]
                psi[channel] = z
        sums = {"channel": (same[-1],), "record": tuple(same[-N_BEFORE:])} if same else {}
        same.append(len(lists))
        lists.append(IntegerList(name, coding, z, sums, given))
    return tuple(lists), psi
