"""Applying the packets of a cut, tiles in parallel (spec 6.1 steps 4 to 6)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np

from evogs_codec.compiled import apply_compiled, kernels_for
from evogs_codec.cut import Cut
from evogs_codec.directory import Directory, check_crc
from evogs_codec.errors import Fault, StreamError
from evogs_codec.scratch import Scratch
from evogs_codec.splats import I64
from evogs_codec.state import TileState
from evogs_codec.threads import each

__all__ = ["packet_body", "replay_tiles"]

Key: TypeAlias = tuple[int, int, int]  # tile, component, step


def replay_tiles(
    directory: Directory,
    data: memoryview,
    cut: Cut,
    use: Callable[[TileState], None] | None = None,
    *,
    verify: bool = False,
    progress: Callable[[float], None] | None = None,
) -> list[TileState]:
    """The tiles after the packets of a cut; or none, if `use` takes each when it is done.

    Raises:
        StreamError: the first fault in file order; else trailing bytes; else a digest (spec 6.1).
    """
    packets = np.flatnonzero(cut.packets(directory))
    tile_of = directory.packets["tile"][packets]
    order = np.argsort(tile_of, kind="stable")
    ends = np.searchsorted(tile_of[order], np.arange(1, len(directory.tiles)))
    of_tile = np.split(packets[order], ends)[: len(directory.tiles)]  # one part for no tiles
    kernels = kernels_for(_slots_there(directory, packets, len(data)))
    has_more = len(data) > directory.size
    digests = directory.digests if verify and not has_more else {}
    n_done = count(1)
    free: list[Scratch] = []  # of tiles that are done

    def tick() -> None:
        if progress is not None:
            progress(next(n_done) / len(packets))

    def run(tile: int) -> _Outcome:
        scratch = free.pop() if free else Scratch()
        job = _Job(directory, data, tile, of_tile[tile], digests, tick, scratch)
        outcome = job.run(kernels, keeps=use is None)
        if use is not None and outcome.fault is None:
            use(outcome.state)
            outcome.state = None
        scratch.rewind()
        free.append(scratch)
        return outcome

    outcomes = list(each(run, range(len(of_tile))))
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
    wrong: tuple[Key, ...] = ()


@dataclass(frozen=True)
class _Job:
    """The packets of a cut that belong to one tile, in file order."""

    directory: Directory
    data: memoryview
    tile: int
    packets: I64
    digests: Mapping[Key, bytes]
    tick: Callable[[], None]
    scratch: Scratch

    def run(self, kernels: ModuleType | None, *, keeps: bool) -> _Outcome:
        """Apply them, compiled where nothing stands against it; `keeps` the state, or lends it."""
        rows = self.directory.packets[self.packets]
        steps = self.directory.steps[self.packets].tolist()
        keys: list[Key] = [
            (self.tile, component, step)
            for component, step in zip(rows["component"].tolist(), steps, strict=True)
        ]
        capacity = _slots_there(self.directory, self.packets, len(self.data))
        memory = None if keeps else self.scratch
        last = {component: (tile, component, step) for tile, component, step in keys}
        on_the_way = self.digests.keys() & set(keys) - set(last.values())
        if kernels is not None and not on_the_way:
            state = TileState(self.directory, self.tile, capacity, memory)
            if apply_compiled(kernels, state, self.data, self.packets, self.scratch):
                for _ in keys:
                    self.tick()
                wrong = tuple(key for key in last.values() if self._is_wrong(state, key))
                return _Outcome(state, wrong=wrong)
        return self._one_by_one(TileState(self.directory, self.tile, capacity, memory), keys)

    def _one_by_one(self, state: TileState, keys: list[Key]) -> _Outcome:
        wrong = []
        for packet, key in zip(self.packets.tolist(), keys, strict=True):
            try:
                state.apply(packet, packet_body(self.directory, self.data, packet))
            except StreamError as fault:
                return _Outcome(state, packet, fault)
            if self._is_wrong(state, key):
                wrong.append(key)
            self.tick()
        return _Outcome(state, wrong=tuple(wrong))

    def _is_wrong(self, state: TileState, key: Key) -> bool:
        """R-5.7-3."""
        return key in self.digests and state.digest(key[1]) != self.digests[key]


def _slots_there(directory: Directory, packets: I64, size: int) -> int:
    """Slots that these packets make, without those that never come: a table may promise any."""
    rows = directory.packets[packets]
    rows = rows[directory.offsets[packets] + rows["size"] <= size]
    return int(rows["n_adds"].sum(dtype=np.int64) + rows["n_splits"].sum(dtype=np.int64))


def packet_body(directory: Directory, data: memoryview, packet: int) -> memoryview:
    """The bytes of a packet, complete and with the right CRC-32."""
    row = directory.packets[packet]
    offset, size = int(directory.offsets[packet]), int(row["size"])
    body = data[offset : offset + size]
    if len(body) < size:  # R-6.2-2
        raise StreamError(
            Fault.E_TRUNCATED, f"{len(body)} bytes of {size} of a packet are there", offset
        )
    check_crc(int(row["crc"]), offset, body)
    return body
