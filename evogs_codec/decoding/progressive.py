"""Progressive decoding: any byte ranges in any order (spec 6.4)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from evogs_codec.decoding.arrived import ArrivedRanges
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import Decoded
from evogs_codec.decoding.palette_state import PaletteState
from evogs_codec.decoding.tile_state import TileState
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format import layout
from evogs_codec.format.directory import (
    HEADER_SIZE,
    Directory,
    check_crc,
    read_header,
    read_tables,
)
from evogs_codec.model.channels import n_channels
from evogs_codec.model.components import CORE, PALETTE
from evogs_codec.model.splats import SplatParams

__all__ = ["Decoder", "StepReady"]


@dataclass(frozen=True)
class StepReady:
    """A packet was applied: a step of a component of a tile; `level` is its label.

    A packet of the palette is of component 5 of tile 0; `level` is that of its entries.
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
        self._head = ArrivedRanges()
        self._header: layout.Fields | None = None
        self._head_size = HEADER_SIZE  # and the chunks, once the header is there
        self._parts: dict[int, ArrivedRanges] = {}
        self._whole: dict[int, bytes] = {}
        self._tiles: list[TileState] = []
        self._palette: PaletteState | None = None
        self._done = np.zeros(0, bool)
        self._n_done = 0  # packets in file order before the first that is not done, as last seen
        self._faults: dict[int, StreamError] = {}
        self._first_fault = -1  # the packet, or -1
        self._begins: list[int] = []  # of packets, in the file; lists are searched faster
        self._ends: list[int] = []
        self._chains: list[dict[int, list[int]]] = []  # packets by tile and component
        self._touched: set[int] = set()  # tiles that may advance
        self._waiting: dict[int, set[int]] = {}  # tiles by the packets of the palette they require
        self._at = 0
        self._trailing = False

    def __repr__(self) -> str:
        if self.directory is None:
            return "Decoder(header and chunks have not come yet)"
        n = int(np.count_nonzero(self._done))
        return f"Decoder({n} of {len(self._done)} packets applied)"

    def feed(self, data: bytes | bytearray | memoryview, at: int | None = None) -> list[StepReady]:
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
        pieces: list[tuple[int, bytes | bytearray | memoryview]] = [(at, data)]
        if self.directory is None:
            self._head.put(at, bytes(data))
            if not self._read_head():
                return []
            pieces = [*self._head.all()]
            self._head = ArrivedRanges()
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
            head = memoryview(self._head.prefix())
            read_tables(self._header or read_header(head, self._limits), head, self._limits)
            raise AssertionError("a complete directory was not read")
        for packet in np.flatnonzero(~self._done)[:1].tolist():
            offset = int(self.directory.offsets[packet])
            detail = "a packet is missing or cut short"
            raise self._faults.get(packet, StreamError(Fault.E_TRUNCATED, detail, offset))
        if self.verdict is not None:
            raise self.verdict

    @property
    def is_complete(self) -> bool:
        """Whether every packet of the file was applied."""
        return self.directory is not None and bool(self._done.all())

    @property
    def cut(self) -> Cut:
        """Steps applied so far.

        Raises:
            ValueError: header and chunks have not come yet.
        """
        if self.directory is None:
            raise ValueError("header and chunks have not come yet")
        shape = (len(self._tiles), len(self.directory.components.of_tiles))
        steps = np.array([[*t.n_applied.values()] for t in self._tiles], np.int64).reshape(shape)
        return Cut(steps, self._palette.n_applied if self._palette else 0)

    @property
    def verdict(self) -> StreamError | None:
        """What is wrong if no more bytes come, apart from packets that are missing.

        The first fault in file order of the packets that came, though packets before it may be
        missing; else bytes that follow the last packet; else None.
        """
        fault = self._faults.get(self._first_fault)
        if fault is None and self._trailing and self.directory is not None:
            detail = "bytes follow the last packet"
            return StreamError(Fault.E_TRAILING, detail, self.directory.size)
        return fault

    @property
    def decoded(self) -> Decoded:
        """What was applied so far, as `decode` gives it; it changes with the next `feed`.

        Raises:
            ValueError: header and chunks have not come yet.
        """
        cut = self.cut
        assert self.directory is not None
        return Decoded(self.directory, cut, tuple(self._tiles))

    def dump(self) -> bytes:
        """The dump (spec 7.7) of what was applied so far.

        Raises:
            ValueError: header and chunks have not come yet.
        """
        return self.decoded.dump()

    def leaves(self, *, sh_degree: int | None = None) -> SplatParams:
        """Float view of what was applied so far, as `Decoded.leaves` gives it.

        Args:
            sh_degree: degree of the result; by default the highest band applied so far.

        Returns:
            No splats before header and chunks have come.
        """
        if self.directory is None:
            channels = np.zeros((n_channels(sh_degree or 0), 0), np.float32)
            return SplatParams.from_channels(channels)
        return self.decoded.leaves(sh_degree=sh_degree)

    def _read_head(self) -> bool:
        """Read header and chunks as soon as they are there; False before."""
        if not self._head.covers(1):
            return False
        if self._header is None:
            prefix = memoryview(self._head.prefix(HEADER_SIZE))
            if len(prefix) < HEADER_SIZE:
                if prefix[:8] != layout.SIGNATURE[: len(prefix[:8])]:
                    read_header(prefix)
                return False
            self._header = read_header(prefix, self._limits)
            self._head_size = HEADER_SIZE + self._header["chunks_size"]
        if not self._head.covers(self._head_size):
            return False
        head = memoryview(self._head.prefix(self._head_size))
        directory = read_tables(self._header, head, self._limits)
        self.directory = directory
        rows = directory.packets
        # Slots are made as packets come: a table may promise any number.
        self._palette = PaletteState(directory, 0) if directory.has_palette else None
        n_tiles = len(directory.tiles)
        self._tiles = [TileState(directory, t, 0, self._palette) for t in range(n_tiles)]
        self._done = np.zeros(len(rows), bool)
        self._begins = directory.offsets.tolist()
        self._ends = (directory.offsets + rows["size"]).tolist()
        of_tiles = directory.components.of_tiles
        self._chains = [{component: [] for component in of_tiles} for _ in self._tiles]
        for packet, (tile, component) in enumerate(rows[["tile", "component"]].tolist()):
            if component != PALETTE:
                self._chains[tile][component].append(packet)
        empty = np.flatnonzero(rows["size"] == 0)
        self._whole = dict.fromkeys(empty.tolist(), b"")
        self._touched = set(rows["tile"][empty].tolist())
        return True

    def _take(self, at: int, data: memoryview) -> list[StepReady]:
        """Put bytes into the packets they belong to and apply what became complete."""
        directory = self.directory
        assert directory is not None
        end = at + len(data)
        self._trailing |= len(data) > 0 and end > directory.size
        first, last = bisect_right(self._ends, at), bisect_left(self._begins, end)
        for packet in range(first, last):
            offset, stop = self._begins[packet], self._ends[packet]
            size = stop - offset
            if self._done[packet] or packet in self._faults or packet in self._whole or size == 0:
                continue
            begin, stop = max(at, offset), min(end, stop)
            part = bytes(data[begin - at : stop - at])
            if len(part) == size:
                self._whole[packet] = part
            else:
                ranges = self._parts.get(packet) or self._parts.setdefault(packet, ArrivedRanges())
                ranges.put(begin - offset, part)
                if ranges.covers(size):
                    self._whole[packet] = ranges.prefix(size)
                    del self._parts[packet]
            if packet in self._whole:
                self._touched.add(int(directory.packets["tile"][packet]))
        if not self._touched:  # nothing became complete
            return []
        ready = self._advance_palette()
        touched, self._touched = sorted(self._touched), set()
        for tile in touched:
            ready += self._advance(tile)
        return ready

    def _advance_palette(self) -> list[StepReady]:
        """Apply the packets of the palette that are complete, as far as none before is missing."""
        directory, palette = self.directory, self._palette
        ready: list[StepReady] = []
        assert directory is not None
        while palette is not None and not palette.is_whole:
            step = palette.n_applied
            packet = int(directory.palette_packets[step])
            if packet not in self._whole or not self._try(packet, palette):
                break
            ready.append(StepReady(0, PALETTE, step, int(directory.labels[packet])))
            self._touched |= self._waiting.pop(palette.n_applied, set())
        return ready

    def _advance(self, tile: int) -> list[StepReady]:
        """Apply the packets of a tile that are complete and whose chains have reached them."""
        directory = self.directory
        assert directory is not None
        state, ready = self._tiles[tile], []
        state.reserve(self._slots_after(tile))
        for component, chain in self._chains[tile].items():
            while state.n_applied[component] < len(chain):
                step = state.n_applied[component]
                packet = chain[step]
                if component != CORE and state.n_applied[CORE] <= step:
                    break
                required = int(directory.palette_required[packet])
                if self._palette is not None and self._palette.n_applied < required:
                    self._waiting.setdefault(required, set()).add(tile)
                    break
                if packet not in self._whole or not self._try(packet, state):
                    break
                ready.append(StepReady(tile, component, step, int(directory.labels[packet])))
        return ready

    def _slots_after(self, tile: int) -> int:
        """Slots of a tile after the packets of core that are complete, if none has a fault."""
        assert self.directory is not None
        state, chain = self._tiles[tile], self._chains[tile][CORE]
        step, n_slots = state.n_applied[CORE], state.n_slots
        while step < len(chain) and chain[step] in self._whole:
            counts = self.directory.counts(chain[step])
            n_slots += counts.n_adds + counts.n_splits
            step += 1
        return n_slots

    def _try(self, packet: int, state: TileState | PaletteState) -> bool:
        """Apply a packet that is complete; False if it has a fault, which is kept."""
        assert self.directory is not None
        body, offset = self._whole.pop(packet), int(self.directory.offsets[packet])
        try:
            check_crc(int(self.directory.packets["crc"][packet]), offset, body)
            state.apply(packet, memoryview(body))
        except StreamError as fault:
            self._faults[packet] = fault
            if self._first_fault < 0 or packet < self._first_fault:
                self._first_fault = packet
            return False
        self._done[packet] = True
        return True

    def _raise_first_fault(self) -> None:
        while self._n_done < self._first_fault and self._done[self._n_done]:
            self._n_done += 1
        if self._n_done == self._first_fault:
            raise self._faults[self._first_fault]
