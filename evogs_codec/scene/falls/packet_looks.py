"""How good views find the prefixes of a stream that end with a packet."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.encoding.few_views import EVERY, MIN_VIEWS
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.components import CORE
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I64, SplatParams
from evogs_codec.scene.falls.judges import PACKET_FALL_DB, Judges, Prefix
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.measure import MANY_ABOVE

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Views

__all__ = [
    "MAX_ORDERED",
    "Fall",
    "Looks",
    "may_be_ordered",
    "rows_of",
    "shown",
]

MAX_ORDERED = 2_000  # splats, whose last packets may be put in another order
SMALL_PIXELS = 75  # of the longer side of a small picture
EMPTIED_PART = 1 / 200  # of the bytes of all packets; one that has less is small


def rows_of(directory: Directory) -> I64:
    """Packets with bytes, in the order of the stream."""
    rows = np.flatnonzero(directory.packets["size"])
    return rows[np.argsort(directory.offsets[rows], kind="stable")]


def shown(found: FoundStream, directory: Directory, rows: I64) -> Iterator[SplatParams]:
    """What is there after each of these packets."""
    prefixes = found.prefixes
    ends = directory.offsets[rows] + directory.packets["size"][rows].astype(np.int64)
    cuts = [prefixes.of_cut(Cut.of_prefix(directory, end)) for end in ends.tolist()]
    return prefixes.shown(cuts, found.tree.shown_degree)


def may_be_ordered(found: FoundStream) -> bool:
    """Whether its last packets may be put in another order: of few splats, or if they are few."""
    return found.tree.n_leaves <= MAX_ORDERED or found.is_at_once


class Fall(NamedTuple):
    """A fall, and the packets from there on.

    Attributes:
        rows: of the packets from the first that looks worse to the one that makes it good, or to
            the last of all.
        best: the prefix before them that looks best.
        packets: what they are; none in `Looks.first`.
    """

    rows: range
    best: Prefix
    packets: Sequence[PacketId] = ()

    def before(self, row: int) -> tuple[float, Prefix]:
        """What `Looks.before` says of the first of these rows, with no fall before them."""
        assert row == self.rows.start, "nothing else is asked for"
        return 0.0, self.best


@dataclass(frozen=True)
class Looks:
    """How the packets of a stream change pictures.

    Attributes:
        whole: PSNR of the whole, dB.
        falls: of packets of SH bands with which a prefix looks worse than without, by how many dB
            it looks worse than the best one.
        fall: the deepest with any packet.
        needless: packets of SH bands after the prefix that looks best, if the whole looks worse.
        until: per packet with bytes its row, the deepest fall until then, and the best prefix; none
            where the last packets are not put in another order.
        small: packets of SH bands that have a small part of the bytes of all.
        recovered: falls that later packets make good.
        first: from the first packet that looks worse to the last of all; None if none does.
    """

    whole: float
    falls: Mapping[PacketId, float]
    fall: float
    needless: frozenset[PacketId]
    until: Sequence[tuple[int, float, Prefix]]
    small: frozenset[PacketId] = frozenset()
    recovered: Sequence[Fall] = ()
    first: Fall | None = None

    @property
    def worse(self) -> frozenset[PacketId]:
        """Packets in falls."""
        return frozenset(self.falls)

    @property
    def worst(self) -> frozenset[PacketId]:
        """The packet of the deepest fall, or none."""
        return frozenset(sorted(self.falls, key=lambda packet: -self.falls[packet])[:1])

    @property
    def small_worse(self) -> frozenset[PacketId]:
        """Packets in falls that have few bytes."""
        return self.worse & self.small

    @property
    def small_until_good(self) -> frozenset[PacketId]:
        """These, and all others of few bytes up to the packet that makes a fall good."""
        ids = [packet for fall in self.recovered for packet in fall.packets]
        return self.small_worse | self.small.intersection(ids)

    def before(self, row: int) -> tuple[float, Prefix | None]:
        """The deepest fall of the prefixes that end before a packet, dB, and the best of them."""
        known = [(fall, best) for at, fall, best in self.until if at < row]
        return known[-1] if known else (0.0, None)

    @staticmethod
    def of(found: FoundStream, views: Views, most: float = math.inf) -> Looks | None:
        """Of a stream that is made; None if something falls by more dB than that."""
        directory = read_directory(found.data)
        rows = rows_of(directory)
        may_be_empty = _may_be_empty(directory, has_layer=found.is_layered)
        judges = judges_of(views, found)
        best: Prefix | None = None
        previous, deepest = best, 0.0
        falls: dict[PacketId, float] = {}
        since_best: set[PacketId] = set()
        until: list[tuple[int, float, Prefix]] = []
        recovered: list[Fall] = []
        first: Fall | None = None
        begin: int | None = None  # row of the first packet that looks worse than the best prefix
        packets = zip(rows.tolist(), directory.packet_ids(rows), strict=True)
        for (row, packet), leaves in zip(packets, shown(found, directory, rows), strict=True):
            prefix = Prefix(leaves, judges)
            fall = 0.0 if best is None else prefix.fall_after(best)
            deepest = max(deepest, fall)
            if deepest > most:
                return None
            if fall > PACKET_FALL_DB and begin is None:
                begin = row
                assert best is not None, "it looks worse than another one"
                first = first or Fall(range(row, len(directory.packets)), best)
            elif fall <= 0 and best is not None and begin is not None:
                its = range(begin, row + 1)
                recovered.append(Fall(its, best, directory.packet_ids(slice(begin, row + 1))))
                begin = None
            if best is None or fall <= 0:
                best = prefix
                since_best.clear()
            elif packet in may_be_empty:
                since_best.add(packet)
                if fall > PACKET_FALL_DB and previous is not None and prefix.psnr < previous.psnr:
                    falls[packet] = fall
            previous = prefix
            if may_be_ordered(found):
                until.append((row, deepest, best))
        if best is None or previous is None:
            return Looks(-math.inf, falls, deepest, frozenset(), until)
        whole = previous.psnr
        needless = frozenset(since_best if whole < best.psnr - PACKET_FALL_DB else ())
        small = may_be_empty & _of_few_bytes(directory)
        return Looks(whole, falls, deepest, needless, until, small, recovered, first)


def _may_be_empty(directory: Directory, *, has_layer: bool) -> frozenset[PacketId]:
    """Packets of SH bands; not those of adds without a layer that refines all leaves."""
    of_adds = directory.packet_ids(np.flatnonzero(directory.packets["n_adds"]))
    adds = set() if has_layer else {(packet.tile, packet.step) for packet in of_adds}
    packets = directory.packet_ids()
    return frozenset(
        one for one in packets if one.component != CORE and (one.tile, one.step) not in adds
    )


def _of_few_bytes(directory: Directory) -> frozenset[PacketId]:
    """Packets that have a small part of the bytes of all."""
    sizes = directory.packets["size"].astype(np.int64)
    return frozenset(directory.packet_ids(np.flatnonzero(sizes < EMPTIED_PART * sizes.sum())))


def judges_of(views: Views, found: FoundStream) -> Judges:
    """How views judge the prefixes of a stream.

    Fewer than `MIN_VIEWS` views tell too little. Of more splats than `MANY_ABOVE` one packet
    changes little of a view, so there are no small pictures. Where their packets may be put in
    another order, leaves of too many prefixes would be kept.
    """
    few = _with_cameras(views, views.cameras[::EVERY])
    if len(few.cameras) < MIN_VIEWS:
        return Judges(views)
    if found.tree.n_leaves <= MANY_ABOVE:
        small = [camera.within(SMALL_PIXELS) for camera in views.cameras]
        return Judges(views, few, _with_cameras(views, small))
    return Judges(views) if may_be_ordered(found) else Judges(views, few)


def _with_cameras(views: Views, cameras: Sequence[Camera]) -> Views:
    return replace(views, cameras=cameras, drawn=views.drawn)
