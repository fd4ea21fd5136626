"""What a stream says."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

from conformance.generator.builder.frames import FrameStyle, raw

__all__ = ["DROP", "MAX_X", "REFINE", "SPLIT", "Chunk", "Packet", "Stream", "Tile", "Values"]

REFINE, SPLIT, DROP = range(3)
PICKS, PALETTE = 4, 5  # components (spec 12); 0 is core, 1 to 3 are SH bands
X, Y, Z, W, OPACITY, RED, GREEN, BLUE = 0, 1, 2, 3, 10, 11, 12, 13  # channels of core
MAX_X = (1 << 30) - 1

Values = Mapping[int, Sequence[int] | int]  # by channel of the component; a number for all


@dataclass(frozen=True)
class Tile:
    """A row of the tile table."""

    origin: tuple[int, int, int] = (0, 0, 0)
    low: tuple[int, int, int] = (-MAX_X,) * 3
    high: tuple[int, int, int] = (MAX_X,) * 3


@dataclass(frozen=True)
class Packet:
    """A packet and its row.

    Attributes:
        adds, psi: q by channel of the component; a channel that is not named has coding byte 0.
            The adds of a packet of the palette are its entries, channel 0 being channel 14.
        picks: of the new slots, in a packet of picks; by default all 0.
        repicks: of the slots that the step refines or splits, and bit 2 of the flags says that
            there are some; empty: all 0; None: slots keep their picks.
        records: kind by slot; n_splits and the like follow.
        alpha: indices by group, one per split.
        siblings: channels whose psi are sibling differences (spec 7.1), stored as they are given:
            their coding bytes get `delta`, unless they are 0.
        level: of the row: the label of a step of core, or the level of entries.
        n_adds: by default, as many as the longest list of adds.
        flags: of the packet header.
        codings: coding byte by name of the list ("gaps", "kinds", "alpha 3", "psi 0", "adds 13",
            "picks"); by default the smallest of a few.
        stored: integers by name of the list, instead of what follows from the above.
        frames: planes of each frame; by default all in one.
        style: makes each frame of its content.
        is_explicit: a packet of a band or of picks is written although all its integers are 0.
        coding_bytes: written instead of the coding bytes that the planes have.
        entries: changes the frame entries (n_planes, size).
        edit: changes the bytes at the end, before the checksum.
        row: fields of the row that are overridden.
    """

    adds: Values = field(default_factory=dict)
    picks: Sequence[int] = ()
    repicks: Sequence[int] | None = None
    records: Mapping[int, int] = field(default_factory=dict)
    psi: Values = field(default_factory=dict)
    alpha: Mapping[int, Sequence[int]] = field(default_factory=dict)
    siblings: Collection[int] = ()
    tile: int = 0
    component: int = 0
    level: int = 0
    n_adds: int | None = None
    flags: int = 0
    codings: Mapping[str, int] = field(default_factory=dict)
    stored: Mapping[str, Sequence[int]] = field(default_factory=dict)
    frames: Sequence[int] | None = None
    style: FrameStyle = raw
    is_explicit: bool = False
    coding_bytes: Mapping[str, int] = field(default_factory=dict)
    entries: Callable[[list[tuple[int, int]]], list[tuple[int, int]]] = list
    edit: Callable[[bytes], bytes] = bytes
    row: Mapping[str, int] = field(default_factory=dict)

    @property
    def counts(self) -> dict[str, int]:
        """The four counts of a packet of core or of the palette."""
        kinds = list(self.records.values())
        lengths = [len(q) for q in self.adds.values() if not isinstance(q, int)]
        n_adds = max(lengths, default=0) if self.n_adds is None else self.n_adds
        numbers = (n_adds, kinds.count(SPLIT), kinds.count(REFINE), kinds.count(DROP))
        return dict(zip(("n_adds", "n_splits", "n_refines", "n_drops"), numbers, strict=True))


@dataclass(frozen=True)
class Chunk:
    """A chunk; `size` and `crc` follow from the body unless given."""

    kind: bytes
    body: bytes = b""
    size: int | None = None
    crc: int | None = None

    def __bytes__(self) -> bytes:
        size = len(self.body) if self.size is None else self.size
        head = self.kind + struct.pack("<I", size)
        crc = zlib.crc32(head + self.body) if self.crc is None else self.crc
        return head + struct.pack("<I", crc) + self.body


@dataclass(frozen=True)
class Stream:
    """A stream.

    Attributes:
        packets: in the order of the file.
        degree: of SH.
        has_palette: there are picks and a palette, and no bands; bit 8 of `flags` says so.
        n_levels: labels that steps may have.
        tiles: by default one, as large as may be.
        quantisers: (M, E) by (row of QUAN, class); (1, 0) elsewhere.
        alphas: (K, entries) by (level, group); None: no ALFA.
        digests: (tile, component, step): the digest, or None for the right one.
        metadata: of mETa, keys in the order given; values are text or bytes; None: no mETa.
        header: fields that are overridden.
        chunks: changes the list of chunks.
        tail: bytes after the packets.
    """

    packets: Sequence[Packet] = ()
    degree: int = 0
    has_palette: bool = False
    n_levels: int = 1
    tiles: Sequence[Tile] = (Tile(),)
    quantisers: Mapping[tuple[int, int], tuple[int, int]] = field(default_factory=dict)
    alphas: Mapping[tuple[int, int], tuple[int, Sequence[int]]] | None = None
    digests: Mapping[tuple[int, int, int], bytes | None] | None = None
    metadata: Mapping[str | bytes, str | bytes] | None = None
    header: Mapping[str, int | bytes] = field(default_factory=dict)
    grid: tuple[int, int, int, int, int] = (10, 6, 5, 5, 7)
    tier: int = 1
    chunks: Callable[[list[Chunk]], list[Chunk]] = list
    tail: bytes = b""
