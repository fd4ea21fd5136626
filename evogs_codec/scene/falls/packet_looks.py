"""How good views find the prefixes of a stream that end with a packet."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.encoding.few_views import EVERY, MIN_VIEWS, N_DEVIATIONS
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.components import CORE
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import F64, I64, SplatParams
from evogs_codec.scene.falls.states import FALL_DB
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.measure import ALL_LOOK_UP_TO

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["DEEP_DB", "MAX_ORDERED", "Fall", "Looks", "may_be_ordered", "rows_of", "shown"]

DEEP_DB = FALL_DB / 2  # dB; other views may show twice of it
MAX_ORDERED = 2_000  # splats, whose last packets may be put in another order


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
        highest: PSNR before them, dB.
    """

    rows: range
    highest: float

    def before(self, row: int) -> tuple[float, float]:
        """What `Looks.before` says of the first of these rows, with no fall before them."""
        assert row == self.rows.start, "nothing else is asked for"
        return 0.0, self.highest


@dataclass(frozen=True)
class Looks:
    """How the packets of a stream change pictures.

    Attributes:
        whole: PSNR of the whole, dB.
        falls: how much worse pictures are with packets of SH bands than before, dB.
        fall: the deepest with any packet.
        needless: packets of SH bands after the prefix that looks best, if the whole looks worse.
        until: per packet with bytes its row, the deepest fall until then, and the best prefix; none
            where the last packets are not put in another order.
        recovered: falls that later packets make good.
        first: from the first packet that looks worse to the last of all; None if none does.
    """

    whole: float
    falls: Mapping[PacketId, float]
    fall: float
    needless: frozenset[PacketId]
    until: Sequence[tuple[int, float, _Prefix]]
    recovered: Sequence[Fall] = ()
    first: Fall | None = None

    @property
    def worse(self) -> frozenset[PacketId]:
        """Packets that are falls."""
        return frozenset(self.falls)

    @property
    def worst(self) -> frozenset[PacketId]:
        """The one of them that is the deepest."""
        return frozenset(sorted(self.falls, key=lambda packet: -self.falls[packet])[:1])

    def before(self, row: int) -> tuple[float, float]:
        """The deepest fall of the prefixes that end before a packet, and their highest PSNR, dB."""
        known = [(fall, best) for at, fall, best in self.until if at < row]
        return (known[-1][0], known[-1][1].psnr) if known else (0.0, -math.inf)

    @staticmethod
    def of(found: FoundStream, views: Views, most: float = math.inf) -> Looks | None:
        """Of a stream that is made; None if something falls by more dB than that."""
        directory = read_directory(found.data)
        rows = rows_of(directory)
        # Without a layer that refines all leaves, SH bands of adds would be lost.
        of_adds = directory.packet_ids(np.flatnonzero(directory.packets["n_adds"]))
        adds = {(packet.tile, packet.step) for packet in of_adds}
        few = _few_of(views, found)
        best: _Prefix | None = None
        before, deepest = best, 0.0
        falls: dict[PacketId, float] = {}
        since_best: set[PacketId] = set()
        until: list[tuple[int, float, _Prefix]] = []
        recovered: list[Fall] = []
        first: Fall | None = None
        begin: int | None = None  # row of the first packet that looks worse than the best prefix
        packets = zip(rows.tolist(), directory.packet_ids(rows), strict=True)
        for (row, packet), leaves in zip(packets, shown(found, directory, rows), strict=True):
            prefix = _Prefix(leaves, views, few)
            fall = 0.0 if best is None else prefix.fall_after(best)
            deepest = max(deepest, fall)
            if deepest > most:
                return None
            if fall > DEEP_DB and begin is None:
                begin = row
                assert best is not None, "it looks worse than another one"
                first = first or Fall(range(row, len(directory.packets)), best.psnr)
            elif fall <= 0 and best is not None and begin is not None:
                recovered.append(Fall(range(begin, row + 1), best.psnr))
                begin = None
            if best is None or fall <= 0:
                best = prefix
                since_best.clear()
            elif packet.component != CORE and (
                found.is_layered or (packet.tile, packet.step) not in adds
            ):
                since_best.add(packet)
                if fall > DEEP_DB and before is not None and prefix.psnr < before.psnr:
                    falls[packet] = fall
            before = prefix
            if may_be_ordered(found):
                until.append((row, deepest, best))
        if best is None or before is None:
            return Looks(-math.inf, falls, deepest, frozenset(), until)
        needless = frozenset(since_best if before.psnr < best.psnr - DEEP_DB else ())
        return Looks(before.psnr, falls, deepest, needless, until, recovered, first)


class _Prefix:
    """How good views find what a prefix shows.

    With a few views, all judge only where these leave doubt. Otherwise its leaves are not kept.
    """

    def __init__(self, leaves: SplatParams, views: Views, few: Views | None) -> None:
        """Of leaves; `few` are some of the views."""
        self._views, self._few = views, few
        if few is None:
            self.psnr = views.psnr(leaves)
        else:
            self._leaves = leaves

    @cached_property
    def psnr(self) -> float:
        """Of all views, dB."""
        return self._views.psnr(self._leaves)

    def fall_after(self, other: _Prefix) -> float:
        """How much worse it looks than another prefix, dB; about, if that is `DEEP_DB` at most."""
        if self._few is not None:
            worse = other._of_few - self._of_few
            if worse.mean() + N_DEVIATIONS * worse.std() <= DEEP_DB:
                return float(worse.mean())
        return other.psnr - self.psnr

    @cached_property
    def _of_few(self) -> F64:
        assert self._few is not None, "a few views judge first"
        return self._few.psnr_of_each(self._leaves)


def _few_of(views: Views, found: FoundStream) -> Views | None:
    """Those of the views that judge first; None if all do.

    Of many splats too few views tell too little. Where their packets may be put in order, leaves of
    too many prefixes would be kept.
    """
    few = replace(views, cameras=views.cameras[::EVERY], drawn=views.drawn)
    is_small = found.tree.n_leaves <= ALL_LOOK_UP_TO
    if is_small or (len(few.cameras) >= MIN_VIEWS and not may_be_ordered(found)):
        return few
    return None
