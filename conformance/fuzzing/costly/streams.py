"""The bytes of costly streams, 100,000 at most.

All but those with a fault at their end are legal. Numbers are constant, so that run-length blocks
hold a million of them in a few bytes; only a packet that needs its size (R-5.6-7) has raw blocks.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

import numpy as np

from conformance.fuzzing.costly.runs import Run, frame
from conformance.fuzzing.costly.shapes import Shape, random_shape
from evogs_codec.format import layout
from evogs_codec.format.directory import MAX_DIGESTED_PER_BYTE
from evogs_codec.format.packet_header import (
    FLAG_ADDS_YCOCG,
    FLAG_OF_CHANGED,
    FLAG_PSI_YCOCG,
    MAX_RECORDS_PER_BYTE,
    Counts,
    value_counts,
)
from evogs_codec.format.packet_table import state_sizes
from evogs_codec.format.planes import CODINGS
from evogs_codec.format.write_directory import build_directory
from evogs_codec.model.arithmetic import MAX_X, AlphaTable, Quantiser
from evogs_codec.model.channels import n_channels
from evogs_codec.model.components import PALETTE, PICKS, Components
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.scene_info import SceneInfo

__all__ = ["BUDGET", "costly_stream", "stream_of"]

BUDGET = 100_000  # bytes
N_CORE, N_GROUPS, N_SIDES, N_LISTS = 14, 5, 7, 35
ROW, DIGEST, TILE = (
    layout.size_of(s) for s in (layout.PACKET_ENTRY, layout.DIGEST_ENTRY, layout.TILE_ENTRY)
)
CHUNK = layout.size_of(layout.CHUNK_HEADER)


def costly_stream(rng: Random) -> bytes:
    """A stream of a random shape."""
    while True:
        try:
            return stream_of(random_shape(rng))
        except ValueError:  # no room for packets
            continue


@dataclass
class _Packet:
    """A row of the packet table, its step and its bytes."""

    tile: int
    component: int
    level: int
    step: int
    counts: Counts
    body: bytes


@dataclass
class _Chain:
    """A tile so far: slots, of which the first `n_dropped` are empty and the last `n_new` new."""

    n_slots: int = 0
    n_dropped: int = 0
    n_new: int = 0
    n_steps: int = 0


def stream_of(shape: Shape, budget: int = BUDGET) -> bytes:
    """The stream, of at most `budget` bytes.

    Raises:
        ValueError: the chunks leave no room for packets.
    """
    fixed = len(_directory(shape, [], [])) + DIGEST * shape.digests + CHUNK * bool(shape.digests)
    left = budget - fixed - len(shape.fault)
    if left < ROW * 2:
        raise ValueError("the chunks leave no room for packets")
    packets = _ordered(shape, list(_packets(shape, left)))
    names = _digested(shape, packets)
    head = _directory(shape, packets, names)
    data = head + b"".join(packet.body for packet in packets)
    if shape.fault == "trailing":
        data += b"\0"
    return data


def _packets(shape: Shape, left: int) -> Iterator[_Packet]:
    """Packets tile after tile, of `left` bytes with their rows."""
    if shape.entries:
        packet = _of_palette(shape, left)
        left -= ROW + len(packet.body)
        yield packet
    late = _late_share(shape) if shape.bands == "end" else 0
    per_tile = left // shape.tiles
    for tile in range(shape.tiles):
        chain, room = _Chain(), per_tile
        cores: list[_Packet] = []
        while made := _step_with_bands(shape, tile, chain, room - late * (len(cores) + 1)):
            cores.append(made[0])
            room -= _size(made)
            _advance(chain, made[0].counts)
            yield from made
        if shape.bands == "end":
            for core in cores:
                for component in _components(shape):
                    packet = _beside(shape, core, component)
                    if room < ROW + len(packet.body):
                        break
                    room -= ROW + len(packet.body)
                    yield packet


def _late_share(shape: Shape) -> int:
    """Bytes kept for the packets beside a core packet that come last."""
    return (ROW + (60 if shape.coded > N_CORE else 0)) * len(_components(shape))


def _components(shape: Shape) -> tuple[int, ...]:
    """The components of a tile above core."""
    return Components(shape.degree, shape.entries > 0).of_tiles[1:]


def _size(packets: list[_Packet]) -> int:
    """Bytes of packets and their rows."""
    return sum(ROW + len(packet.body) for packet in packets)


def _step_with_bands(shape: Shape, tile: int, chain: _Chain, room: int) -> list[_Packet]:
    """The packets of the next step of a tile that come together; none if there is no room."""
    for part in (1.0, 0.9, 0.8, 0.6, 0.4, 0.2):
        core = _step(shape, tile, chain, int(part * room))
        if core is None:
            return []
        made = [core]
        if shape.bands == "each" or (shape.bands == "first" and not chain.n_steps):
            made += [_beside(shape, core, component) for component in _components(shape)]
        if _size(made) <= room:
            return made
    return []


def _step(shape: Shape, tile: int, chain: _Chain, room: int) -> _Packet | None:
    """The next core packet of a tile, with records for `room` bytes; None if there is no room."""
    kind = shape.steps[min(chain.n_steps, len(shape.steps) - 1)]
    n_live = chain.n_slots - chain.n_dropped
    if chain.n_steps and not n_live and kind not in ("adds", "empty"):
        kind = "empty"
    level = min(chain.n_steps, shape.levels - 1)
    most = MAX_RECORDS_PER_BYTE * (room - ROW - N_LISTS - 40)
    if kind == "empty" or most < 16:
        if room < ROW or kind != "empty":
            return None
        return _Packet(tile, 0, level, chain.n_steps, Counts(0, 0, 0, 0), b"")
    n_all, n_some = min(n_live, most), min(shape.adds, most)
    counts = {
        "adds": Counts(n_some, 0, 0, 0),
        "split all": Counts(0, n_all, 0, 0),
        "split new": Counts(0, min(chain.n_new, most), 0, 0),
        "split last": Counts(0, 1, 0, 0),
        "split first": Counts(0, 1, 0, 0),
        "refine all": Counts(0, 0, n_all, 0),
        "refine other": Counts(0, 0, max(1, n_all // 2), 0),
        "refine one": Counts(0, 0, 1, 0),
        "drop one": Counts(0, 0, 0, 1),
        "drop all": Counts(0, 0, 0, n_all),
        "mixed": Counts(1, 1, 1, 1) if n_live > 2 else Counts(3, 0, 0, 0),
    }[kind]
    if not chain.n_steps:
        counts = Counts(n_some, 0, 0, 0)
    first = chain.n_dropped
    if kind in ("split last", "split new"):
        first = chain.n_slots - counts.n_splits
    body = _body(shape, 0, counts, first, every=2 if kind == "refine other" else 1)
    return _Packet(tile, 0, level, chain.n_steps, counts, body)


def _advance(chain: _Chain, counts: Counts) -> None:
    chain.n_steps += 1
    chain.n_new = counts.n_adds + counts.n_splits
    chain.n_slots += chain.n_new
    chain.n_dropped += counts.n_drops


def _beside(shape: Shape, core: _Packet, component: int) -> _Packet:
    """A packet of another component of the step of a core packet."""
    body = b""
    if shape.coded > N_CORE and core.body:
        is_picks = component == PICKS
        body = _picks(shape, core) if is_picks else _body(shape, component, core.counts)
    return _Packet(core.tile, component, 0, core.step, Counts(0, 0, 0, 0), body)


def _of_palette(shape: Shape, left: int) -> _Packet:
    """All entries."""
    n_lists = n_channels(shape.degree) - N_CORE
    n = min(shape.entries, MAX_RECORDS_PER_BYTE * (left // 2))
    codes = [shape.coding | shape.delta << 6 if k <= shape.coded else 0 for k in range(n_lists)]
    codes[0] = codes[0] or shape.coding
    runs = [run for code in codes for run in _planes(code, n, shape.value)]
    flags = FLAG_ADDS_YCOCG if shape.ycocg else 0
    body = _sealed(flags, codes, runs, shape.frame, -(-n // MAX_RECORDS_PER_BYTE))
    return _Packet(0, PALETTE, 0, 0, Counts(n, 0, 0, 0), body)


def _picks(shape: Shape, core: _Packet) -> bytes:
    counts = core.counts
    n = counts.n_splits + counts.n_adds + counts.n_psi
    code = shape.coding if n else 0
    return _sealed(FLAG_OF_CHANGED, [code], _planes(code, n, 1 if shape.value else 0), 255, 0)


def _body(shape: Shape, component: int, counts: Counts, first: int = 0, every: int = 1) -> bytes:
    """A packet of core or of a band, whose records name slots from `first` on."""
    lengths = value_counts(component, counts)
    n_sides = N_SIDES if component == 0 else 0
    codes, runs, n_coded = [], [], 0
    first_delta = n_sides
    if counts.n_splits or counts.n_drops:
        first_delta = len(lengths) - (len(lengths) - n_sides) // 2
    for k, n in enumerate(lengths):
        code = 0
        planes: list[Run] = []
        if n and k < n_sides:
            code, planes = _side(shape, k, n, counts, first, every)
        elif n and n_coded < shape.coded:
            code = shape.coding | (shape.delta and k >= first_delta) << 6
            planes, n_coded = _planes(code, n, shape.value), n_coded + 1
        codes.append(code)
        runs += planes
    least = 0 if component else -(-(counts.n_adds + counts.n_records) // MAX_RECORDS_PER_BYTE)
    if least > 2 + len(codes) and not runs:  # something must fill it
        k = next(k for k, n in enumerate(lengths) if n and k != 1)
        codes[k], runs = 0x10, _planes(0x10, lengths[k], 0)
    if component and not runs:
        return b""
    turned = (FLAG_PSI_YCOCG | FLAG_ADDS_YCOCG) if shape.ycocg else 0
    return _sealed(turned, codes, runs, shape.frame, least)


def _side(
    shape: Shape, k: int, n: int, counts: Counts, first: int, every: int
) -> tuple[int, list[Run]]:
    """(coding byte, planes) of gaps, kinds or the alpha of a group."""
    if k == 0 and (first or every > 1):
        gap = every - 1
        return 0x28, [
            part
            for shift in (0, 8, 16)
            for part in ((first >> shift & 255, 1), (gap >> shift & 255, n - 1))
            if part[1]
        ]
    if k == 1:
        kinds = ((2, counts.n_drops), (1, counts.n_splits), (0, counts.n_refines))
        return 8, [(kind, size) for kind, size in kinds if size]
    if k > 1 and shape.alphas:
        return 8, [(0, n)]
    return 0, []


def _planes(code: int, n: int, value: int) -> list[Run]:
    """The planes of n equal integers below 4."""
    coding = CODINGS[code]
    assert coding is not None
    sizes = coding.plane_sizes(n) if n else []
    return [(value if j == 0 and coding.low == 8 else 0, size) for j, size in enumerate(sizes)]


def _sealed(flags: int, codes: list[int], runs: list[Run], per_frame: int, least: int) -> bytes:
    """A packet of at least so many bytes; `runs` are those of its planes."""
    if not any(codes):
        return bytes([flags, 0, *codes])
    parts = _by_plane(codes, runs)
    groups = _frames_of(parts, per_frame)
    head = 2 + len(codes) + 5 * len(groups)
    bodies = [frame(group) for group in groups]
    for k, group in enumerate(groups):  # raw blocks where run-length ones are too short
        short = least - head - sum(map(len, bodies))
        if short > 0:
            bodies[k] = frame(group, short + len(bodies[k]))
    entries = b"".join(
        bytes([len(group)]) + len(body).to_bytes(4, "little")
        for group, body in zip(groups, bodies, strict=True)
    )
    return bytes([flags, len(groups), *codes]) + entries + b"".join(bodies)


def _by_plane(codes: list[int], runs: list[Run]) -> list[list[Run]]:
    """The runs of each plane: a run is a plane, but for those of gaps and kinds."""
    n_planes = sum(coding.n_planes for code in codes if (coding := CODINGS[code]))
    if len(runs) == n_planes:
        return [[run] for run in runs]
    parts: list[list[Run]] = []
    rest = list(runs)
    total = sum(size for _, size in rest[:2])
    if codes[0] == 0x28 and len(rest) - n_planes >= 3 and total > 1:
        parts += [rest[0:2], rest[2:4], rest[4:6]]
        rest = rest[6:]
    elif codes[0] == 0x28:
        parts += [[run] for run in rest[:3]]
        rest = rest[3:]
    n_kinds = len(rest) - (n_planes - len(parts)) + 1
    if n_kinds > 1:
        parts.append(rest[:n_kinds])
        rest = rest[n_kinds:]
    return parts + [[run] for run in rest]


def _frames_of(planes: list[list[Run]], per_frame: int) -> list[list[list[Run]]]:
    """Planes in frames of at most so many, and of at most 16 MiB."""
    groups: list[list[list[Run]]] = [[]]
    size = 0
    for plane in planes:
        n = sum(length for _, length in plane)
        if groups[-1] and (len(groups[-1]) == per_frame or size + n > 16 << 20):
            groups.append([])
            size = 0
        groups[-1].append(plane)
        size += n
    return groups


def _ordered(shape: Shape, packets: list[_Packet]) -> list[_Packet]:
    if not shape.by_step or shape.tiles == 1:
        return packets
    n_before = 1 if shape.entries else 0
    late = shape.bands == "end"
    return packets[:n_before] + sorted(
        packets[n_before:], key=lambda p: (late and p.component > 0, p.step, p.tile, p.component)
    )


def _rows(packets: list[_Packet]) -> np.ndarray:
    rows = np.zeros(len(packets), layout.dtype_of(layout.PACKET_ENTRY))
    for row, packet in zip(rows, packets, strict=True):
        counts = packet.counts
        row["tile"], row["component"], row["level"] = packet.tile, packet.component, packet.level
        row["size"], row["crc"] = len(packet.body), zlib.crc32(packet.body)
        row["n_adds"], row["n_splits"] = counts.n_adds, counts.n_splits
        row["n_refines"], row["n_drops"] = counts.n_refines, counts.n_drops
        row["error"] = 7
    return rows


def _digested(shape: Shape, packets: list[_Packet]) -> list[PacketId]:
    """Names of digests: of the largest states first, as far as R-5.7-5 allows."""
    if not shape.digests or not packets:
        return []
    steps = np.array([packet.step for packet in packets])
    sizes = state_sizes(_rows(packets), steps, Components(shape.degree, shape.entries > 0))
    room = len(_directory(shape, packets, [])) + sum(len(packet.body) for packet in packets)
    named = 0
    names: list[PacketId] = []
    for k in np.argsort(-sizes, kind="stable").tolist():
        named += int(sizes[k])
        room += DIGEST
        if named > MAX_DIGESTED_PER_BYTE * room or len(names) == shape.digests:
            break
        names.append(PacketId(packets[k].tile, packets[k].component, packets[k].step))
    return names


def _directory(shape: Shape, packets: list[_Packet], names: list[PacketId]) -> bytes:
    tiles = np.zeros(shape.tiles, layout.dtype_of(layout.TILE_ENTRY))
    tiles["box_min"], tiles["box_max"] = -MAX_X, MAX_X
    rows = _rows(packets)
    if shape.fault == "crc" and len(rows):
        rows["crc"][np.flatnonzero(rows["size"])[-1:]] ^= 1
    alpha = {}
    for k in range(-(-shape.alphas // 256)):
        level, group = divmod(k, N_GROUPS)
        if level < shape.levels:
            alpha[level, group] = AlphaTable(0, (1,) * min(256, shape.alphas - 256 * k))
    chunk = b"zzZz" + bytes(4)
    chunk += zlib.crc32(chunk).to_bytes(4, "little")
    return build_directory(
        sh_degree=shape.degree,
        n_levels=shape.levels,
        grid_exponents=(10, 6, 5, 5, 7),
        info=SceneInfo(text={f"{k:x}": "" for k in range(shape.metadata)}),
        quantisers=((Quantiser(1, 0),) * (5 + shape.degree),) * (1 + shape.levels),
        alpha=alpha,
        tiles=tiles,
        packets=rows,
        digests=dict.fromkeys(names, bytes(32)),
        has_palette=shape.entries > 0,
        copied_chunks=chunk * shape.chunks,
    )
