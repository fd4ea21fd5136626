"""Packets: the records of one step of one tile and component (spec 5.9, 7.1, 7.2).

Letters: C channels of the component, R records that name a slot, P of them with psi, S splits,
A adds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import frames
from evogs_codec.format.packet_header import (
    FLAG_ADDS_YCOCG,
    FLAG_PSI_YCOCG,
    N_SIDES,
    Counts,
    PacketHeader,
    read_packet_header,
)
from evogs_codec.format.planes import (
    ABSENT,
    CODINGS,
    PART,
    Coding,
    integers,
    inverse_ycocg,
    join_planes,
    planes_at,
    stray_bits,
    undelta,
)
from evogs_codec.model.arithmetic import Quantiser
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import I32, I64, U8
from evogs_codec.model.tree import Kind

__all__ = ["Deltas", "Packet", "Values", "check_bits", "read_planes", "unpack"]

Stored: TypeAlias = npt.NDArray[np.integer]  # uint8, uint16 or int32, as `join_planes` gives them


@dataclass(frozen=True, eq=False)
class Packet:
    """An unpacked packet; for an SH band slots, kinds and alpha are empty.

    Attributes:
        slots: (R,) int64, increasing.
        kinds: (R,) uint8.
        alpha: (S,) uint8 indices per group, None where all are 0.
        psi, adds: the channels.
    """

    slots: I64
    kinds: Stored
    alpha: tuple[Stored | None, ...]
    psi: Values
    adds: Values


def unpack(body: memoryview, component: int, counts: Counts, offset: int) -> Packet:
    """The records of a packet whose CRC-32 is right; `offset` is its place in the file.

    Raises:
        StreamError: with the faults of spec 5.9, 5.10 and 7.2 that need no slots.
    """
    head = read_packet_header(body, component, counts, offset)
    data = read_planes(body, head, offset)
    check_bits(data, head, offset)
    starts = head.starts
    slots: I64 = np.empty(0, np.int64)
    kinds: Stored = np.empty(0, np.uint8)
    alpha: tuple[Stored | None, ...] = (None,) * N_GROUPS
    if component == 0:
        sides = [
            None if coding is ABSENT else join_planes(planes_at(data, at, coding, n), coding, n)
            for coding, n, at in zip(head.codings[:N_SIDES], head.lengths, starts, strict=False)
        ]
        gaps = np.zeros(counts.n_records, np.uint8) if sides[0] is None else sides[0]
        slots = np.cumsum(gaps, dtype=np.int64) + np.arange(counts.n_records)
        kinds = _kinds(sides[1], counts)
        alpha = tuple(sides[2:])
    psi, adds = (
        Values(
            n,
            np.frombuffer(head.coding_bytes, np.uint8, head.n_channels, at),
            data,
            np.array(starts[at : at + head.n_channels], np.int64),
            bool(head.flags & flag),
            head.first_sh,
            offset,
            is_psi=flag == FLAG_PSI_YCOCG,
        )
        for n, at, flag in (
            (counts.n_psi, head.first, FLAG_PSI_YCOCG),
            (counts.n_adds, head.first + head.n_channels, FLAG_ADDS_YCOCG),
        )
    )
    return Packet(slots, kinds, alpha, psi, adds)


def read_planes(body: memoryview, head: PacketHeader, offset: int) -> U8:
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
    places, at, plane = np.empty((len(head.frames), 3), np.int64), head.size, 0
    for k, (n_planes, size) in enumerate(head.frames):
        places[k] = at, size, sum(sizes[plane : plane + n_planes])
        at, plane = at + size, plane + n_planes
    return frames.decompress_all(body, places, offset)


def check_bits(data: U8, head: PacketHeader, offset: int) -> None:
    """Raise E_PACKET if a low plane has a bit that belongs to no value (R-5.9-9)."""
    for coding, n, start in zip(head.codings, head.lengths, head.starts, strict=True):
        if coding.low and stray_bits(planes_at(data, start, coding, n), coding, n):
            raise StreamError(Fault.E_PACKET, "a low plane has a bit above its bits", offset)


def _kinds(values: Stored | None, counts: Counts) -> Stored:
    if counts.has_kinds:
        return np.zeros(counts.n_records, np.uint8) if values is None else values
    kind = Kind.SPLIT if counts.n_splits else Kind.DROP if counts.n_drops else Kind.REFINE
    return np.full(counts.n_records, kind, np.uint8)


def check_kinds(kinds: Stored, counts: Counts, offset: int) -> None:
    """Raise E_KIND unless the stored kinds are those counted (R-7.2-2)."""
    if counts.has_kinds:
        counted = [counts.n_refines, counts.n_splits, counts.n_drops]
        if int(kinds.max()) > Kind.DROP or np.bincount(kinds, minlength=3).tolist() != counted:
            raise StreamError(Fault.E_KIND, "the kinds contradict the counts", offset)


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
        is_psi: of psi `delta` means sibling differences, which are integers of their own here.
    """

    n: int
    codes: U8
    data: U8
    starts: I64
    is_ycocg: bool
    first_sh: int
    offset: int
    is_psi: bool = False

    @property
    def of_siblings(self) -> npt.NDArray[np.bool_]:
        """(C,) channels that hold sibling differences."""
        return (self.codes & 64 > 0) & self.is_psi

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
        return self.block(self._turned_with(channel))

    def block(self, channels: slice) -> I32:
        """(c, n) integers of some channels, of triples that are turned the whole ones."""
        codes, starts = self.codes[channels], self.starts[channels]
        out = np.zeros((len(codes), self.n), np.int32)
        for code in set(codes.tolist()):  # channels that are stored alike go together
            coding = CODINGS[code]
            assert coding is not None, "read_packet_header lets no other byte through"
            if coding is ABSENT:
                continue
            alike = np.flatnonzero(codes == code)
            integers(self.data, starts[alike].tolist(), coding, out, alike.tolist())
            for row in alike.tolist() if coding.delta and not self.is_psi else ():
                undelta(out[row], self.offset, out[row])
        turned = out[max(self.first_sh - channels.start, 0) :]
        if self.is_ycocg and len(turned):
            for at in range(0, self.n, PART):
                turned[:, at : at + PART] = inverse_ycocg(turned[:, at : at + PART])
        return out

    def all(self) -> I32:
        """(C, n) integers of all channels."""
        return self.block(slice(0, len(self.codes)))

    def _turned_with(self, channel: int) -> slice:
        """The triple that YCoCg-R turns together, or the channel alone."""
        if not self.is_ycocg or channel < self.first_sh:
            return slice(channel, channel + 1)
        first = channel - (channel - self.first_sh) % 3
        return slice(first, first + 3)

    def _coding(self, channel: int) -> Coding:
        coding = CODINGS[int(self.codes[channel])]
        assert coding is not None, "read_packet_header lets no other byte through"
        return coding


class Deltas:
    """Delta of the channels of psi or adds, asked for in order; a triple is turned back once."""

    def __init__(self, values: Values, siblings: Siblings | None = None) -> None:
        """Of values; `siblings` of the step where a channel holds their differences."""
        self.values, self.siblings = values, siblings
        self._rows: dict[int, I32] = {}

    def delta(self, channel: int, quantiser: Quantiser) -> I32 | None:
        """Delta of a channel; None if all are 0.

        Raises:
            RangeError: a number leaves its range (R-7.1-2, R-7.3-1).
        """
        values = self.values
        if values.n == 0 or values.is_zero(channel):
            return None
        if channel not in self._rows:
            rows = values.rows(channel)
            self._rows = {channel + k: row for k, row in enumerate(rows)}
        q = self._rows[channel]
        if self.siblings is not None and values.of_siblings[channel]:
            return quantiser.delta(self.siblings.sums(q[None])[0])
        return quantiser.delta(q, values.bound(channel))
