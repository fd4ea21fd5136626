"""Packets: the records of one step of one tile and component, as bytes (spec 5.9, 7.1, 7.2).

Letters: C channels of the component, R records that name a slot, P of them with psi, S splits,
A adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec import frames, layout
from evogs_codec.errors import Fault, StreamError
from evogs_codec.planes import (
    ABSENT,
    CODINGS,
    MAX_STORED,
    Coding,
    choose_coding,
    delta,
    entropy,
    inverse_ycocg,
    join_planes,
    planes_at,
    split_planes,
    stray_bits,
    undelta,
    unzigzag,
    ycocg,
    zigzag,
)
from evogs_codec.splats import I32, I64, U8
from evogs_codec.tree import N_GROUPS, Kind

__all__ = ["N_CORE", "Counts", "Packet", "Values", "pack", "unpack"]

N_CORE = 14  # channels of core: geometry and SH band 0
CORE_SH = slice(11, 14)
Coded: TypeAlias = tuple[Coding, npt.NDArray[np.integer]]

N_SIDES = 2 + N_GROUPS  # lists of core before psi: slots, kinds, alpha
MAX_NEW_PER_BYTE = 16  # R-5.6-7
FLAG_PSI_YCOCG, FLAG_ADDS_YCOCG = 1, 2


@dataclass(frozen=True)
class Counts:
    """The record counts of a packet entry."""

    n_adds: int
    n_splits: int
    n_refines: int
    n_drops: int

    @property
    def n_records(self) -> int:
        return self.n_splits + self.n_refines + self.n_drops

    @property
    def n_psi(self) -> int:
        return self.n_splits + self.n_refines

    @property
    def has_kinds(self) -> bool:
        """More than one kind occurs, so kinds are stored."""
        return (self.n_splits > 0) + (self.n_refines > 0) + (self.n_drops > 0) > 1


@dataclass(frozen=True, eq=False)
class Values:
    """psi or adds of a packet, as stored: C channels of n values.

    Attributes:
        n: values of a channel.
        codes: (C,) coding bytes.
        data: the planes of the packet.
        starts: (C,) where the planes of each channel begin in `data`.
        is_ycocg: the SH triples are YCoCg-R.
        first_sh: first channel of an SH triple.
        offset: of the packet in the file.
    """

    n: int
    codes: U8
    data: U8
    starts: I64
    is_ycocg: bool
    first_sh: int
    offset: int

    def is_zero(self, channel: int) -> bool:
        """All integers are 0, known without looking at a plane."""
        return not self.codes[self._turned_with(channel)].any()

    def bound(self, channel: int) -> int | None:
        """A bound of |q| from the coding alone; None if only the values tell."""
        channels = self._turned_with(channel)
        codings = [self._coding(k) for k in range(channels.start, channels.stop)]
        if any(coding.delta for coding in codings):
            return None
        largest = max(1 << coding.bits >> 1 for coding in codings)
        return largest if len(codings) == 1 else 4 * largest + 2

    def rows(self, channel: int) -> I32:
        """(1, n) or (3, n) integers of the channel and those it is turned with."""
        channels = self._turned_with(channel)
        rows = np.stack([self._stored(k) for k in range(channels.start, channels.stop)])
        return inverse_ycocg(rows) if len(rows) == 3 else rows

    def all(self) -> I32:
        """(C, n) integers of all channels."""
        out = np.zeros((len(self.codes), self.n), np.int32)
        channel = 0
        while channel < len(out):
            rows = self.rows(channel)
            out[channel : channel + len(rows)] = rows
            channel += len(rows)
        return out

    def _turned_with(self, channel: int) -> slice:
        """The triple that YCoCg-R turns together, or the channel alone."""
        if not self.is_ycocg or channel < self.first_sh:
            return slice(channel, channel + 1)
        first = channel - (channel - self.first_sh) % 3
        return slice(first, first + 3)

    def _coding(self, channel: int) -> Coding:
        coding = CODINGS[self.codes[channel]]
        assert coding is not None
        return coding

    def _stored(self, channel: int) -> I32:
        coding = self._coding(channel)
        if coding is ABSENT:
            return np.zeros(self.n, np.int32)
        planes = planes_at(self.data, int(self.starts[channel]), coding, self.n)
        q = unzigzag(join_planes(planes, coding, self.n))
        return undelta(q, self.offset) if coding.delta else q


@dataclass(frozen=True, eq=False)
class Packet:
    """An unpacked packet; for an SH band slots, kinds and alpha are empty.

    Attributes:
        slots: (R,) int64, increasing.
        kinds: (R,) uint8.
        alpha: (S,) uint8 indices per group, None where all are 0.
        psi, adds: the channels.
    """

    slots: npt.NDArray[np.int64]
    kinds: npt.NDArray[np.integer]
    alpha: tuple[npt.NDArray[np.integer] | None, ...]
    psi: Values
    adds: Values


def sh_channels(component: int) -> slice:
    """Which channels of a component are SH triples."""
    return CORE_SH if component == 0 else slice(0, component_channels(component))


def component_channels(component: int) -> int:
    """C: 14 of core, 3 (2 b + 1) of band b."""
    return N_CORE if component == 0 else 3 * (2 * component + 1)


# --- reading -------------------------------------------------------------------------------------


def unpack(body: memoryview, component: int, counts: Counts, offset: int) -> Packet:
    """The records of a packet whose CRC-32 is right; `offset` is its place in the file.

    Raises:
        StreamError: with the faults of spec 5.9, 5.10 and 7.2 that need no slots.
    """
    if len(body) == 0:
        return _empty_packet(component, counts, offset)
    head = read_header(body, component, counts, offset)
    data = read_planes(body, head, offset)
    starts = head.starts
    for coding, n, start in zip(head.codings, head.lengths, starts, strict=True):
        if coding.low and stray_bits(planes_at(data, start, coding, n), coding, n):  # R-5.9-9
            raise StreamError(Fault.E_PACKET, "a low plane has a bit above its bits", offset)
    slots, kinds, alpha = np.empty(0, np.int64), np.empty(0, np.uint8), (None,) * N_GROUPS
    if component == 0:
        sides = [
            None if coding is ABSENT else join_planes(planes_at(data, at, coding, n), coding, n)
            for coding, n, at in zip(head.codings[:N_SIDES], head.lengths, starts, strict=False)
        ]
        gaps = np.zeros(counts.n_records, np.uint8) if sides[0] is None else sides[0]
        slots = np.cumsum(gaps, dtype=np.int64) + np.arange(counts.n_records)
        kinds = _kinds(sides[1], counts)
        alpha = tuple(sides[2:])
    n_channels = component_channels(component)
    psi, adds = (
        Values(
            n,
            np.frombuffer(head.coding_bytes, np.uint8, n_channels, at),
            data,
            np.array(starts[at : at + n_channels], np.int64),
            bool(head.flags & flag),
            sh_channels(component).start,
            offset,
        )
        for n, at, flag in (
            (counts.n_psi, head.first, FLAG_PSI_YCOCG),
            (counts.n_adds, head.first + n_channels, FLAG_ADDS_YCOCG),
        )
    )
    return Packet(slots, kinds, alpha, psi, adds)


@dataclass(frozen=True)
class Header:
    """A packet header with what follows from it.

    Attributes:
        flags: of the packet header.
        codings: of slots, kinds, alpha of each group (core only), psi and adds of each channel.
        lengths: values of each.
        frames: (planes, bytes) of each frame.
        size: bytes before the first frame.
        first: index of the coding of the first channel of psi.
    """

    flags: int
    coding_bytes: bytes
    codings: tuple[Coding, ...]
    lengths: tuple[int, ...]
    frames: tuple[tuple[int, int], ...]
    size: int
    first: int

    @property
    def plane_sizes(self) -> list[int]:
        """Bytes of each plane, in order."""
        pairs = zip(self.codings, self.lengths, strict=True)
        return [size for coding, n in pairs for size in coding.plane_sizes(n)]

    @property
    def starts(self) -> list[int]:
        """Where the planes of each list begin, in the planes of the packet."""
        pairs = zip(self.codings, self.lengths, strict=True)
        sizes = [0 if c is ABSENT else sum(c.plane_sizes(n)) for c, n in pairs]
        return list(accumulate(sizes, initial=0))[:-1]


def value_counts(component: int, counts: Counts) -> tuple[int, ...]:
    """Values of each coding byte, in the order of spec 5.9."""
    n_channels = component_channels(component)
    sides: tuple[int, ...] = ()
    if component == 0:
        n_kinds = counts.n_records if counts.has_kinds else 0
        sides = (counts.n_records, n_kinds, *(counts.n_splits,) * N_GROUPS)
    return (*sides, *(counts.n_psi,) * n_channels, *(counts.n_adds,) * n_channels)


def read_header(body: memoryview, component: int, counts: Counts, offset: int) -> Header:
    """The header of a packet of size above 0, checked (spec 5.9).

    Raises:
        StreamError: E_PACKET or E_RESERVED at `offset`.
    """

    def refuse(detail: str) -> StreamError:
        return StreamError(Fault.E_PACKET, detail, offset)

    lengths = value_counts(component, counts)
    fixed = layout.size_of(layout.PACKET_HEADER)
    at = fixed + len(lengths)
    if len(body) < at:  # R-5.9-1
        raise refuse("the packet is shorter than its header")
    flags, n_frames = body[0], body[1]
    coding_bytes = bytes(body[fixed:at])
    if flags >> 2 or any(byte >> 7 for byte in coding_bytes):  # R-4.4-1
        raise StreamError(Fault.E_RESERVED, "a reserved bit of the packet header is set", offset)
    found = [CODINGS[byte] for byte in coding_bytes]
    codings = tuple(coding for coding in found if coding is not None)
    if len(codings) != len(found):  # R-5.9-2
        raise refuse("a coding byte is not valid")
    first_add = len(lengths) - component_channels(component)
    if any(coding.delta for coding in codings[:first_add]):  # R-5.9-3
        raise refuse("delta is set for other values than adds")
    if any(c and n == 0 for c, n in zip(coding_bytes, lengths, strict=True)):  # R-5.9-4
        raise refuse("values are coded that do not occur")
    entry = layout.size_of(layout.FRAME_ENTRY)
    if len(body) < at + n_frames * entry:  # R-5.9-1
        raise refuse("the packet is shorter than its frame entries")
    frames_ = layout.read_table(layout.FRAME_ENTRY, body[at : at + n_frames * entry])
    return Header(
        flags=flags,
        coding_bytes=coding_bytes,
        codings=codings,
        lengths=lengths,
        frames=tuple(zip(frames_["n_planes"].tolist(), frames_["size"].tolist(), strict=True)),
        size=at + n_frames * entry,
        first=first_add - component_channels(component),
    )


def read_planes(body: memoryview, head: Header, offset: int) -> U8:
    """The planes of a packet, decompressed, one after the other.

    Raises:
        StreamError: E_PACKET, E_FRAME or E_ZSTD at `offset`.
    """
    sizes = head.plane_sizes
    if any(n == 0 for n, _ in head.frames) or sum(n for n, _ in head.frames) != len(sizes):
        raise StreamError(  # R-5.9-7
            Fault.E_PACKET, f"the frames do not hold {len(sizes)} planes", offset
        )
    if head.size + sum(size for _, size in head.frames) != len(body):  # R-5.9-8
        raise StreamError(Fault.E_PACKET, "the frames do not fill the packet", offset)
    contents = []
    at, plane = head.size, 0
    for n_planes, size in head.frames:
        content = sum(sizes[plane : plane + n_planes])
        contents.append(frames.decompress(body[at : at + size], content, offset))
        at, plane = at + size, plane + n_planes
    return np.frombuffer(contents[0] if len(contents) == 1 else b"".join(contents), np.uint8)


def _kinds(values: npt.NDArray[np.integer] | None, counts: Counts) -> npt.NDArray[np.integer]:
    if counts.has_kinds:
        return np.zeros(counts.n_records, np.uint8) if values is None else values
    kind = Kind.SPLIT if counts.n_splits else Kind.DROP if counts.n_drops else Kind.REFINE
    return np.full(counts.n_records, kind, np.uint8)


def check_kinds(kinds: npt.NDArray[np.integer], counts: Counts, offset: int) -> None:
    """Raise E_KIND unless the stored kinds are those counted (R-7.2-2)."""
    if counts.has_kinds:
        counted = [counts.n_refines, counts.n_splits, counts.n_drops]
        if int(kinds.max()) > Kind.DROP or np.bincount(kinds, minlength=3).tolist() != counted:
            raise StreamError(Fault.E_KIND, "the kinds contradict the counts", offset)


def _empty_packet(component: int, counts: Counts, offset: int) -> Packet:
    n_channels = component_channels(component)

    def zero(n: int) -> Values:
        none = np.zeros(n_channels, np.uint8)
        starts = np.zeros(n_channels, np.int64)
        return Values(n, none, none[:0], starts, False, sh_channels(component).start, offset)

    return Packet(
        np.empty(0, np.int64),
        np.empty(0, np.uint8),
        (None,) * N_GROUPS,
        zero(counts.n_psi),
        zero(counts.n_adds),
    )


# --- writing -------------------------------------------------------------------------------------


def pack(
    component: int,
    slots: I32,
    kinds: U8,
    alpha: Sequence[U8 | None],
    psi: I32,
    adds: I32,
    *,
    effort: int,
) -> bytes:
    """The bytes of a packet; the inverse of `unpack`.

    Args:
        component: 0 core, b the SH band b.
        slots: (R,) increasing.
        kinds: (R,).
        alpha: (S,) indices per group, None where all are 0; used by core only.
        psi: (C, P) integers.
        adds: (C, A) integers.
        effort: Zstandard level.

    Raises:
        ValueError: an integer needs more than 24 bits.
    """
    n_splits = int(np.count_nonzero(kinds == Kind.SPLIT))
    n_refines = int(np.count_nonzero(kinds == Kind.REFINE))
    counts = Counts(adds.shape[1], n_splits, n_refines, len(slots) - n_splits - n_refines)
    if component == 0 and counts.n_records + counts.n_adds == 0:
        return b""
    sides: list[tuple[Coding, npt.NDArray[np.integer]]] = []
    if component == 0:
        gaps = np.diff(slots.astype(np.int64), prepend=-1) - 1
        sides.append((choose_coding(gaps)[0], gaps))
        sides.append((choose_coding(kinds)[0] if counts.has_kinds else ABSENT, kinds))
        for indices in alpha:
            stored = np.zeros(n_splits, np.uint8) if indices is None else indices
            sides.append((choose_coding(stored)[0], stored))
    flags = 0
    sh = sh_channels(component)
    for values, flag in ((psi, FLAG_PSI_YCOCG), (adds, FLAG_ADDS_YCOCG)):
        rows, is_ycocg = _decorrelate(values, sh)
        flags |= flag if is_ycocg else 0
        sides += [_code_channel(row, may_delta=flag == FLAG_ADDS_YCOCG) for row in rows]
    if component and all(coding == ABSENT for coding, _ in sides):
        return b""
    body = _join(flags, sides, effort)
    if component == 0 and counts.n_adds + n_splits > MAX_NEW_PER_BYTE * len(body):
        body = _pad(flags, sides, counts)
    return body


def _decorrelate(values: I32, sh: slice) -> tuple[I32, bool]:
    """YCoCg-R on the SH triples, if that lowers the entropy."""
    rows = values[sh]
    if rows.size == 0 or not rows.any() or int(np.abs(rows).max()) >= MAX_STORED // 8:
        return values, False
    turned = ycocg(rows)
    stride = max(1, rows.shape[1] // 20000)
    before = sum(entropy(zigzag(row[::stride])) for row in rows)
    after = sum(entropy(zigzag(row[::stride])) for row in turned)
    if after >= before:
        return values, False
    out = values.copy()
    out[sh] = turned
    return out, True


def _code_channel(q: I32, *, may_delta: bool) -> Coded:
    """Coding and stored integers of a channel; adds as differences if that is cheaper."""
    if not q.any():
        return ABSENT, q
    options = []
    for is_delta in (False, True) if may_delta and len(q) > 1 else (False,):
        z = zigzag(delta(q)) if is_delta else zigzag(q)
        if int(z.max()) < MAX_STORED:
            coding, cost = choose_coding(z, is_delta=is_delta)
            options.append((cost, is_delta, coding, z))
    if not options:
        raise ValueError("an integer needs more than 24 bits: take larger steps")
    _, _, coding, z = min(options, key=lambda option: option[:2])
    return coding, z


def _join(flags: int, parts: Sequence[Coded], effort: int) -> bytes:
    """A packet from its values, in one frame or a frame per plane, whichever is smaller."""
    planes = [plane for coding, values in parts for plane in split_planes(values, coding)]
    codings = bytes(coding.byte() for coding, _ in parts)
    options: list[list[tuple[int, bytes]]] = []
    if len(planes) != 1:
        whole = b"".join(planes)
        if len(whole) <= frames.MAX_CONTENT:
            options.append([(len(planes), frames.compress(whole, effort))] if planes else [])
    if planes:
        options.append([(1, frames.compress(plane, effort)) for plane in planes])
    return min((_assemble(flags, codings, option) for option in options), key=len)


def _pad(flags: int, parts: Sequence[Coded], counts: Counts) -> bytes:
    """A packet that R-5.6-7 allows: planes stored raw, a byte per new slot at least."""
    whole_bytes = list(parts)
    for place, n in ((2, counts.n_splits), (len(parts) - 1, counts.n_adds)):
        coding, values = whole_bytes[place]
        if n and not coding.high:  # alpha of positions, and the last channel of the adds
            whole_bytes[place] = Coding(0, 1, coding.delta), values
    planes = [plane for coding, values in whole_bytes for plane in split_planes(values, coding)]
    codings = bytes(coding.byte() for coding, _ in whole_bytes)
    return _assemble(flags, codings, [(1, frames.store(plane)) for plane in planes])


def _assemble(flags: int, codings: bytes, parts: Sequence[tuple[int, bytes]]) -> bytes:
    head = layout.build(layout.PACKET_HEADER, flags=flags, n_frames=len(parts))
    entries = b"".join(
        layout.build(layout.FRAME_ENTRY, n_planes=n, size=len(frame)) for n, frame in parts
    )
    return head + codings + entries + b"".join(frame for _, frame in parts)
