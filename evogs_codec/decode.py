"""Decoding: a whole file, or what is there of one (spec 6, 7); `feeding` takes it in pieces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from types import ModuleType
from typing import TypeAlias

import numpy as np

from evogs_codec import layout
from evogs_codec.compiled import kernels_for
from evogs_codec.cut import Cut
from evogs_codec.directory import Directory, check_crc, read_directory
from evogs_codec.errors import Fault, StreamError
from evogs_codec.floats import float_view
from evogs_codec.splats import I64, SplatParams
from evogs_codec.state import TileState
from evogs_codec.threads import each

__all__ = ["Decoded", "decode", "decode_prefix", "packet_body", "replay"]

Key: TypeAlias = tuple[int, int, int]  # tile, component, step
TileResult: TypeAlias = tuple[TileState, int, StreamError | None, list[Key]]


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded cut: `directory`, `cut`, the state of each tile, and the stream it came from."""

    directory: Directory
    cut: Cut
    tiles: tuple[TileState, ...]
    data: memoryview

    @property
    def n_leaves(self) -> int:
        """Live slots of all tiles."""
        return sum(int(np.count_nonzero(tile.live[: tile.n_slots])) for tile in self.tiles)

    @property
    def sh_degree(self) -> int:
        """Highest SH band with a step in the cut; the float view stops there."""
        applied = np.flatnonzero(self.cut.steps.any(0))
        return int(applied[-1]) if len(applied) else 0

    def leaves(self, cut: Cut | None = None, *, sh_degree: int | None = None) -> SplatParams:
        """Float view (spec 7.6) of the live splats, tile by tile, in slot order.

        Args:
            cut: a cut within this one, whose packets are applied anew; this one by default.
            sh_degree: degree of the result; by default the highest band of the cut.

        Raises:
            ValueError: `cut` has steps that this cut does not have.
        """
        if cut is not None:
            if cut.steps.shape != self.cut.steps.shape or (cut.steps > self.cut.steps).any():
                raise ValueError("the cut has steps that were not decoded")
            return replay(self.directory, self.data, cut).leaves(sh_degree=sh_degree)
        degree = self.sh_degree if sh_degree is None else sh_degree
        return float_view(self.directory, self.tiles, degree)

    def dump(self) -> bytes:
        """The dump of spec 7.7."""
        directory = self.directory
        head = layout.build(
            layout.DUMP_HEADER,
            magic=b"EVGD",
            version=1,
            sh_degree=directory.sh_degree,
            grid_exponents=list(directory.grid_exponents),
            reserved=0,
            n_tiles=len(self.tiles),
        )
        return head + b"".join(tile.dump() for tile in self.tiles)


def decode(
    data: bytes | memoryview,
    cut: Cut | Callable[[Directory], Cut] | None = None,
    *,
    verify: bool = False,
    limits: Mapping[str, int] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Decoded:
    """Decode a whole file.

    Args:
        data: all bytes of the file.
        cut: the cut, or a function that makes it from the directory; everything by default.
        verify: check the digests of states that the cut passes (R-5.7-3).
        limits: limits of this decoder by name (spec 8.3).
        progress: called with the part of the packets that is done, perhaps from several threads.

    Raises:
        StreamError: the stream is not legal, or over the limits.
        ValueError: the stream has no such cut.
    """
    view = memoryview(data)
    directory = read_directory(view, limits)
    if cut is None:
        cut = Cut.full(directory)
    elif not isinstance(cut, Cut):
        cut = cut(directory)
    has_more = len(view) > directory.size
    verify = verify and not has_more  # 6.1: step 5 before 6
    decoded = replay(directory, view, cut, verify=verify, progress=progress)
    if has_more:  # R-6.2-1
        raise StreamError(
            Fault.E_TRAILING, f"{len(view) - directory.size} bytes follow", directory.size
        )
    return decoded


def decode_prefix(data: bytes | memoryview, *, limits: Mapping[str, int] | None = None) -> Decoded:
    """Decode the complete packets of a truncated file (R-6.4-1).

    Raises:
        StreamError: as `decode`; E_TRUNCATED only if header or chunks are not complete.
    """
    view = memoryview(data)
    directory = read_directory(view, limits)
    ends = directory.offsets + directory.packets["size"]
    return replay(directory, view, Cut.of_complete(directory, ends <= len(view)))


def replay(
    directory: Directory,
    data: memoryview,
    cut: Cut,
    *,
    verify: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Decoded:
    """Apply the packets of a cut; tiles in parallel. Faults as `decode`, first in file order."""
    packets = np.flatnonzero(cut.packets(directory))
    tile_of = directory.packets["tile"][packets]
    order = np.argsort(tile_of, kind="stable")
    ends = np.searchsorted(tile_of[order], np.arange(1, len(directory.tiles)))
    of_tile = np.split(packets[order], ends)[: len(directory.tiles)]  # one part for no tiles
    kernels = kernels_for(_slots_there(directory, packets, len(data)))

    n_done = count(1)

    def tick() -> None:
        if progress is not None:
            progress(next(n_done) / len(packets))

    def run(tile: int) -> TileResult:
        return _replay_tile(directory, data, tile, of_tile[tile], kernels, tick, verify=verify)

    results = list(each(run, range(len(of_tile))))
    faults = [(at, fault) for _, at, fault, _ in results if fault is not None]
    if faults:
        raise min(faults, key=lambda item: item[0])[1]
    wrong = [key for *_, keys in results for key in keys]
    if wrong:
        detail = f"state of (tile, component, step) {min(wrong)}"
        raise StreamError(Fault.E_DIGEST, detail, directory.digests_offset)
    return Decoded(directory, cut, tuple(result[0] for result in results), data)


def _replay_tile(
    directory: Directory,
    data: memoryview,
    tile: int,
    packets: I64,
    kernels: ModuleType | None,
    tick: Callable[[], None],
    *,
    verify: bool,
) -> TileResult:
    """(state, packet at fault, its fault, wrong digests) of one tile."""
    state = TileState(directory, tile, _slots_there(directory, packets, len(data)), kernels)
    wrong: list[Key] = []
    for packet in packets.tolist():
        try:
            state.apply(packet, packet_body(directory, data, packet))
        except StreamError as fault:
            return state, packet, fault, wrong
        key = (tile, int(directory.packets[packet]["component"]), int(directory.steps[packet]))
        if verify and key in directory.digests and state.digest(key[1]) != directory.digests[key]:
            wrong.append(key)
        tick()
    return state, -1, None, wrong


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
