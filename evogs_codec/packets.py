"""Packets: the records of one step of one tile and component, as bytes (spec 5.9, 7.1, 7.2).

Letters: C channels of the component, R records that name a slot, P of them with psi, S splits,
A adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec import frames, layout
from evogs_codec.errors import Fault, StreamError
from evogs_codec.planes import (
    ABSENT,
    MAX_STORED,
    Coding,
    choose_coding,
    delta,
    entropy,
    inverse_ycocg,
    join_planes,
    split_planes,
    undelta,
    unzigzag,
    ycocg,
    zigzag,
)
from evogs_codec.splats import I32, U8
from evogs_codec.tree import N_GROUPS, Kind

__all__ = ["N_CORE", "Counts", "Packet", "Values", "pack", "unpack"]

N_CORE = 14  # channels of core: geometry and SH band 0
CORE_SH = slice(11, 14)
MAX_NEW_PER_BYTE = 64  # R-5.6-7
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
    """psi or adds of a packet: the stored planes of C channels of n values."""

    n: int
    codings: tuple[Coding, ...]
    planes: tuple[tuple[U8, ...], ...]
    is_ycocg: bool
    sh: slice  # the channels that are SH triples
    offset: int

    def is_zero(self, channel: int) -> bool:
        """All integers are 0, known without looking at a plane."""
        if self.is_ycocg and channel >= self.sh.start:
            return all(self.codings[k] == ABSENT for k in self._triple(channel))
        return self.codings[channel] == ABSENT

    def bound(self, channel: int) -> int | None:
        """A bound of |q| from the coding alone; None if only the values tell."""
        in_triple = self.is_ycocg and channel >= self.sh.start
        codings = [self.codings[k] for k in self._triple(channel)] if in_triple else []
        codings = codings or [self.codings[channel]]
        if any(coding.delta for coding in codings):
            return None
        largest = max(1 << coding.bits >> 1 for coding in codings)
        return 4 * largest + 2 if in_triple else largest

    def q(self, channel: int) -> I32:
        """(n,) integers of one channel."""
        if self.is_ycocg and channel >= self.sh.start:
            triple = self._triple(channel)
            rows = np.stack([self._stored(k) for k in triple])
            return inverse_ycocg(rows)[channel - triple.start]
        return self._stored(channel)

    def all(self) -> I32:
        """(C, n) integers of all channels."""
        rows = np.zeros((len(self.codings), self.n), np.int32)
        for channel, coding in enumerate(self.codings):
            if coding != ABSENT:
                rows[channel] = self._stored(channel)
        if self.is_ycocg:
            rows[self.sh] = inverse_ycocg(rows[self.sh])
        return rows

    def _triple(self, channel: int) -> range:
        first = channel - (channel - self.sh.start) % 3
        return range(first, first + 3)

    def _stored(self, channel: int) -> I32:
        coding = self.codings[channel]
        if coding == ABSENT:
            return np.zeros(self.n, np.int32)
        q = unzigzag(join_planes(list(self.planes[channel]), coding, self.n))
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
    kinds: U8
    alpha: tuple[U8 | None, ...]
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
    n_channels = component_channels(component)
    if len(body) == 0:
        return _empty_packet(n_channels, component, counts, offset)
    head = read_header(body, component, n_channels, counts, offset)
    lengths = plane_lengths(head, component, counts)
    planes = read_planes(body, head, lengths, offset)

    def take(coding: Coding) -> tuple[U8, ...]:
        taken = tuple(planes[: coding.n_planes])
        del planes[: coding.n_planes]
        if coding.low and int(taken[0].max()) >> coding.low:  # R-5.9-9
            raise StreamError(Fault.E_PACKET, "a low plane has a bit above its bits", offset)
        return taken

    gap_planes = take(head.slots) if component == 0 else ()
    kinds_plane = planes.pop(0) if component == 0 and counts.has_kinds else None
    alpha = tuple(
        planes.pop(0) if head.alpha_mask >> group & 1 else None for group in range(N_GROUPS)
    )
    sh = sh_channels(component)
    psi, adds = (
        Values(
            n,
            codings,
            tuple(take(coding) for coding in codings),
            bool(head.flags & flag),
            sh,
            offset,
        )
        for n, codings, flag in (
            (counts.n_psi, head.psi, FLAG_PSI_YCOCG),
            (counts.n_adds, head.adds, FLAG_ADDS_YCOCG),
        )
    )
    n_records = counts.n_records if component == 0 else 0
    gaps = join_planes(list(gap_planes), head.slots, n_records)
    slots = np.cumsum(gaps, dtype=np.int64) + np.arange(n_records)
    return Packet(slots, _kinds(kinds_plane, counts, n_records), alpha, psi, adds)


@dataclass(frozen=True)
class Header:
    flags: int
    slots: Coding
    alpha_mask: int
    psi: tuple[Coding, ...]
    adds: tuple[Coding, ...]
    frames: tuple[tuple[int, int], ...]  # planes, bytes
    size: int


def read_header(
    body: memoryview, component: int, n_channels: int, counts: Counts, offset: int
) -> Header:
    def refuse(detail: str) -> StreamError:
        return StreamError(Fault.E_PACKET, detail, offset)

    fixed = layout.size_of(layout.PACKET_HEADER)
    at = fixed + 2 * n_channels
    if len(body) < at:  # R-5.9-1
        raise refuse("the packet is shorter than its header")
    fields = layout.parse(layout.PACKET_HEADER, body, offset)
    coding_bytes = bytes(body[fixed:at])
    all_bytes = bytes([fields["slot_coding"]]) + coding_bytes
    if (
        fields["flags"] >> 2
        or fields["alpha_mask"] >> N_GROUPS
        or any(byte >> 7 for byte in all_bytes)
    ):  # R-4.4-1
        raise StreamError(Fault.E_RESERVED, "a reserved bit of the packet header is set", offset)
    codings = [Coding.of_byte(byte) for byte in all_bytes]
    valid = [coding for coding in codings if coding is not None]
    if len(valid) != len(codings):  # R-5.9-2
        raise refuse("a coding byte is not valid")
    slots, psi, adds = valid[0], valid[1 : 1 + n_channels], valid[1 + n_channels :]
    if slots.delta or any(coding.delta for coding in psi):  # R-5.9-3
        raise refuse("delta is set for slots or psi")
    for n, coded in (
        (counts.n_records if component == 0 else 0, [slots]),
        (counts.n_psi, psi),
        (counts.n_adds, adds),
    ):
        if n == 0 and any(coding != ABSENT for coding in coded):  # R-5.9-4, R-5.9-6
            raise refuse("values are coded that do not occur")
    alpha_mask = fields["alpha_mask"]
    if alpha_mask and (counts.n_splits == 0 or component):  # R-5.9-5, R-5.9-6
        raise refuse("alpha indices are stored without splits")
    entries = []
    entry_size = layout.size_of(layout.FRAME_ENTRY)
    if len(body) < at + fields["n_frames"] * entry_size:  # R-5.9-1
        raise refuse("the packet is shorter than its frame entries")
    for _ in range(fields["n_frames"]):
        entries.append((body[at], int.from_bytes(body[at + 1 : at + 5], "little")))
        at += entry_size
    return Header(
        fields["flags"], slots, alpha_mask, tuple(psi), tuple(adds), tuple(entries), at
    )


def plane_lengths(head: Header, component: int, counts: Counts) -> list[int]:
    """Bytes of each plane, in the order of spec 5.9."""
    lengths = []
    if component == 0:
        lengths += [counts.n_records] * head.slots.n_planes
        lengths += [counts.n_records] * counts.has_kinds
        lengths += [counts.n_splits] * head.alpha_mask.bit_count()
    lengths += [counts.n_psi] * sum(coding.n_planes for coding in head.psi)
    lengths += [counts.n_adds] * sum(coding.n_planes for coding in head.adds)
    return lengths


def read_planes(
    body: memoryview, head: Header, lengths: Sequence[int], offset: int
) -> list[U8]:
    if any(n == 0 for n, _ in head.frames) or sum(n for n, _ in head.frames) != len(lengths):
        raise StreamError(  # R-5.9-7
            Fault.E_PACKET, f"the frames do not hold {len(lengths)} planes", offset
        )
    if head.size + sum(size for _, size in head.frames) != len(body):  # R-5.9-8
        raise StreamError(Fault.E_PACKET, "the frames do not fill the packet", offset)
    planes: list[U8] = []
    at = head.size
    for n_planes, size in head.frames:
        content = lengths[len(planes) : len(planes) + n_planes]
        data = frames.decompress(body[at : at + size], sum(content), offset)
        begin = 0
        for length in content:
            planes.append(np.frombuffer(data, np.uint8, length, begin))
            begin += length
        at += size
    return planes


def _kinds(plane: U8 | None, counts: Counts, n_records: int) -> U8:
    if plane is not None:
        return plane
    kind = Kind.SPLIT if counts.n_splits else Kind.DROP if counts.n_drops else Kind.REFINE
    return np.full(n_records, kind, np.uint8)


def check_kinds(kinds: U8, counts: Counts, offset: int) -> None:
    """Raise E_KIND unless the stored kinds are those counted (R-7.2-2)."""
    if counts.has_kinds:
        found = np.bincount(kinds, minlength=3).tolist()
        if found != [counts.n_refines, counts.n_splits, counts.n_drops]:
            raise StreamError(Fault.E_KIND, "the kinds contradict the counts", offset)


def _empty_packet(n_channels: int, component: int, counts: Counts, offset: int) -> Packet:
    def zero(n: int) -> Values:
        codings = (ABSENT,) * n_channels
        return Values(n, codings, ((),) * n_channels, False, sh_channels(component), offset)

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
    sh = sh_channels(component)
    planes: list[bytes] = []
    slot_coding, alpha_mask = ABSENT, 0
    if component == 0:
        gaps = (np.diff(slots.astype(np.int64), prepend=-1) - 1).astype(np.uint32)
        slot_coding = choose_coding(gaps)
        planes += split_planes(gaps, slot_coding)
        if counts.has_kinds:
            planes.append(kinds.astype(np.uint8).tobytes())
        for group, indices in enumerate(alpha):
            if indices is not None and n_splits and indices.any():
                alpha_mask |= 1 << group
                planes.append(indices.astype(np.uint8).tobytes())
    flags = 0
    coding_bytes = b""
    for values, flag in ((psi, FLAG_PSI_YCOCG), (adds, FLAG_ADDS_YCOCG)):
        stored, is_ycocg = _decorrelate(values, sh)
        flags |= flag if is_ycocg else 0
        for row in stored:
            coding, z = _code_channel(row, may_delta=flag == FLAG_ADDS_YCOCG)
            coding_bytes += bytes([coding.byte()])
            planes += split_planes(z, coding)
    if component and not planes:
        return b""
    head = (flags, slot_coding.byte(), alpha_mask)
    body = _join(head, coding_bytes, planes, effort)
    if counts.n_adds + counts.n_splits > MAX_NEW_PER_BYTE * len(body) and component == 0:
        body = _pad(head, coding_bytes, planes, counts)
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


def _code_channel(q: I32, *, may_delta: bool) -> tuple[Coding, npt.NDArray[np.uint32]]:
    """Coding and stored integers of a channel; adds as differences if that is cheaper."""
    if not q.any():
        return ABSENT, np.zeros(len(q), np.uint32)
    options = []
    for is_delta in (False, True) if may_delta and len(q) > 1 else (False,):
        z = zigzag(delta(q)) if is_delta else zigzag(q)
        if int(z.max()) < MAX_STORED:
            coding = choose_coding(z, is_delta=is_delta)
            cost = sum(
                entropy(np.frombuffer(plane, np.uint8)) for plane in split_planes(z, coding)
            )
            options.append((cost, is_delta, coding, z))
    if not options:
        raise ValueError("an integer needs more than 24 bits: take larger steps")
    _, _, coding, z = min(options, key=lambda option: option[:2])
    return coding, z


def _join(head: tuple[int, int, int], codings: bytes, planes: list[bytes], effort: int) -> bytes:
    """A packet from its planes, in one frame or a frame per plane, whichever is smaller."""
    options = []
    if len(planes) != 1:
        whole = b"".join(planes)
        if len(whole) <= frames.MAX_CONTENT:
            options.append([(len(planes), frames.compress(whole, effort))] if planes else [])
    if planes:
        options.append([(1, frames.compress(plane, effort)) for plane in planes])
    return min((_assemble(head, codings, option) for option in options), key=len)


def _pad(
    head: tuple[int, int, int], codings: bytes, planes: list[bytes], counts: Counts
) -> bytes:
    """A packet that R-5.6-7 allows: its planes stored raw, one made for the purpose if need be."""
    flags, slot_byte, alpha_mask = head
    if counts.n_splits and not alpha_mask & 1:
        kinds_and_gaps = Coding.of_byte(slot_byte)
        assert kinds_and_gaps is not None
        at = kinds_and_gaps.n_planes + counts.has_kinds
        planes = [*planes[:at], bytes(counts.n_splits), *planes[at:]]
        alpha_mask |= 1
    if counts.n_adds and codings[N_CORE:] == bytes(N_CORE):
        codings = codings[:N_CORE] + bytes([Coding(0, 1).byte()]) + codings[N_CORE + 1 :]
        planes = [*planes, bytes(counts.n_adds)]
    stored = [(1, frames.store(plane)) for plane in planes]
    return _assemble((flags, slot_byte, alpha_mask), codings, stored)


def _assemble(
    head: tuple[int, int, int], codings: bytes, parts: Sequence[tuple[int, bytes]]
) -> bytes:
    flags, slot_coding, alpha_mask = head
    out = layout.build(
        layout.PACKET_HEADER,
        flags=flags,
        slot_coding=slot_coding,
        alpha_mask=alpha_mask,
        n_frames=len(parts),
    )
    entries = b"".join(
        layout.build(layout.FRAME_ENTRY, n_planes=n, size=len(frame)) for n, frame in parts
    )
    return out + codings + entries + b"".join(frame for _, frame in parts)
