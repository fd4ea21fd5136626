"""Packet headers: which lists a packet holds, of how many integers, in which planes (spec 5.9).

Letters: C channels of the component, R records that name a slot, P of them with psi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import layout
from evogs_codec.format.planes import ABSENT, CODINGS, Coding
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.components import component_channels, sh_channels

__all__ = [
    "FLAG_PALETTE",
    "Counts",
    "PacketHeader",
    "read_list_header",
    "read_packet_header",
    "value_counts",
]

FLAG_PALETTE = 1 << 8  # of the file header
N_SIDES = 2 + N_GROUPS  # lists of core before psi: slots, kinds, alpha
FLAG_PSI_YCOCG, FLAG_ADDS_YCOCG = 1, 2
FLAG_OF_CHANGED = 4  # of a packet of picks: refined and split slots have new ones too
MAX_RECORDS_PER_BYTE = 16  # R-5.6-7


@dataclass(frozen=True)
class Counts:
    """The record counts of a packet entry."""

    n_adds: int
    n_splits: int
    n_refines: int
    n_drops: int

    @property
    def n_records(self) -> int:
        """R."""
        return self.n_splits + self.n_refines + self.n_drops

    @property
    def n_psi(self) -> int:
        """P."""
        return self.n_splits + self.n_refines

    @property
    def only_refines(self) -> bool:
        """No record splits or drops, so that psi may be sibling differences."""
        return self.n_splits == 0 and self.n_drops == 0

    @property
    def has_kinds(self) -> bool:
        """More than one kind occurs, so kinds are stored."""
        return (self.n_splits > 0) + (self.n_refines > 0) + (self.n_drops > 0) > 1


@dataclass(frozen=True)
class PacketHeader:
    """A packet header with what follows from it.

    Attributes:
        flags: of the packet header.
        codings: of slots, kinds, alpha of each group (core only), psi and adds of each channel; of
            picks; or of each channel of entries.
        lengths: values of each.
        frames: (planes, bytes) of each frame.
        size: bytes before the first frame.
        first: index of the coding of the first channel, of psi where there is psi.
        n_channels: C; with picks 0.
        first_sh: the first channel of an SH triple.
    """

    flags: int
    coding_bytes: bytes
    codings: tuple[Coding, ...]
    lengths: tuple[int, ...]
    frames: tuple[tuple[int, int], ...]
    size: int
    first: int
    n_channels: int
    first_sh: int

    @property
    def plane_sizes(self) -> list[int]:
        """Bytes of each plane, in order."""
        pairs = zip(self.codings, self.lengths, strict=True)
        return [size for c, n in pairs if c is not ABSENT for size in c.plane_sizes(n)]

    @cached_property
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


def read_packet_header(
    body: memoryview, component: int, counts: Counts, offset: int
) -> PacketHeader:
    """The header of a packet of core or a band, checked (spec 5.9); of size 0, it codes no values.

    Raises:
        StreamError: E_PACKET or E_RESERVED at `offset`.
    """
    lengths, n_channels = value_counts(component, counts), component_channels(component)
    first, first_sh = len(lengths) - 2 * n_channels, sh_channels(component).start
    if len(body) == 0:
        n = len(lengths)
        return PacketHeader(0, bytes(n), (ABSENT,) * n, lengths, (), 0, first, n_channels, first_sh)
    first_delta = first if counts.only_refines else first + n_channels
    places = first, n_channels, first_delta
    return read_list_header(body, lengths, places, offset, first_sh=first_sh)


def read_list_header(
    body: memoryview,
    lengths: tuple[int, ...],
    places: tuple[int, int, int],
    offset: int,
    flags_known: int = FLAG_PSI_YCOCG | FLAG_ADDS_YCOCG,
    first_sh: int = 0,
) -> PacketHeader:
    """The header of a packet with lists of these lengths.

    Args:
        body: of the packet.
        lengths: values of each list.
        places: the list of the first channel, channels, and the first list that may have `delta`.
        offset: of the packet in the file.
        flags_known: bits of the flags that may be set.
        first_sh: the first channel of an SH triple.

    Raises:
        StreamError: as `read_packet_header`.
    """

    def refuse(detail: str) -> StreamError:
        return StreamError(Fault.E_PACKET, detail, offset)

    first, n_channels, first_delta = places
    fixed = layout.size_of(layout.PACKET_HEADER)
    at = fixed + len(lengths)
    if len(body) < at:  # R-5.9-1
        raise refuse("the packet is shorter than its header")
    flags, n_frames = body[0], body[1]
    coding_bytes = bytes(body[fixed:at])
    if flags & ~flags_known or any(byte >> 7 for byte in coding_bytes):  # R-4.4-1
        raise StreamError(Fault.E_RESERVED, "a reserved bit of the packet header is set", offset)
    found = [CODINGS[byte] for byte in coding_bytes]
    codings = tuple(coding for coding in found if coding is not None)
    if len(codings) != len(found):  # R-5.9-2
        raise refuse("a coding byte is not valid")
    if any(coding.delta for coding in codings[:first_delta]):  # R-5.9-3
        raise refuse("delta is set for other values than adds, entries and psi of refines alone")
    if any(c and n == 0 for c, n in zip(coding_bytes, lengths, strict=True)):  # R-5.9-4
        raise refuse("values are coded that do not occur")
    entry = layout.size_of(layout.FRAME_ENTRY)
    if len(body) < at + n_frames * entry:  # R-5.9-1
        raise refuse("the packet is shorter than its frame entries")
    frames_ = layout.read_table(layout.FRAME_ENTRY, body[at : at + n_frames * entry])
    return PacketHeader(
        flags=flags,
        coding_bytes=coding_bytes,
        codings=codings,
        lengths=lengths,
        frames=tuple(zip(frames_["n_planes"].tolist(), frames_["size"].tolist(), strict=True)),
        size=at + n_frames * entry,
        first=first,
        n_channels=n_channels,
        first_sh=first_sh,
    )
