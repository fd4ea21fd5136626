"""Applying the packets of a cut, tiles in parallel (spec 6.1 steps 4 to 6)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import count
from operator import call
from threading import Event
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.common.buffers import Scratch
from evogs_codec.common.frozen_bytes import frozen
from evogs_codec.common.parallel import parallel_map
from evogs_codec.decoding.compiled.dispatch import apply_compiled, kernels_for
from evogs_codec.decoding.palette_state import PaletteState
from evogs_codec.decoding.tile_state import TileState
from evogs_codec.errors import Fault, StreamError
from evogs_codec.format.directory import Directory, check_crc
from evogs_codec.model.components import PALETTE, PICKS
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.splats import I64

__all__ = ["packet_body", "replay_tiles"]


def replay_tiles(
    directory: Directory,
    data: memoryview,
    selected: npt.NDArray[np.bool_],
    use: Callable[[TileState], None] | None = None,
    *,
    verify: bool = False,
    progress: Callable[[float], None] | None = None,
) -> list[TileState]:
    """The tiles after the packets of a cut; or none, if `use` takes each when it is done.

    Args:
        directory: of the stream.
        data: its bytes.
        selected: (n_packets,) True for the packets of the cut.
        use: takes each tile when it is done.
        verify: check the digests of states that the cut passes (R-5.7-3).
        progress: called with the part of the packets that is done.

    Raises:
        StreamError: the first fault in file order; else trailing bytes; else a digest (spec 6.1).
    """
    n_packets = int(selected.sum())
    of_palette = directory.palette_packets[selected[directory.palette_packets]]
    packets = np.flatnonzero(selected & (directory.columns >= 0))
    tile_of = directory.packets["tile"][packets]
    order = np.argsort(tile_of, kind="stable")
    ends = np.searchsorted(tile_of[order], np.arange(1, len(directory.tiles)))
    of_tile = np.split(packets[order], ends)[: len(directory.tiles)]  # one part for no tiles
    n_slots = _slots_there(directory, packets, len(data))
    sizes = directory.packets["size"][selected]
    kernels = kernels_for(n_slots, min(int(sizes.sum(dtype=np.int64)), len(data)))
    has_more = len(data) > directory.size
    digests = directory.digests if verify and not has_more else {}
    n_done = count(1)
    free: list[Scratch] = []  # of tiles that are done

    def tick() -> None:
        if progress is not None:
            progress(next(n_done) / n_packets)

    palette = None
    if directory.has_palette:
        palette = _PaletteJob(directory, data, of_palette, kernels, digests, tick)

    def run(tile: int) -> _Outcome:
        scratch = free.pop() if free else Scratch()
        job = _Job(directory, data, tile, of_tile[tile], palette, digests, tick, scratch)
        outcome = job.run(kernels, keeps=use is None)
        if use is not None and outcome.fault is None and (palette is None or palette.is_good()):
            use(outcome.state)
            outcome.state = None
        scratch.rewind()
        free.append(scratch)
        return outcome

    # The palette begins before the tiles, which wait for it where they need it.
    jobs: list[Callable[[], _Outcome]] = [palette.run] if palette and len(of_palette) else []
    jobs += [partial(run, tile) for tile in range(len(of_tile))]
    outcomes = list(parallel_map(call, jobs, n_splats=n_slots))
    faults = [(outcome.packet, outcome.fault) for outcome in outcomes if outcome.fault is not None]
    if faults:
        raise min(faults, key=lambda item: item[0])[1]
    if has_more:  # R-6.2-1
        n_more = len(data) - directory.size
        raise StreamError(Fault.E_TRAILING, f"{n_more} bytes follow", directory.size)
    wrong = [key for outcome in outcomes for key in outcome.wrong]
    if wrong:
        detail = f"state of (tile, component, step) {min(wrong)}"
        raise StreamError(Fault.E_DIGEST, detail, directory.digests_offset)
    return [outcome.state for outcome in outcomes if outcome.state is not None]


@dataclass
class _Outcome:
    """A tile after its packets, or the packet at fault and its fault; digests that are wrong."""

    state: Any  # TileState, or None once it was used
    packet: int = -1
    fault: StreamError | None = None
    wrong: tuple[PacketId, ...] = ()


@dataclass(frozen=True)
class _Job:
    """The packets of a cut that belong to one tile, in file order."""

    directory: Directory
    data: memoryview
    tile: int
    packets: I64
    palette: _PaletteJob | None
    digests: Mapping[PacketId, bytes]
    tick: Callable[[], None]
    scratch: Scratch

    def run(self, kernels: ModuleType | None, *, keeps: bool) -> _Outcome:
        """Apply them, compiled where nothing stands against it; `keeps` the state, or lends it."""
        capacity = _slots_there(self.directory, self.packets, len(self.data))
        memory = None if keeps else self.scratch
        palette = self.palette.state if self.palette else None
        keys = self._keys() if self.digests else []
        last = {key.component: key for key in keys}
        on_the_way = self.digests.keys() & set(keys) - set(last.values())
        if kernels is not None and not on_the_way:
            state = TileState(self.directory, self.tile, capacity, palette, memory)
            if apply_compiled(kernels, state, self.data, self.packets, self.scratch):
                for _ in self.packets:
                    self.tick()
                wrong = tuple(key for key in last.values() if self._is_wrong(state, key))
                return _Outcome(state, wrong=wrong)
            del state  # or there are two for a while
            self.scratch.rewind()
        state = TileState(self.directory, self.tile, capacity, palette, memory)
        return self._one_by_one(state)

    def _keys(self) -> list[PacketId]:
        """What each packet is called."""
        components = self.directory.packets["component"][self.packets].tolist()
        steps = self.directory.steps[self.packets].tolist()
        return [
            PacketId(self.tile, component, step)
            for component, step in zip(components, steps, strict=True)
        ]

    def _one_by_one(self, state: TileState) -> _Outcome:
        wrong = []
        for packet, key in zip(self.packets.tolist(), self._keys(), strict=True):
            try:
                state.apply(packet, packet_body(self.directory, self.data, packet))
            except StreamError as fault:
                return _Outcome(state, packet, fault)
            if self._is_wrong(state, key):
                wrong.append(key)
            self.tick()
        return _Outcome(state, wrong=tuple(wrong))

    def _is_wrong(self, state: TileState, key: PacketId) -> bool:
        """R-5.7-3; nobody asks what picks show of a palette with a fault, which is reported."""
        if key not in self.digests:
            return False
        if key.component == PICKS and self.palette and not self.palette.is_good():
            return False
        return state.digest(key.component) != self.digests[key]


class _PaletteJob:
    """The packets of the palette in a cut; tiles run beside it, and wait where they show picks."""

    def __init__(
        self,
        directory: Directory,
        data: memoryview,
        packets: I64,
        kernels: ModuleType | None,
        digests: Mapping[PacketId, bytes],
        tick: Callable[[], None],
    ) -> None:
        self.state = PaletteState(directory, _slots_there(directory, packets, len(data)), kernels)
        self._directory, self._data, self._packets = directory, data, packets
        self._digests, self._tick = digests, tick
        self._is_good = not len(packets)
        self._done = Event()
        if self._is_good:
            self._done.set()

    def run(self) -> _Outcome:
        """Apply them."""
        wrong = []
        packet = -1
        try:
            for step, packet in enumerate(self._packets.tolist()):
                self.state.apply(packet, packet_body(self._directory, self._data, packet))
                key = PacketId(0, PALETTE, step)
                if key in self._digests and self.state.digest() != self._digests[key]:
                    wrong.append(key)
                self._tick()
            self._is_good = True
        except StreamError as fault:
            return _Outcome(None, packet, fault)
        finally:
            self._done.set()
        return _Outcome(None, wrong=tuple(wrong))

    def is_good(self) -> bool:
        """Whether all of them were applied, once that is known."""
        self._done.wait()
        return self._is_good


def _slots_there(directory: Directory, packets: I64, size: int) -> int:
    """Slots that these packets make, without those that never come: a table may promise any."""
    rows = directory.packets[packets]
    rows = rows[directory.offsets[packets] + rows["size"] <= size]
    return int(rows["n_adds"].sum(dtype=np.int64) + rows["n_splits"].sum(dtype=np.int64))


def packet_body(directory: Directory, data: memoryview, packet: int) -> memoryview:
    """The bytes of a packet, complete and with the right CRC-32; they do not change any more."""
    row = directory.packets[packet]
    offset, size = int(directory.offsets[packet]), int(row["size"])
    body = frozen(data[offset : offset + size])
    if len(body) < size:  # R-6.2-2
        raise StreamError(
            Fault.E_TRUNCATED, f"{len(body)} bytes of {size} of a packet are there", offset
        )
    check_crc(int(row["crc"]), offset, body)
    return body
