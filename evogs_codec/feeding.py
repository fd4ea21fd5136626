"""Progressive decoding: any byte ranges in any order (spec 6.4)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from evogs_codec import layout
from evogs_codec.cut import Cut
from evogs_codec.decode import Decoded
from evogs_codec.directory import HEADER_SIZE, Directory, check_crc, read_directory, read_header
from evogs_codec.errors import Fault, StreamError
from evogs_codec.floats import float_view
from evogs_codec.packet_header import PALETTE, PICKS
from evogs_codec.palette import PaletteState
from evogs_codec.splats import SplatParams
from evogs_codec.state import TileState

__all__ = ["Decoder", "StepReady"]


@dataclass(frozen=True)
class StepReady:
    """A packet was applied: a step of a component of a tile; `level` is its label.

    A packet of a palette is of component 2 of tile 0; `level` is that of its entries.
    """

    tile: int
    component: int
    step: int
    level: int


class Decoder:
    """Sans-I/O decoder: give it any byte ranges, take splats whenever you want (spec 6.4).

    Example:
        >>> decoder = Decoder()
        >>> for chunk in chunks:                # doctest: +SKIP
        ...     for ready in decoder.feed(chunk):
        ...         draw(decoder.leaves())
        >>> decoder.close()                     # doctest: +SKIP
    """

    def __init__(self, *, limits: Mapping[str, int] | None = None) -> None:
        self.directory: Directory | None = None
        self._limits = limits
        self._head = _Ranges()
        self._head_size = 0  # of header and chunks, once the header is there
        self._parts: dict[int, _Ranges] = {}
        self._whole: dict[int, bytes] = {}
        self._tiles: list[TileState] = []
        self._palette: PaletteState | None = None
        self._done = np.zeros(0, bool)
        self._faults: dict[int, StreamError] = {}
        self._at = 0
        self._trailing = False

    def feed(self, data: bytes | memoryview, at: int | None = None) -> list[StepReady]:
        """Take bytes of the file from offset `at` (by default, after those of the last call).

        Returns:
            The steps that became ready, in the order in which they were applied.

        Raises:
            StreamError: the first fault in file order, once all bytes before it were seen.
        """
        at = self._at if at is None else at
        if at < 0:
            raise ValueError(f"offset {at}")
        self._at = at + len(data)
        pieces: list[tuple[int, bytes | memoryview]] = [(at, data)]
        if self.directory is None:
            self._head.put(at, bytes(data))
            if not self._read_head():
                return []
            pieces = self._head.all()
            self._head = _Ranges()
        ready: list[StepReady] = []
        for begin, piece in pieces:
            ready += self._take(begin, memoryview(piece))
        self._raise_first_fault()
        return ready

    def close(self) -> None:
        """Say that no more bytes come.

        Raises:
            StreamError: the first fault, E_TRUNCATED if bytes are missing.
        """
        if self.directory is None:
            read_directory(memoryview(self._head.prefix()), self._limits)
            raise AssertionError("a complete directory was not read")
        missing = np.flatnonzero(~self._done)
        for packet in missing.tolist():
            if packet not in self._faults:
                offset = int(self.directory.offsets[packet])
                self._faults[packet] = StreamError(
                    Fault.E_TRUNCATED, "a packet is missing or cut short", offset
                )
        if self._faults:
            raise self._faults[min(self._faults)]
        if self._trailing:
            size = self.directory.size
            raise StreamError(Fault.E_TRAILING, "bytes follow the last packet", size)

    @property
    def cut(self) -> Cut:
        """Steps applied so far.

        Raises:
            ValueError: header and chunks have not come yet.
        """
        if self.directory is None:
            raise ValueError("header and chunks have not come yet")
        shape = (len(self._tiles), self.directory.n_components)
        steps = np.array([t.n_applied for t in self._tiles], np.int64).reshape(shape)
        return Cut(steps, self._palette.n_applied if self._palette else 0)

    @property
    def fault(self) -> StreamError | None:
        """The first fault in file order found so far, though packets before it may be missing."""
        return self._faults[min(self._faults)] if self._faults else None

    def dump(self) -> bytes:
        """The dump (spec 7.7) of what was applied so far.

        Raises:
            ValueError: header and chunks have not come yet.
        """
        if self.directory is None:
            raise ValueError("header and chunks have not come yet")
        return Decoded(self.directory, self.cut, tuple(self._tiles), memoryview(b"")).dump()

    def leaves(self) -> SplatParams:
        """Float view of what was applied so far; no splats before header and chunks came."""
        if self.directory is None:
            return SplatParams.from_channels(np.zeros((14, 0), np.float32))
        return float_view(self.directory, self._tiles, self.directory.sh_degree)

    def _read_head(self) -> bool:
        if not self._head.covers(self._head_size):
            return False
        prefix = memoryview(self._head.prefix(max(self._head_size, HEADER_SIZE)))
        if len(prefix) < HEADER_SIZE:
            if prefix[:8] != layout.SIGNATURE[: len(prefix[:8])]:
                read_header(prefix)
            return False
        self._head_size = HEADER_SIZE + read_header(prefix, self._limits)["chunks_size"]
        if not self._head.covers(self._head_size):
            return False
        directory = read_directory(memoryview(self._head.prefix(self._head_size)), self._limits)
        self.directory = directory
        rows = directory.packets
        # Slots are made as packets come: a table may promise any number.
        self._palette = PaletteState(directory, 0) if directory.has_palette else None
        n_tiles = len(directory.tiles)
        self._tiles = [TileState(directory, t, 0, self._palette) for t in range(n_tiles)]
        self._done = np.zeros(len(rows), bool)
        self._next: list[list[list[int]]] = [
            [[] for _ in range(directory.n_components)] for _ in self._tiles
        ]
        for packet, (tile, component) in enumerate(rows[["tile", "component"]].tolist()):
            if component < directory.n_components:  # else it is of the palette
                self._next[tile][component].append(packet)
        for packet in np.flatnonzero(rows["size"] == 0).tolist():
            self._whole[packet] = b""
        return True

    def _take(self, at: int, data: memoryview) -> list[StepReady]:
        """Put bytes into the packets they belong to and apply what became complete."""
        directory = self.directory
        assert directory is not None
        end = at + len(data)
        self._trailing |= len(data) > 0 and end > directory.size
        ends = directory.offsets + directory.packets["size"]
        first = int(np.searchsorted(ends, at, side="right"))
        last = int(np.searchsorted(directory.offsets, end, side="left"))
        touched = {int(directory.packets["tile"][p]) for p in self._whole if not self._done[p]}
        for packet in range(first, last):
            size = int(directory.packets["size"][packet])
            if self._done[packet] or packet in self._faults or packet in self._whole or size == 0:
                continue
            offset = int(directory.offsets[packet])
            begin, stop = max(at, offset), min(end, offset + size)
            part = bytes(data[begin - at : stop - at])
            if len(part) == size:
                self._whole[packet] = part
            else:
                ranges = self._parts.setdefault(packet, _Ranges())
                ranges.put(begin - offset, part)
                if ranges.covers(size):
                    self._whole[packet] = ranges.prefix(size)
                    del self._parts[packet]
            if packet in self._whole:
                touched.add(int(directory.packets["tile"][packet]))
        return [
            *self._advance_palette(),
            *(ready for tile in sorted(touched) for ready in self._advance(tile)),
        ]

    def _advance_palette(self) -> list[StepReady]:
        """Apply the packets of the palette that are complete, as far as none before is missing."""
        directory, palette, ready = self.directory, self._palette, []
        assert directory is not None
        while palette is not None and not palette.is_whole:
            step = palette.n_applied
            packet = int(directory.palette_packets[step])
            if packet not in self._whole or not self._try(packet, palette):
                break
            ready.append(StepReady(0, PALETTE, step, int(directory.labels[packet])))
        return ready

    def _advance(self, tile: int) -> list[StepReady]:
        """Apply the packets of a tile that are complete and whose chains have reached them."""
        directory = self.directory
        assert directory is not None
        state, ready = self._tiles[tile], []
        for component in range(directory.n_components):
            chain = self._next[tile][component]
            while state.n_applied[component] < len(chain):
                step = state.n_applied[component]
                packet = chain[step]
                blocked = component > 0 and state.n_applied[0] <= step
                if self._palette is not None and component == PICKS:
                    blocked |= self._palette.n_applied < directory.palette_required[packet]
                if blocked or packet not in self._whole or not self._try(packet, state):
                    break
                ready.append(StepReady(tile, component, step, state.level(step)))
        return ready

    def _try(self, packet: int, state: TileState | PaletteState) -> bool:
        """Apply a packet that is complete; False if it has a fault, which is kept."""
        assert self.directory is not None
        body, offset = self._whole.pop(packet), int(self.directory.offsets[packet])
        try:
            check_crc(int(self.directory.packets["crc"][packet]), offset, body)
            state.apply(packet, memoryview(body))
        except StreamError as fault:
            self._faults[packet] = fault
            return False
        self._done[packet] = True
        return True

    def _raise_first_fault(self) -> None:
        if self._faults:
            first = min(self._faults)
            if self._done[:first].all():
                raise self._faults[first]


class _Ranges:
    """Byte ranges that came of something that begins at 0; of what comes twice, the first."""

    def __init__(self) -> None:
        self._head = bytearray()  # from 0 without a gap
        self._later: dict[int, bytes] = {}  # by offset, none overlapping another
        self._offsets: list[int] = []  # of these, rising

    def put(self, at: int, data: bytes) -> None:
        """Add a range."""
        if at > len(self._head):
            self._put_later(at, data)
            return
        self._head += data[len(self._head) - at :]
        while self._offsets and (at := self._offsets[0]) <= len(self._head):
            self._head += self._later.pop(at)[len(self._head) - at :]
            del self._offsets[0]

    def covers(self, size: int) -> bool:
        """All bytes 0..size are there."""
        return len(self._head) >= size

    def prefix(self, size: int | None = None) -> bytes:
        """The bytes from 0 on without a gap, `size` of them at most."""
        with memoryview(self._head) as view:
            return bytes(view[:size])

    def all(self) -> list[tuple[int, bytes | memoryview]]:
        """Every range, with its offset."""
        return [(0, memoryview(self._head)), *self._later.items()]

    def _put_later(self, at: int, data: bytes) -> None:
        """Add the gaps that a range fills."""
        end = at + len(data)
        place = bisect_right(self._offsets, at)
        if place:
            before = self._offsets[place - 1]
            at = max(at, before + len(self._later[before]))
        while at < end:
            stop = min(end, self._offsets[place]) if place < len(self._offsets) else end
            if at < stop:
                self._later[at] = data[at - end :][: stop - at]
                self._offsets.insert(place, at)
                place += 1
            if stop == end:
                break
            at = stop + len(self._later[stop])
            place += 1
