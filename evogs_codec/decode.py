"""Decoding: whole files, prefixes, and any byte ranges in any order (spec 6, 7).

decode(data)         a whole file; anything missing is E_TRUNCATED
decode_prefix(data)  what is there
Decoder.feed(data)   bytes as they come; never blocks, never reads a file
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import accumulate
from types import ModuleType
from typing import TypeAlias, TypeVar

import numpy as np

from evogs_codec import layout
from evogs_codec.cut import Cut
from evogs_codec.directory import HEADER_SIZE, Directory, read_directory, read_header
from evogs_codec.errors import Fault, StreamError
from evogs_codec.splats import F32, F64, GROUP_CHANNELS, I32, I64, SplatParams
from evogs_codec.state import TileState

__all__ = ["Decoded", "Decoder", "StepReady", "decode", "decode_prefix"]

T = TypeVar("T")
Key: TypeAlias = tuple[int, int, int]  # tile, component, step
TileResult: TypeAlias = tuple[TileState, int, StreamError | None, list[Key]]
MIN_COMPILED = 50_000  # slots below which numpy is as fast as loading compiled code
BLOCK = 4096  # splats that are transposed at a time: their channels stay in cache


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded cut: `directory`, `cut`, and the state of each tile."""

    directory: Directory
    cut: Cut
    tiles: tuple[TileState, ...]
    data: memoryview

    @property
    def n_leaves(self) -> int:
        return sum(int(np.count_nonzero(tile.live[: tile.n_slots])) for tile in self.tiles)

    @property
    def sh_degree(self) -> int:
        """Highest SH band with a step in the cut; the float view stops there."""
        applied = np.flatnonzero(self.cut.steps.any(0))
        return int(applied[-1]) if len(applied) else 0

    def leaves(self, cut: Cut | None = None, *, sh_degree: int | None = None) -> SplatParams:
        """Float view (spec 7.6) of the live splats, tile by tile, in slot order.

        Args:
            cut: a smaller cut of the same stream; this one by default.
            sh_degree: degree of the result; by default the highest band of the cut.

        Raises:
            ValueError: the cut is not within this one.
        """
        if cut is not None:
            if (cut.steps > self.cut.steps).any():
                raise ValueError("the cut asks for steps that were not decoded")
            return replay(self.directory, self.data, cut).leaves(sh_degree=sh_degree)
        return float_view(
            self.directory, self.tiles, self.sh_degree if sh_degree is None else sh_degree
        )

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
) -> Decoded:
    """Decode a whole file.

    Args:
        data: all bytes of the file.
        cut: the cut, or a function that makes it from the directory; everything by default.
        verify: check the digests of states that the cut passes (R-5.7-3).
        limits: limits of this decoder by name (spec 8.3).

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
    decoded = replay(directory, view, cut, verify=verify and not has_more)  # 6.1: step 5 before 6
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


def replay(directory: Directory, data: memoryview, cut: Cut, *, verify: bool = False) -> Decoded:
    """Apply the packets of a cut; tiles in parallel. Faults as `decode`, first in file order."""
    packets = np.flatnonzero(cut.packets(directory))
    order = np.argsort(directory.packets["tile"][packets], kind="stable")
    bounds = np.searchsorted(
        directory.packets["tile"][packets][order], np.arange(len(directory.tiles) + 1)
    )
    jobs = [packets[order[a:b]] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
    kernels = kernels_for(_slots_there(directory, packets, len(data)))

    def run(tile: int) -> TileResult:
        return _replay_tile(directory, data, tile, jobs[tile], kernels, verify=verify)

    results = _each(run, len(jobs))
    faults = [(at, fault) for _, at, fault, _ in results if fault is not None]
    if faults:
        raise min(faults, key=lambda item: item[0])[1]
    wrong = [key for *_, keys in results for key in keys]
    if wrong:
        detail = f"state of (tile, component, step) {min(wrong)}"
        raise StreamError(Fault.E_DIGEST, detail, directory.digests_offset)
    return Decoded(directory, cut, tuple(result[0] for result in results), data)


def _each(function: Callable[[int], T], n: int) -> list[T]:
    """The function of 0..n-1, in parallel where there is more than one tile."""
    if n < 2:
        return [function(number) for number in range(n)]
    with ThreadPoolExecutor(min(n, os.cpu_count() or 1)) as pool:
        return list(pool.map(function, range(n)))


def _replay_tile(
    directory: Directory,
    data: memoryview,
    tile: int,
    packets: I64,
    kernels: ModuleType | None,
    *,
    verify: bool,
) -> TileResult:
    """(state, packet at fault, its fault, wrong digests) of one tile."""
    state = TileState(directory, tile, _slots_there(directory, packets, len(data)), kernels)
    wrong: list[Key] = []
    for packet in packets.tolist():
        try:
            state.apply(packet, _body(directory, data, packet))
        except StreamError as fault:
            return state, packet, fault, wrong
        key = (tile, int(directory.packets[packet]["component"]), int(directory.steps[packet]))
        if verify and key in directory.digests and state.digest(key[1]) != directory.digests[key]:
            wrong.append(key)
    return state, -1, None, wrong


def _slots_there(directory: Directory, packets: I64, size: int) -> int:
    """Slots that these packets make, without those that never come: a table may promise any."""
    rows = directory.packets[packets]
    rows = rows[directory.offsets[packets] + rows["size"] <= size]
    return int(rows["n_adds"].sum(dtype=np.int64) + rows["n_splits"].sum(dtype=np.int64))


def _body(directory: Directory, data: memoryview, packet: int) -> memoryview:
    """The bytes of a packet, complete and with the right CRC-32."""
    row = directory.packets[packet]
    offset, size = int(directory.offsets[packet]), int(row["size"])
    body = data[offset : offset + size]
    if len(body) < size:  # R-6.2-2
        raise StreamError(
            Fault.E_TRUNCATED, f"{len(body)} bytes of {size} of a packet are there", offset
        )
    crc = zlib.crc32(body)
    if crc != row["crc"]:
        raise StreamError(Fault.E_CRC, f"CRC-32 {crc:#010x}, stored {row['crc']:#010x}", offset)
    return body


def float_view(directory: Directory, tiles: Iterable[TileState], sh_degree: int) -> SplatParams:
    """binary32 of (O + X) * 2**-G, rounded once (R-7.6-1), of the live slots."""
    tiles = list(tiles)
    live = [np.flatnonzero(tile.live[: tile.n_slots]) for tile in tiles]
    n, n_sh = sum(len(rows) for rows in live), 3 * (min(sh_degree, directory.sh_degree) + 1) ** 2
    origins = np.zeros(11 + n_sh, np.int64)
    scales = np.empty(11 + n_sh, np.float64)
    for exponent, channels in zip(directory.grid_exponents, GROUP_CHANNELS, strict=True):
        scales[channels] = 2.0**-exponent
    shapes = ((0, (n, 3)), (3, (n, 4)), (7, (n, 3)), (10, (n, 1)), (11, (n, n_sh)))
    parts = [(first, np.empty(shape, np.float32)) for first, shape in shapes]
    write = getattr(kernels_for(n), "float_rows", _float_rows)
    begins = list(accumulate(map(len, live), initial=0))

    def view(number: int) -> None:
        x, rows = tiles[number].channels(), live[number]
        own = origins.copy()
        own[0:3] = directory.tiles[tiles[number].tile]["origin"]
        for first, out in parts:
            channels = slice(first, first + out.shape[1])
            to = out[begins[number] : begins[number + 1]]
            write(x[channels], rows, own[channels], scales[channels], to)

    _each(view, len(tiles))
    means, quats, log_scales, opacity_logits, sh = (out for _, out in parts)
    missing = 3 * (sh_degree + 1) ** 2 - n_sh  # of bands above those of the stream
    if missing:
        sh = np.concatenate([sh, np.zeros((n, missing), np.float32)], 1)
    return SplatParams(
        means, quats, log_scales, opacity_logits[:, 0], sh.reshape(n, (sh_degree + 1) ** 2, 3)
    )


def _float_rows(x: I32, rows: I64, origins: I64, scales: F64, out: F32) -> None:
    """out[i, c] = binary32((origins[c] + x[c, rows[i]]) * scales[c]), blockwise.

    |O + X| is below 2**53, so binary64 holds it and the cast is the only rounding.
    """
    for at in range(0, len(rows), BLOCK):
        part = x[:, rows[at : at + BLOCK]] + origins[:, None]
        out[at : at + BLOCK] = (part * scales[:, None]).T


def kernels_for(n_slots: int) -> ModuleType | None:
    """The compiled loops where they are installed and worth loading; None for numpy."""
    if n_slots < MIN_COMPILED:
        return None
    try:
        from evogs_codec import kernels
    except ImportError:  # numba is an extra
        return None
    return kernels


# --- progressive ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class StepReady:
    """A packet was applied: a step of a component of a tile; `level` is its label."""

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
        self._done = np.zeros(0, bool)
        self._faults: dict[int, StreamError] = {}
        self._at = 0
        self._early: list[tuple[int, bytes]] = []
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
        if self.directory is None:
            self._early.append((at, bytes(data)))
            self._head.put(at, bytes(data))
            if not self._read_head():
                return []
            pieces, self._early = self._early, []
        else:
            pieces = [(at, bytes(data))]
        ready: list[StepReady] = []
        for begin, piece in pieces:
            ready += self._take(begin, piece)
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
        return Cut(np.array([t.n_applied for t in self._tiles], np.int64).reshape(shape))

    def leaves(self) -> SplatParams:
        """Float view of what was applied so far; no splats before header and chunks came."""
        if self.directory is None:
            return SplatParams.from_channels(np.zeros((14, 0), np.float32))
        return float_view(self.directory, self._tiles, self.directory.sh_degree)

    def _read_head(self) -> bool:
        if not self._head.covers(self._head_size):
            return False
        prefix = memoryview(self._head.prefix())
        if len(prefix) < HEADER_SIZE:
            if prefix[:8] != layout.SIGNATURE[: len(prefix[:8])]:
                read_header(prefix)
            return False
        self._head_size = HEADER_SIZE + read_header(prefix, self._limits)["chunks_size"]
        if len(prefix) < self._head_size:
            return False
        directory = read_directory(prefix, self._limits)
        self._head = _Ranges()
        self.directory = directory
        rows = directory.packets
        # Slots are made as packets come: a table may promise any number.
        self._tiles = [TileState(directory, t, 0) for t in range(len(directory.tiles))]
        self._done = np.zeros(len(rows), bool)
        self._next: list[list[list[int]]] = [
            [[] for _ in range(directory.n_components)] for _ in self._tiles
        ]
        for packet, (tile, component) in enumerate(rows[["tile", "component"]].tolist()):
            self._next[tile][component].append(packet)
        for packet in np.flatnonzero(rows["size"] == 0).tolist():
            self._whole[packet] = b""
        return True

    def _take(self, at: int, data: bytes) -> list[StepReady]:
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
            if self._done[packet] or packet in self._whole or size == 0:
                continue
            offset = int(directory.offsets[packet])
            begin, stop = max(at, offset), min(end, offset + size)
            part = data[begin - at : stop - at]
            if len(part) == size:
                self._whole[packet] = part
            else:
                ranges = self._parts.setdefault(packet, _Ranges())
                ranges.put(begin - offset, part)
                if ranges.covers(size):
                    self._whole[packet] = ranges.prefix()
                    del self._parts[packet]
            if packet in self._whole:
                touched.add(int(directory.packets["tile"][packet]))
        return [ready for tile in sorted(touched) for ready in self._advance(tile)]

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
                if packet not in self._whole or packet in self._faults or blocked:
                    break
                body = self._whole[packet]
                try:
                    crc = zlib.crc32(body)
                    row = directory.packets[packet]
                    if crc != row["crc"]:
                        offset = int(directory.offsets[packet])
                        detail = f"CRC-32 {crc:#010x}, stored {row['crc']:#010x}"
                        raise StreamError(Fault.E_CRC, detail, offset)
                    state.apply(packet, memoryview(body))
                except StreamError as fault:
                    self._faults[packet] = fault
                    break
                del self._whole[packet]
                self._done[packet] = True
                level = int(directory.packets["level"][chain[0] if component else packet])
                if component:
                    level = state.level(step)
                ready.append(StepReady(tile, component, step, level))
        return ready

    def _raise_first_fault(self) -> None:
        if self._faults:
            first = min(self._faults)
            if self._done[:first].all():
                raise self._faults[first]


class _Ranges:
    """Byte ranges that came, overlapping or not, of something that begins at 0."""

    def __init__(self) -> None:
        self._head = bytearray()  # from 0 without a gap
        self._later: dict[int, bytes] = {}

    def put(self, at: int, data: bytes) -> None:
        """Add a range."""
        if at > len(self._head):
            if len(data) > len(self._later.get(at, b"")):
                self._later[at] = data
            return
        self._head += data[len(self._head) - at :]
        while self._later and (at := min(self._later)) <= len(self._head):
            self._head += self._later.pop(at)[len(self._head) - at :]

    def covers(self, size: int) -> bool:
        """All bytes 0..size are there."""
        return len(self._head) >= size

    def prefix(self) -> bytes:
        """The bytes from 0 on without a gap."""
        return bytes(self._head)
