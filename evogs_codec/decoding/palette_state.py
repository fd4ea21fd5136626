"""The palette of a stream: SH above band 0 that tiles share, and the picks among them (spec 12).

Letters: C channels above core, E entries, n picks.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from threading import Lock
from types import ModuleType

import numpy as np
import numpy.typing as npt

from evogs_codec.common.buffers import LINE, empty
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format.directory import Directory
from evogs_codec.format.packet_header import (
    FLAG_ADDS_YCOCG,
    FLAG_OF_CHANGED,
    FLAG_PSI_YCOCG,
    Counts,
    PacketHeader,
    read_list_header,
)
from evogs_codec.format.planes import join_planes, planes_at
from evogs_codec.format.unpack import Stored, Values, check_bits, read_planes
from evogs_codec.model.arithmetic import Quantiser, RangeError
from evogs_codec.model.channels import N_CORE, channel_class, n_channels
from evogs_codec.model.components import component_slice
from evogs_codec.model.splats import I32, U8

__all__ = [
    "PaletteState",
    "read_entries_header",
    "read_picks",
    "read_picks_header",
    "unpack_entries",
    "unpack_picks",
]

ROWS = 1024  # that are turned at a time
BLOCK = 1 << 16  # numbers: larger arrays come from the system anew each time, page by page


class PaletteState:
    """Entries after some packets of the palette: all that picks applied so far may name.

    Attributes:
        x: (C, 1 + capacity) int32 on the grid of SH; column 0 is what the pick 0 shows.
        n_entries: entries so far.
        n_applied: packets applied.
    """

    def __init__(
        self, directory: Directory, capacity: int, kernels: ModuleType | None = None
    ) -> None:
        """An empty palette with room for `capacity` entries; compiled loops for many of them."""
        self.directory = directory
        self._kernels = kernels
        n = n_channels(directory.sh_degree) - N_CORE
        self.x = empty((n, 1 + capacity), np.int32)
        self.x[:, 0] = 0
        self.n_entries = 0
        self.n_applied = 0
        self._rows: npt.NDArray[np.signedinteger] | None = None
        self._lock = Lock()

    @property
    def is_whole(self) -> bool:
        """No packet of the stream is missing."""
        return self.n_applied == len(self.directory.palette_packets)

    def apply(self, packet: int, body: memoryview) -> None:
        """Append the entries of the next packet, whose CRC-32 is right.

        Raises:
            StreamError: the packet breaks a rule; the palette is as before.
        """
        offset = int(self.directory.offsets[packet])
        n = int(self.directory.packets["n_adds"][packet])
        self._reserve(n)
        new = self.x[:, 1 + self.n_entries : 1 + self.n_entries + n]
        if len(body):
            values = unpack_entries(body, n, len(self.x), offset)
            if self._kernels is None or not self._fill(new, values, self._kernels):
                self._fill_by_blocks(new, values, offset)
        self.n_entries += n
        self.n_applied += 1
        self._rows = None

    def _fill(self, new: I32, values: Values, kernels: ModuleType) -> bool:
        """Write the numbers of new entries, compiled; False if one leaves its range."""
        deltas = np.empty(new.shape, np.int32)
        units = np.array([self._quantiser(k).step for k in range(len(new))], np.int64)
        is_good: bool = kernels.entries(
            values.codes, values.starts, values.data, values.is_ycocg, units, deltas
        )
        new[:] = deltas
        return is_good

    def _fill_by_blocks(self, new: I32, values: Values, offset: int) -> None:
        """The same, which says what is wrong."""
        try:
            for part in _blocks(self.directory.sh_degree, new.shape[1]):
                new[part] = self._quantiser(part.start).delta(values.block(part))
        except RangeError as error:
            raise StreamError(Fault.E_RANGE, str(error), offset) from None

    def _quantiser(self, channel: int) -> Quantiser:
        """Of one of the C channels."""
        return self.directory.quantisers[0][channel_class(N_CORE + channel)]

    def _reserve(self, n: int) -> None:
        """Make room for n more entries, with more to spare: growing costs a copy."""
        capacity = self.x.shape[1]
        if 1 + self.n_entries + n > capacity:
            spare = max(1 + self.n_entries + n - capacity, capacity)
            self.x = np.concatenate([self.x, np.empty((len(self.x), spare), np.int32)], 1)

    def channels(self, picks: I32) -> I32:
        """(C, n) integers of picks."""
        return self.x.take(picks, axis=1)

    def rows(self) -> npt.NDArray[np.signedinteger]:
        """(1 + E, at least C) the numbers that each pick shows, one after the other.

        int16 where they fit, in whole cache lines: splats pick anywhere.
        """
        with self._lock:  # whichever tile is first makes them
            if self._rows is None:
                x = self.x[:, : 1 + self.n_entries]
                is_small = x.size and max(-int(x.min()), int(x.max())) < 1 << 15
                dtype = np.dtype(np.int16 if is_small else np.int32)
                line = LINE // dtype.itemsize
                rows = empty((x.shape[1], -(-len(x) // line) * line), dtype)
                for at in range(0, len(rows), ROWS):
                    rows[at : at + ROWS, : len(x)] = x[:, at : at + ROWS].T
                self._rows = rows
            return self._rows

    def digest(self) -> bytes:
        """SHA-256 of the state (spec 7.7)."""
        digest = hashlib.sha256(self.n_entries.to_bytes(4, "little"))
        for row in self.x[:, 1 : 1 + self.n_entries]:
            digest.update(np.ascontiguousarray(row, "<i4").data)
        return digest.digest()


def _blocks(sh_degree: int, n: int) -> Iterator[slice]:
    """The C channels in blocks of triples of one band, of about `BLOCK` numbers of n entries."""
    width = 3 * max(1, BLOCK // (3 * n))
    for band in range(1, sh_degree + 1):
        channels = component_slice(band)
        for first in range(channels.start, channels.stop, width):
            yield slice(first - N_CORE, min(first + width, channels.stop) - N_CORE)


def read_entries_header(body: memoryview, n: int, n_channels: int, offset: int) -> PacketHeader:
    """The header of a packet of n entries, of size above 0; faults as `read_packet_header`."""
    return read_list_header(body, (n,) * n_channels, (0, n_channels, 0), offset)


def read_picks_header(body: memoryview, counts: Counts, offset: int) -> PacketHeader:
    """The header of a packet of picks, of size above 0; `counts` of core; faults as above."""
    n = counts.n_splits + counts.n_adds
    n += counts.n_psi if body[0] & FLAG_OF_CHANGED else 0
    known = FLAG_PSI_YCOCG | FLAG_ADDS_YCOCG | FLAG_OF_CHANGED
    return read_list_header(body, (n,), (0, 0, 1), offset, known)


def unpack_entries(body: memoryview, n: int, n_channels: int, offset: int) -> Values:
    """The q of n entries in a packet of size above 0, whose CRC-32 is right (spec 5.9).

    Raises:
        StreamError: with the faults of spec 5.9 and 5.10.
    """
    head = read_entries_header(body, n, n_channels, offset)
    data = read_planes(body, head, offset)
    check_bits(data, head, offset)
    return Values(
        n,
        np.frombuffer(head.coding_bytes, np.uint8),
        data,
        np.array(head.starts, np.int64),
        bool(head.flags & FLAG_ADDS_YCOCG),
        0,
        offset,
    )


def unpack_picks(
    body: memoryview, counts: Counts, n_entries: int, offset: int
) -> tuple[Stored | None, Stored | None]:
    """The picks of a packet among so many entries: of slots refined or split, and of new slots.

    The first are None if those slots keep theirs, the second if C2s take those of their parents.

    Raises:
        StreamError: as `unpack_entries`, and E_INDEX.
    """
    if len(body) == 0:
        return None, None
    head, data = read_picks(body, counts, offset)
    coding, n = head.codings[0], head.lengths[0]
    picks = join_planes(planes_at(data, 0, coding, n), coding, n)
    if n and int(picks.max()) > n_entries:  # R-7.2-4
        raise StreamError(Fault.E_INDEX, "a pick is past the palette", offset)
    if head.flags & FLAG_OF_CHANGED:
        return picks[: counts.n_psi], picks[counts.n_psi :]
    return None, picks


def read_picks(body: memoryview, counts: Counts, offset: int) -> tuple[PacketHeader, U8]:
    """The header and the planes of a packet of picks, of size above 0; faults as above."""
    head = read_picks_header(body, counts, offset)
    data = read_planes(body, head, offset)
    check_bits(data, head, offset)
    return head, data
