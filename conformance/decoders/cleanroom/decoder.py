#!/usr/bin/env python3
"""A decoder of EvoGS 1.0 streams, written from the text of the specification alone.

It was written from an earlier version of the text and then brought to this one, as palettes (12)
and sibling differences (7.1) were later; nothing else that reads or writes such streams was seen.
But for one thing: the check of Huffman streams (R-5.10-12 to R-5.10-15) was added by an author of
the other decoders, from RFC 8878.
It follows the text: header and chunks (5.1 to 5.8), packets and frames (5.9, 5.10), steps (7),
cuts and progressive decoding (6), the dump (7.7), the command. It decodes what came
when no more comes: of 6.4 it needs only the end.
Over 400 lines: it is one file that can be carried off, and reads in the order of the text.
Requirement ids stand beside the lines that check them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import struct
import sys
import traceback
import zlib
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, chain
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zstandard


class FaultError(Exception):
    """A fault of section 9, of the structure at `Source.at`; the message is its code."""


def require(kept: bool, code: str) -> None:
    """Raise the fault unless the requirement is kept."""
    if not kept:
        raise FaultError(code)


class Source:
    """The bytes that came, all of a file or ranges [offset, size] of it, and where checks are."""

    def __init__(self, data: bytes, arrived: list[list[int]] | None) -> None:
        self.data = memoryview(data)
        self.at = 0  # the offset of the structure being checked (9)
        self.there = bytearray(len(data))
        for offset, size in [[0, len(data)]] if arrived is None else arrived:
            start, end = max(offset, 0), min(offset + size, len(data))
            self.there[start:end] = b"\1" * (end - start)

    def has(self, start: int, size: int) -> bool:
        """Tell whether size bytes from start on are there; no bytes always are."""
        end = start + size
        return size == 0 or (end <= len(self.there) and self.there.find(0, start, end) < 0)


# 5.1 to 5.8: header and chunks
SIGNATURE = bytes.fromhex("89 45 56 47 0D 0A 1A 0A")
LIMITS = {  # 8.2, by tier
    "n_tiles": (64, 4096, 65536),
    "n_packets": (16384, 262144, 4194304),
    "n_levels": (64, 64, 64),
    "chunks_size": (1048576, 33554432, 536870912),
    "tile_steps": (1024, 4096, 65535),
    "tile_slots": (1048576, 4194304, 16777216),
    "slots": (2097152, 33554432, 2147483647),
}
ORDERED = (b"QUAN", b"ALFA", b"TILE", b"PACK")
ANCILLARY = (b"dGST", b"mETa")
KEY_BYTES = b"abcdefghijklmnopqrstuvwxyz0123456789_.-"
BOUND = (1 << 30) - 1
Numbers = list[int] | None  # of a channel; None stands for zeros
Limits = Mapping[str, int]
TileRow = tuple[int, ...]  # origin, box_min, box_max


class Row(NamedTuple):
    """A row of the packet table; level and counts are those of the core row of the step.

    A row of entries belongs to no step of a tile (12): level and counts are its own.
    """

    tile: int
    component: int
    step: int
    start: int
    size: int
    crc: int
    holds: str  # "core", "band", "picks" or "entries"
    n_entries: int  # of picks: of the packets of the palette that they require (12.2); else 0
    level: int
    n_adds: int
    n_splits: int
    n_refines: int
    n_drops: int


@dataclass(slots=True)
class Stream:
    """What the header and the chunks say, and then what was decoded of the packets."""

    tier: int
    sh_degree: int
    n_levels: int
    grid_exponents: bytes
    n_tiles: int
    n_packets: int
    chunks_size: int
    data_size: int
    own: Limits  # the limits of this decoder
    widths: Mapping[int, int] = field(default_factory=dict)  # channels, by component of tiles
    palette: list[array[int]] = field(default_factory=list)  # channels of entries; none: no palette
    chunks: dict[bytes, tuple[int, memoryview]] = field(default_factory=dict)
    quantisers: list[list[tuple[int, int]]] = field(default_factory=list)
    alpha: dict[tuple[int, int], tuple[int, Sequence[int]]] = field(default_factory=dict)
    tiles: list[TileRow] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    digests: dict[tuple[int, int, int], bytes] = field(default_factory=dict)
    states: dict[int, Tile] = field(default_factory=dict)  # of tiles with packets in the cut
    missing: int | None = None  # start of the first packet asked for that was not applied
    faults: list[tuple[str, int]] = field(default_factory=list)  # 6.4: code and offset

    def limit(self, name: str, value: int) -> None:
        """Check the limit of the tier, then that of this decoder."""
        require(value <= LIMITS[name][self.tier - 1], "E_TIER")  # R-8.2-1
        require(value <= self.own.get(name, value), "E_LIMIT")  # R-8.3-1


def read_header(source: Source, own: Limits) -> Stream:
    """6.1 step 1."""
    there = len(source.there.partition(b"\0")[0])
    require(there > 0, "E_TRUNCATED")
    require(source.data[: min(there, 8)] == SIGNATURE[:there], "E_SIGNATURE")  # R-5.1-1
    require(there >= 64, "E_TRUNCATED")  # R-6.2-2
    fields = struct.unpack_from("<8x5B5sH4xIIIQ16sI", source.data)
    major, _, tier, degree, levels, grids, flags, tiles, packets, chunks, size, zero, crc = fields
    require(major == 1, "E_VERSION")  # R-5.1-2
    require(zlib.crc32(source.data[:60]) == crc, "E_CRC")  # R-6.3-1
    require(flags < 512 and not any(zero), "E_RESERVED")  # R-4.4-1
    require(1 <= tier <= 3 and degree <= 3 and levels >= 1, "E_HEADER")  # R-5.1-4 to R-5.1-6
    require(within(struct.unpack("5b", grids), -16, 40), "E_HEADER")  # R-5.1-7
    require(flags < 256 or degree > 0, "E_HEADER")  # R-5.1-9
    stream = Stream(tier, degree, levels, grids, tiles, packets, chunks, size, own)
    bands = [3 * (2 * b + 1) for b in range(1, degree + 1)]
    stream.widths = {0: N_CORE, **({4: sum(bands)} if flags & 256 else dict(enumerate(bands, 1)))}
    stream.palette = [array("i") for _ in range(sum(bands))] if flags & 256 else []
    for name in ("n_levels", "n_tiles", "n_packets", "chunks_size"):
        stream.limit(name, getattr(stream, name))
    return stream


def read_chunks(source: Source, stream: Stream) -> None:
    """6.1 steps 2 and 3."""
    source.at, end = 64, 64 + stream.chunks_size
    require(source.has(64, stream.chunks_size), "E_TRUNCATED")  # R-6.2-2
    found = stream.chunks  # the last of each type; known ones occur once
    while source.at < end:
        data = source.data[source.at : end]
        require(len(data) >= 12, "E_CHUNK")  # R-5.2-1
        kind, size, crc = struct.unpack_from("<4sII", data)
        require(len(data) >= 12 + size, "E_CHUNK")  # R-5.2-1
        body = data[12 : 12 + size]
        require(zlib.crc32(body, zlib.crc32(data[:8])) == crc, "E_CRC")  # R-6.3-1
        require(kind.isalpha() and kind[2:3].isupper(), "E_CHUNK")  # R-5.2-2
        if kind in ORDERED:
            later = ORDERED[ORDERED.index(kind) :]
            require(not any(k in found for k in later), "E_CHUNK")  # R-5.2-3
        elif kind in ANCILLARY:
            require(kind not in found, "E_CHUNK")  # R-5.2-4
        else:
            require(kind[:1].islower(), "E_UNSUPPORTED")  # R-8.1-1, R-8.1-2
        found[kind] = source.at, body
        source.at += 12 + size
    source.at = 64
    require(all(k in found for k in (b"QUAN", b"TILE", b"PACK")), "E_CHUNK")  # R-5.2-3
    readers = (read_quan, read_alfa, read_tile, read_pack, read_dgst, read_meta)
    for kind, reader in zip(ORDERED + ANCILLARY, readers, strict=True):
        if kind in found:
            source.at, body = found[kind]
            reader(body, stream)
        if kind == b"PACK":
            source.at, size = 0, sum(row.size for row in stream.rows)
            require(stream.data_size == size, "E_HEADER")  # R-5.1-8


def read_quan(body: memoryview, stream: Stream) -> None:
    """5.3: rows of (M, E) by class; row 0 for adds, row 1 + level for psi."""
    width = 5 + stream.sh_degree
    require(len(body) == 3 * width * (1 + stream.n_levels), "E_CHUNK")  # R-5.2-5
    entries = list(struct.iter_unpack("<HB", body))
    require(all(m >= 1 and e <= 24 for m, e in entries), "E_STEP")  # R-5.3-1, R-5.3-2
    stream.quantisers = [entries[i : i + width] for i in range(0, len(entries), width)]


def read_alfa(body: memoryview, stream: Stream) -> None:
    """5.4: K and the entries a of each table, by (level, group)."""
    before = (-1, 0)
    while len(body) > 0:
        require(len(body) >= 4, "E_CHUNK")  # R-5.4-3
        level, group, k, last = body[:4]
        require(level < stream.n_levels and group < 5 and k <= 12, "E_ALPHA")  # R-5.4-1
        require((level, group) > before, "E_ALPHA")  # R-5.4-2
        before, end = (level, group), 6 + 2 * last
        require(end <= len(body), "E_CHUNK")  # R-5.4-3
        stream.alpha[before] = k, struct.unpack(f"<{last + 1}h", body[4:end])
        body = body[end:]


def read_tile(body: memoryview, stream: Stream) -> None:
    """5.5: origins and boxes."""
    require(len(body) == 48 * stream.n_tiles, "E_CHUNK")  # R-5.2-5
    for row in struct.iter_unpack("<3q3i3i", body):
        require(within(row[:3], -(1 << 52), 1 << 52), "E_TILE")  # R-5.5-1
        box = zip(row[3:6], row[6:], strict=True)
        require(all(-BOUND <= a <= b <= BOUND for a, b in box), "E_TILE")  # R-5.5-2
        stream.tiles.append(row)


def read_pack(body: memoryview, stream: Stream) -> None:
    """5.6: the packets, with their starts and steps."""
    require(len(body) == 36 * stream.n_packets, "E_CHUNK")  # R-5.2-5
    chains: dict[tuple[int, int], list[Row]] = {}
    splats = [0] * stream.n_tiles
    slots = [0] * (stream.n_tiles + 1)  # the last are entries, bounded like those of a tile (8.2)
    entries_of = [0] * stream.n_levels  # of the palette, by level, in the rows so far
    all_slots, start = 0, 64 + stream.chunks_size
    held = dict.fromkeys(range(1, 1 + stream.sh_degree), "band")
    held = {0: "core", **({4: "picks", 5: "entries"} if stream.palette else held)}
    for entry in struct.iter_unpack("<IBBHIIIIIII", body):
        tile, component, level, zero, size, *counts, _, crc = entry  # R-5.6-9: the error is a hint
        adds, splits, refines, drops = counts
        require(zero == 0, "E_RESERVED")  # R-4.4-1
        require(tile < stream.n_tiles and component in held, "E_CHAIN")  # R-5.6-1
        holds, n_records = held[component], sum(counts)
        core = chains.setdefault((tile, 0), [])
        own = chains.setdefault((0 if holds == "entries" else tile, component), [])
        if holds in ("core", "entries"):
            least = own[-1].level if own else 0
            require(least <= level < stream.n_levels, "E_CHAIN")  # R-5.6-3
            require(holds == "core" or n_records == adds, "E_COUNT")  # R-5.6-4
            require((size == 0) == (n_records == 0), "E_COUNT")  # R-5.6-5
            if holds == "core":
                require(splits + refines + drops <= splats[tile], "E_COUNT")  # R-5.6-6
                splats[tile] += adds + splits - drops
        else:
            require(len(core) > len(own), "E_CHAIN")  # R-5.6-2
            require(level == 0 and n_records == 0, "E_COUNT")  # R-5.6-4
            level, *counts = core[len(own)][-5:]
        require(n_records <= 16 * size, "E_AMPLIFICATION")  # R-5.6-7
        require(size > 0 or crc == 0, "E_CRC")  # R-5.6-8
        of, n_entries = tile, 0
        if holds == "entries":
            require(tile == 0, "E_CHAIN")  # R-5.6-10
            entries_of[level] += adds
            of = stream.n_tiles
        elif holds == "picks":
            n_entries = sum(entries_of[: level + 1])  # before it, up to its label (12.2)
        slots[of] += adds + splits
        all_slots += adds + splits
        stream.limit("tile_steps", len(own) + 1)
        stream.limit("tile_slots", slots[of])
        stream.limit("slots", all_slots)
        name = tile, component, len(own)
        own.append(Row(*name, start, size, crc, holds, n_entries, level, *counts))
        stream.rows.append(own[-1])
        start += size


def read_dgst(body: memoryview, stream: Stream) -> None:
    """5.7: digests, in order."""
    require(len(body) % 41 == 0, "E_CHUNK")  # R-5.2-5
    sizes = state_sizes(stream) if body else {}
    before, n_bytes = (-1, 0, 0), 0
    for *name, digest in struct.iter_unpack("<IBI32s", body):
        tile, component, step = name
        require((tile, component, step) > before, "E_CHUNK")  # R-5.7-1
        before = tile, component, step
        require(before in sizes, "E_CHUNK")  # R-5.7-2
        n_bytes += sizes[before]
        most = 4096 * (64 + stream.chunks_size + stream.data_size)
        require(n_bytes <= most, "E_AMPLIFICATION")  # R-5.7-5
        stream.digests[before] = digest


def state_sizes(stream: Stream) -> dict[tuple[int, int, int], int]:
    """5.7: the bytes of the state after each row, by tile, component and step."""
    sizes: dict[tuple[int, int, int], int] = {}
    slots: dict[tuple[int, int], int] = {}  # by tile and step
    above = 4 * (3 * (stream.sh_degree + 1) ** 2 - 3)
    n_entries = 0
    for row in stream.rows:
        at = (row.tile, row.step)
        if row.holds == "core":
            slots[at] = slots.get((row.tile, row.step - 1), 0) + row.n_adds + row.n_splits
            sizes[row[:3]] = 4 + 61 * slots[at]
        elif row.holds == "entries":
            n_entries += row.n_adds
            sizes[row[:3]] = 4 + above * n_entries
        else:
            per_slot = above if row.holds == "picks" else 12 * (2 * row.component + 1)
            sizes[row[:3]] = 4 + per_slot * slots[at]
    return sizes


def read_meta(body: memoryview, _: Stream) -> None:
    """5.8: metadata is checked, and not kept."""
    before = b""
    while len(body) > 0:
        require(len(body) >= 3, "E_META")  # R-5.8-1
        key_size, value_size = struct.unpack_from("<BH", body)
        value_at, end = 3 + key_size, 3 + key_size + value_size
        require(len(body) >= end, "E_META")  # R-5.8-1
        key = bytes(body[3:value_at])
        require(key_size > 0 and all(c in KEY_BYTES for c in key), "E_META")  # R-5.8-2
        require(key > before, "E_META")  # R-5.8-3
        try:
            str(body[value_at:end], "utf-8")
        except UnicodeDecodeError:
            raise FaultError("E_META") from None  # R-5.8-4
        before, body = key, body[end:]


# 5.9, 5.10: packets and frames
N_CORE = 14
CORE_CLASSES: tuple[int, ...] = (0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4)
ENTRY_CLASSES = (5,) * 9 + (6,) * 15 + (7,) * 21  # of the channels from 14 on
PACKED = {  # the 8 / low values of a byte of a packed plane
    low: [tuple((b >> i) & ((1 << low) - 1) for i in range(0, 8, low)) for b in range(256)]
    for low in (1, 2, 4)
}


class Stored(NamedTuple):
    """A list of a packet."""

    n: int
    code: int
    planes: list[memoryview]

    def plane_sizes(self) -> list[int]:
        """Give the bytes of each of its planes."""
        low = self.code & 15
        below = [] if low == 0 else [(self.n * low + 7) // 8 if low in PACKED else self.n]
        return below + [self.n] * ((self.code >> 4) & 3)

    def integers(self) -> list[int]:
        """`unpack` of 7.1."""
        low, values = self.code & 15, [0] * self.n
        if low in PACKED:
            below = map(PACKED[low].__getitem__, self.planes[0])
            values = list(chain.from_iterable(below))[: self.n]
        elif low > 0:
            values = list(self.planes[0])
        for k, plane in enumerate(self.planes[low > 0 :]):
            shift = low + 8 * k
            values = [v + (above << shift) for v, above in zip(values, plane, strict=True)]
        return values

    def numbers(self, of_psi: bool) -> Numbers:
        """Give the numbers q of psi, adds or entries before YCoCg."""
        if self.code == 0:
            return None
        values = [(z >> 1) ^ -(z & 1) for z in self.integers()]
        if self.code & 64 and not of_psi:
            values = list(accumulate(values))
            require(within(values, -(1 << 28), 1 << 28), "E_RANGE")  # R-7.1-1
        return values


def list_counts(row: Row, stream: Stream, flags: int) -> tuple[list[int], int]:
    """Count the integers of the lists of a packet, in order; tell from which on delta is allowed.

    It is from adds or entries on, and from psi on in a step without splits and drops.
    """
    if row.holds == "picks":
        of_changed = row.n_splits + row.n_refines if flags & 4 else 0
        return [of_changed + row.n_splits + row.n_adds], 1
    if row.holds == "entries":
        return [row.n_adds] * len(stream.palette), 0
    by_kind = [row.n_refines, row.n_splits, row.n_drops]
    c, counts = stream.widths[row.component], []
    if row.holds == "core":
        n_kinds = sum(by_kind) if by_kind.count(0) < 2 else 0
        counts = [sum(by_kind), n_kinds] + [row.n_splits] * 5
    first_delta = len(counts) + (c if row.n_splits + row.n_drops > 0 else 0)
    counts += [row.n_splits + row.n_refines] * c
    return counts + [row.n_adds] * c, first_delta


def read_packet(data: memoryview, row: Row, stream: Stream) -> tuple[int, list[Stored]]:
    """Flags and lists of a packet: 6.1 step 4 from the crc up to R-5.9-9."""
    flags = data[0] if row.size > 0 else 0
    counts, first_delta = list_counts(row, stream, flags)
    if row.size == 0:
        return 0, [Stored(n, 0, []) for n in counts]
    require(zlib.crc32(data) == row.crc, "E_CRC")  # R-6.3-1
    at = 2 + len(counts)
    require(len(data) >= at, "E_PACKET")  # R-5.9-1
    n_frames, codes = data[1], bytes(data[2:at])
    most = 8 if row.holds == "picks" else 4
    require(flags < most and max(codes) < 128, "E_RESERVED")  # R-4.4-1
    lists = [Stored(n, code, []) for n, code in zip(counts, codes, strict=True)]
    for i, (n, code, _) in enumerate(lists):
        require(code & 15 <= 8 and (code >> 4) & 3 <= 2 and code != 64, "E_PACKET")  # R-5.9-2
        require(code < 64 or i >= first_delta, "E_PACKET")  # R-5.9-3
        require(n > 0 or code == 0, "E_PACKET")  # R-5.9-4
    end = at + 5 * n_frames
    require(len(data) >= end, "E_PACKET")  # R-5.9-1
    frames = list(struct.iter_unpack("<BI", data[at:end]))
    places = [(of.planes, size) for of in lists for size in of.plane_sizes()]
    require(all(n >= 1 for n, _ in frames), "E_PACKET")  # R-5.9-7
    require(sum(n for n, _ in frames) == len(places), "E_PACKET")  # R-5.9-7
    require(sum(size for _, size in frames) == len(data) - end, "E_PACKET")  # R-5.9-8
    for n, size in frames:
        of_frame, places, at, end = places[:n], places[n:], end, end + size
        content = memoryview(read_frame(data[at:end], sum(size for _, size in of_frame)))
        for planes, plane_size in of_frame:
            planes.append(content[:plane_size])
            content = content[plane_size:]
    for n, code, planes in lists:
        low = code & 15
        if low in PACKED:
            used = (n * low - 1) % 8 + 1  # bits of the last byte
            require(planes[0][-1] >> used == 0, "E_PACKET")  # R-5.9-9
        elif low > 0:
            require(max(planes[0]) >> low == 0, "E_PACKET")  # R-5.9-9
    return flags, lists


def read_frame(frame: memoryview, expected: int) -> bytes:
    """Give the content of a Zstandard frame, which must be of the expected size."""
    require(bytes(frame[:4]) == b"\x28\xb5\x2f\xfd", "E_FRAME")  # R-5.10-1
    require(len(frame) >= 5 and frame[4] & 0x3F == 0x20, "E_FRAME")  # R-5.10-2
    field_size = 1 << (frame[4] >> 6)
    at = 5 + field_size
    content_size = int.from_bytes(frame[5:at], "little") + (256 if field_size == 2 else 0)
    require(len(frame) >= at and content_size == expected, "E_FRAME")  # R-5.10-3
    require(expected <= 16 << 20, "E_FRAME")  # R-5.10-4
    last = 0
    while not last:  # R-5.10-5
        require(len(frame) >= at + 3, "E_FRAME")
        block = int.from_bytes(frame[at : at + 3], "little")
        last, kind, size = block & 1, (block >> 1) & 3, block >> 3
        require(kind < 3 and size <= min(128 << 10, expected), "E_FRAME")
        require(size > 0 or (kind == 0 and last == 1), "E_FRAME")
        at += 3 + (1 if kind == 1 else size)
    require(at == len(frame), "E_FRAME")  # R-5.10-5
    try:
        content = zstandard.ZstdDecompressor().decompressobj().decompress(frame)
    except zstandard.ZstdError:
        raise FaultError("E_ZSTD") from None  # R-5.10-6
    require(len(content) == expected, "E_ZSTD")  # R-5.10-6
    check_huffman(frame[5 + field_size :])
    return content


def check_huffman(rest: memoryview) -> None:
    """Check the Huffman streams of the blocks of a frame, which are known to have their bytes."""
    tree = HuffmanTree(1, b"")
    while len(rest) > 0:
        header = int.from_bytes(rest[:3], "little")
        stored = 1 if header & 6 == 2 else header >> 3
        block, rest = rest[3 : 3 + stored], rest[3 + stored :]
        if header & 6 != 4 or block[0] & 3 < 2:
            continue
        size_format = block[0] >> 2 & 3
        n_bits, start = (10, 3) if size_format < 2 else (4 * size_format + 6, 2 + size_format)
        both = int.from_bytes(block[:start], "little") >> 4
        n_literals, part = both % (1 << n_bits), block[start : start + (both >> n_bits)]
        if block[0] & 3 == 2:  # it brings a tree; else that of the block before stays
            tree, part = read_tree(part)
        if size_format == 0:
            tree.check_stream(part, n_literals)
            continue
        of_stream, at = (n_literals + 3) // 4, 6
        for k in (0, 2, 4):
            end = at + int.from_bytes(part[k : k + 2], "little")
            tree.check_stream(part[at:end], of_stream)
            at = end
        tree.check_stream(part[at:], n_literals - 3 * of_stream)


class HuffmanTree(NamedTuple):
    """The bits of the longest code, and those of the code that each number of so many bits has."""

    n_bits: int
    codes: bytes

    def check_stream(self, stream: memoryview, n_literals: int) -> None:
        """R-5.10-12: the stream ends with its mark, and its codes take the bits below."""
        require(len(stream) > 0 and stream[-1] > 0, "E_ZSTD")
        below = bytes(2) + bytes(stream)  # of a stream that has too few bits, 0 is read for them
        left = 8 * len(below) + stream[-1].bit_length() - 9
        mask = (1 << self.n_bits) - 1
        for _ in range(n_literals):
            low = left - self.n_bits
            three = int.from_bytes(below[low >> 3 : (low >> 3) + 3], "little")
            left -= self.codes[three >> (low & 7) & mask]
            require(left >= 16, "E_ZSTD")
        require(left == 16, "E_ZSTD")


def read_tree(part: memoryview) -> tuple[HuffmanTree, memoryview]:
    """Give a Huffman tree (RFC 8878, 4.2.1), and what follows its description."""
    n, rest = part[0] - 127, part[1:]
    if n > 0:
        weights = [rest[k >> 1] >> (0 if k & 1 else 4) & 15 for k in range(n)]
        rest = rest[(n + 1) // 2 :]
    else:
        weights, rest = read_weights(bytes(rest[: part[0]])), rest[part[0] :]
    shares = [1 << weight >> 1 for weight in weights]
    n_bits = sum(shares).bit_length()
    require(n_bits <= 11, "E_ZSTD")  # R-5.10-13
    shares.append((1 << n_bits) - sum(shares))
    require(shares.count(1) >= 2, "E_ZSTD")  # R-5.10-14
    codes = b"".join(bytes([n_bits - share.bit_length() + 1]) * share for share in sorted(shares))
    return HuffmanTree(n_bits, codes), rest


def read_weights(coded: bytes) -> list[int]:
    """Give the weights that two FSE states stand for in turn (RFC 8878, 4.1 and 4.2.1.2)."""
    log, at = coded[0] % 16 + 5, 4
    size, shares = 1 << log, dict[int, int]()  # of the states, -1 for a weight that is rare
    weight, left, forward = 0, size, int.from_bytes(coded, "little")
    while left > 0:
        # A share plus 1, of 0 to left + 1: the lowest numbers take a bit less.
        top = 1 << (left + 1).bit_length() - 1
        lowest = 2 * top - left - 2
        number = (forward >> at) % top
        at += top.bit_length() - 1
        if number >= lowest:
            number += top * (forward >> at & 1)
            at += 1
            number -= lowest if number >= top else 0
        shares[weight] = number - 1
        left -= abs(number - 1)
        weight += 1
        while number == 1:  # how many more have none, 3 at a time
            weight += forward >> at & 3
            number = 1 if forward >> at & 3 == 3 else 0
            at += 2
    states, place = [w for w, share in shares.items() if share < 0], 0
    states, n_common = [-1] * (size - len(states)) + states[::-1], size - len(states)
    for w, share in shares.items():
        for _ in range(share):
            states[place] = w
            place = (place + size // 2 + size // 8 + 3) % size
            while place >= n_common:
                place = (place + size // 2 + size // 8 + 3) % size
    numbers = {w: abs(share) for w, share in shares.items()}
    stream, weights = coded[(at + 7) // 8 :], list[int]()
    backward, unread = int.from_bytes(stream, "little"), 8 * len(stream) - 9
    unread += stream[-1].bit_length()
    table = list[tuple[int, int]]()
    for w in states:
        more = log + 1 - numbers[w].bit_length()  # bits of the next state
        table.append((more, (numbers[w] << more) - size))
        numbers[w] += 1
    first, second = (backward >> (unread - k * log) & (size - 1) for k in (1, 2))
    unread -= 2 * log
    while True:
        weights.append(states[first])
        more, base = table[first]
        unread -= more
        if unread < 0:
            return [*weights, states[second]]  # R-5.10-15
        first, second = second, base + (backward >> unread & ((1 << more) - 1))


# 7: decoding
class Step(NamedTuple):
    """The records of a step, as all components need them."""

    changed: list[int]  # slots of refines and splits
    split_at: list[int]  # which of them are splits
    dropped: list[int]
    alpha: list[tuple[int, list[int]]]  # by group: K, and a of each split
    n_adds: int


class Tile:
    """The state of a tile; x[component][channel of the component][slot]."""

    def __init__(self, row: TileRow, widths: Mapping[int, int]) -> None:
        self.row = row
        self.live = bytearray()
        self.born_from = array("i")
        self.x = {c: [array("i") for _ in range(width)] for c, width in widths.items()}
        self.steps: dict[int, Step] = {}  # while packets of the cut need them (8.3)


def s32(values: Sequence[int]) -> bytes:
    """Give numbers as s32."""
    return struct.pack(f"<{len(values)}i", *values)


def state(row: Row, stream: Stream, tile: Tile) -> bytes:
    """Give the state (7.7) of what the packets of this component make."""
    x = stream.palette if row.holds == "entries" else tile.x[row.component]
    of_core = [bytes(tile.live), s32(tile.born_from)] if row.holds == "core" else []
    return b"".join([struct.pack("<I", len(x[0])), *of_core, *map(s32, x)])


def within(values: Sequence[int], low: int, high: int) -> bool:
    """Tell whether all values are in low..high."""
    return not values or (low <= min(values) and max(values) <= high)


def inverse_ycocg(triple: list[Numbers], n: int) -> list[Numbers]:
    """R, G, B of n triples stored as YCoCg-R (7.1)."""
    y, co, cg = (bytes(n) if q is None else q for q in triple)
    t = [u - (v >> 1) for u, v in zip(y, cg, strict=True)]
    green = [u + v for u, v in zip(cg, t, strict=True)]
    blue = [u - (v >> 1) for u, v in zip(t, co, strict=True)]
    return [[u + v for u, v in zip(blue, co, strict=True)], green, blue]


def find_elders(slots: list[int], born_from: Sequence[int]) -> list[int]:
    """Give, for each record, that of the slot which its slot was born from, or -1 (7.1).

    It is an earlier one, for slots increase and are born from lower ones.
    """
    place = {slot: i for i, slot in enumerate(slots)}
    return [place.get(born_from[slot], -1) for slot in slots]


def add_siblings(q: list[int], elders: Sequence[int]) -> None:
    """`add_siblings` of 7.1, in place."""
    for i, elder in enumerate(elders):
        if elder >= 0:
            total, difference = q[elder], q[i]
            q[i], q[elder] = total - difference, total + difference
            require(within((q[i], q[elder]), -(1 << 28), 1 << 28), "E_RANGE")  # R-7.1-2


def deltas(q: Numbers, quantiser: tuple[int, int]) -> Numbers:
    """`delta_of` for the numbers of a channel."""
    if q is None:
        return None
    m, e = quantiser
    most = ((1 << 28) >> e) // m
    require(within(q, -most, most), "E_RANGE")  # R-7.3-1
    return [v * (m << e) for v in q]


def read_deltas(
    lists: list[Stored],
    classes: Sequence[int],
    ycocg: bool,
    quantisers: list[tuple[int, int]],
    elders: Sequence[int] | None = None,
) -> list[Numbers]:
    """Give Delta of psi, adds or entries of channels of these classes (7.1, 7.3).

    elders is given for psi alone.
    """
    q = [of.numbers(elders is not None) for of in lists]
    if ycocg:
        for i in range(sum(c < 4 for c in classes), len(q), 3):
            q[i : i + 3] = inverse_ycocg(q[i : i + 3], lists[i].n)
    for of, values in zip(lists, q, strict=True):
        if of.code & 64 and values is not None and elders is not None:
            add_siblings(values, elders)
    return [deltas(v, quantisers[c]) for v, c in zip(q, classes, strict=True)]


def read_records(lists: list[Stored], row: Row, stream: Stream, tile: Tile) -> Step:
    """Slots, kinds and alpha of a core packet (7.2)."""
    slots = [s - 1 for s in accumulate(gap + 1 for gap in lists[0].integers())]
    require(not slots or slots[-1] < len(tile.live), "E_SLOT")  # R-7.2-1
    require(all(tile.live[s] for s in slots), "E_SLOT")  # R-7.2-1
    by_kind = [row.n_refines, row.n_splits, row.n_drops]
    kinds = lists[1].integers()
    if lists[1].n == 0:
        kinds = [next((k for k in range(3) if by_kind[k]), 0)] * len(slots)
    require([kinds.count(k) for k in range(3)] == by_kind, "E_KIND")  # R-7.2-2
    alpha = []
    for group in range(5):
        k, table = stream.alpha.get((row.level, group), (0, (1,)))
        indices = lists[2 + group].integers()
        require(within(indices, 0, len(table) - 1), "E_INDEX")  # R-7.2-3
        alpha.append((k, [table[i] for i in indices]))
    moved = [(s, kind) for s, kind in zip(slots, kinds, strict=True) if kind < 2]
    split_at = [i for i, (_, kind) in enumerate(moved) if kind == 1]
    dropped = [s for s, kind in zip(slots, kinds, strict=True) if kind == 2]
    return Step([s for s, _ in moved], split_at, dropped, alpha, row.n_adds)


def apply_channel(x: array[int], step: Step, psi: Numbers, group: int, adds: Numbers) -> None:
    """`apply_channel` of 7.4; psi and adds are Delta."""
    before = [x[s] for s in step.changed]
    seconds = [before[i] for i in step.split_at]
    if psi is not None:
        k, numerators = step.alpha[group]
        half = (1 << k) >> 1
        products = [a * psi[i] for i, a in zip(step.split_at, numerators, strict=True)]
        require(within(products, half - (1 << 30), (1 << 30) - half), "E_RANGE")  # R-7.3-2
        seconds = [p - ((v + half) >> k) for p, v in zip(seconds, products, strict=True)]
        firsts = [p + delta for p, delta in zip(before, psi, strict=True)]
        require(within(firsts + seconds, -BOUND, BOUND), "E_RANGE")  # R-7.3-3
        for slot, value in zip(step.changed, firsts, strict=True):
            x[slot] = value
    for slot in step.dropped:
        x[slot] = 0
    x.extend(seconds)
    x.extend([0] * step.n_adds if adds is None else adds)  # within 2^28: R-7.3-3


def apply_picks(
    picks: list[int] | None,
    of_changed: bool,
    n_entries: int,
    step: Step,
    stream: Stream,
    tile: Tile,
) -> None:
    """`picks_step` of 12.5; without bytes there are no picks."""
    require(within(picks or [], 0, n_entries), "E_INDEX")  # R-7.2-4
    changed = step.changed if of_changed else []
    for x, entries in zip(tile.x[4], stream.palette, strict=True):
        if picks is None:
            picked = [x[step.changed[i]] for i in step.split_at] + [0] * step.n_adds
        else:
            picked = [entries[pick - 1] if pick > 0 else 0 for pick in picks]
        for slot, value in zip(changed, picked, strict=False):
            x[slot] = value
        for slot in step.dropped:
            x[slot] = 0
        x.extend(picked[len(changed) :])


def apply_packet(data: memoryview, row: Row, stream: Stream, tile: Tile) -> None:
    """Apply a packet: 6.1 step 4 from the crc on, and its effect on the state (7.4)."""
    flags, lists = read_packet(data, row, stream)
    if row.holds == "entries":
        classes = ENTRY_CLASSES[: len(lists)]
        entries = read_deltas(lists, classes, flags & 2 > 0, stream.quantisers[0])
        for of_channel, more in zip(stream.palette, entries, strict=True):
            of_channel.extend([0] * row.n_adds if more is None else more)  # R-7.3-3 as for adds
        return
    if row.holds == "core":
        tile.steps[row.step] = read_records(lists, row, stream, tile)
    step = tile.steps[row.step]
    if row.holds == "picks":
        picks = lists[0].integers() if row.size > 0 else None
        apply_picks(picks, flags & 4 > 0, row.n_entries, step, stream, tile)
        return
    n = len(tile.x[row.component])
    classes = CORE_CLASSES if row.holds == "core" else (4 + row.component,) * n
    of_level, of_adds = stream.quantisers[1 + row.level], stream.quantisers[0]
    elders = find_elders(step.changed, tile.born_from)
    psis = read_deltas(lists[-2 * n : -n], classes, flags & 1 > 0, of_level, elders)
    adds = read_deltas(lists[-n:], classes, flags & 2 > 0, of_adds)
    for x, c, psi, added in zip(tile.x[row.component], classes, psis, adds, strict=True):
        apply_channel(x, step, psi, min(c, 4), added)
    if row.holds == "core":
        for slot in step.dropped:
            tile.live[slot] = 0
        n_before = len(tile.live)
        tile.live += b"\1" * (len(step.split_at) + step.n_adds)
        tile.born_from.extend([step.changed[i] for i in step.split_at] + [-1] * step.n_adds)
        for x, low, high in zip(tile.x[0], tile.row[3:6], tile.row[6:], strict=False):
            placed = [x[s] for s in step.changed] + x[n_before:].tolist()
            require(within(placed, low, high), "E_RANGE")  # R-7.3-4
        step.alpha[:4] = [(0, [])] * 4  # only that of SH is needed again


# 6: the order of checks, cuts
def choose(source: Source, stream: Stream, level: int | None, progressive: bool) -> list[Row]:
    """Give the packets of the cut; progressively, of the largest cut that came whole.

    A packet with a fault counts as one that did not come (R-6.4-5).
    """
    faulty = {start for _, start in stream.faults}
    cut: list[Row] = []
    taken: set[tuple[int, int, int]] = set()
    lacking = stream.n_levels  # the level of the first packet of the palette so far not taken
    for row in stream.rows:
        if level is not None and row.level > level:
            continue  # not asked for: R-6.2-3
        tile, component, step = row[:3]
        ready = step == 0 or (tile, component, step - 1) in taken
        ready = ready and (row.holds in ("core", "entries") or (tile, 0, step) in taken)
        ready = ready and (row.holds != "picks" or row.level < lacking)  # 12.2
        ready = ready and (row.size == 0 or row.start not in faulty)
        if not progressive or (ready and source.has(row.start, row.size)):  # R-6.4-1, R-6.4-3
            taken.add(row[:3])
            cut.append(row)
        else:
            lacking = min(lacking, row.level) if row.holds == "entries" else lacking
            stream.missing = row.start if stream.missing is None else stream.missing
    return cut


def apply_cut(source: Source, stream: Stream, cut: list[Row], verify: bool) -> bool:
    """Apply packets to an empty state; tell whether digests, if they are checked, are kept."""
    stream.states.clear()
    for entries in stream.palette:
        del entries[:]
    of_tiles = [row for row in cut if row.holds != "entries"]
    last = {(row.tile, row.step): row for row in of_tiles}  # that need the records of a step
    digests_kept = True
    for row in cut:
        source.at = row.start
        require(source.has(row.start, row.size), "E_TRUNCATED")  # R-6.2-2
        if row.tile not in stream.states:
            stream.states[row.tile] = Tile(stream.tiles[row.tile], stream.widths)
        tile = stream.states[row.tile]
        apply_packet(source.data[row.start : row.start + row.size], row, stream, tile)
        if last.get((row.tile, row.step)) is row:
            del tile.steps[row.step]
        digest = stream.digests.get(row[:3])
        if verify and digest is not None:
            digests_kept &= hashlib.sha256(state(row, stream, tile)).digest() == digest
    return digests_kept


def decode(
    source: Source, own: Limits, level: int | None, verify: bool, progressive: bool
) -> Stream:
    """Decode a cut in the order of 6.1; progressively, as much of it as came (6.4).

    Progressively, faults but those of header and chunks are kept beside the state: after that of a
    packet, decoding begins anew without it.
    """
    stream = read_header(source, own)
    read_chunks(source, stream)
    if level is not None and not 0 <= level < stream.n_levels:
        raise ValueError(f"the stream has no level {level}")  # the mistake of a caller: 3.6
    while True:
        cut = choose(source, stream, level, progressive)
        try:
            digests_kept = apply_cut(source, stream, cut, verify)
            break
        except FaultError as fault:
            if not progressive:
                raise
            stream.faults.append((str(fault), source.at))
    try:
        source.at = 64 + stream.chunks_size + stream.data_size
        require(source.there.find(1, source.at) < 0, "E_TRAILING")  # R-6.2-1
        source.at = stream.chunks[b"dGST"][0] if not digests_kept else source.at
        require(digests_kept, "E_DIGEST")  # R-5.7-3, R-5.7-4
    except FaultError as fault:
        if not progressive:
            raise
        stream.faults.append((str(fault), source.at))
    return stream


def write_dump(stream: Stream, out: BinaryIO) -> None:
    """Write the dump of what was decoded."""
    fields = (b"EVGD", 1, stream.sh_degree, stream.grid_exponents, 0, stream.n_tiles)
    out.write(struct.pack("<4sBB5sBI", *fields))
    for i, row in enumerate(stream.tiles):
        tile = stream.states.get(i) or Tile(row, stream.widths)
        live, born_from = tile.live, tile.born_from
        out.write(struct.pack("<3qI", *row[:3], len(live)) + live)
        for channels in tile.x.values():
            shown = list(range(len(live)))  # the slot whose numbers a slot shows, -1 for 0
            for u in range(len(channels[0]), len(live)):  # born from a lower slot: shown is known
                shown[u] = shown[born_from[u]] if born_from[u] >= 0 else -1
            for x in channels:
                pairs = zip(shown, live, strict=True)
                out.write(s32([x[s] if s >= 0 and on else 0 for s, on in pairs]))


def perform(request: Mapping[str, Any]) -> dict[str, Any]:
    """Carry out a request of --batch or of the command line; give exit, code and offset."""
    out = Path(request["out"])
    out.unlink(missing_ok=True)
    progressive = request.get("mode") == "progressive"
    own = json.loads(Path(request["limits"]).read_bytes()) if request.get("limits") else {}
    ranges = json.loads(Path(request["arrival"]).read_bytes()) if request.get("arrival") else None
    source = Source(Path(request["in"]).read_bytes(), ranges if progressive else None)
    try:
        stream = decode(source, own, request.get("level"), bool(request.get("verify")), progressive)
    except FaultError as fault:
        exits = {"E_UNSUPPORTED": 127, "E_LIMIT": 4, "E_TRUNCATED": 3 if progressive else 1}
        return {"exit": exits.get(str(fault), 1), "code": str(fault), "offset": source.at}
    if not stream.faults or request.get("dump_on_fault"):
        with out.open("wb") as file:
            write_dump(stream, file)
    if stream.faults:
        code, offset = stream.faults[0]
        return {"exit": 1, "code": code, "offset": offset}
    partial = {"exit": 3, "code": "E_TRUNCATED", "offset": stream.missing}
    return {"exit": 0} if stream.missing is None else partial


def attempt(line: str) -> dict[str, Any]:
    """Answer a request in JSON; exit 2 stands for a mistake of the caller or a failure of ours."""
    request: dict[str, Any] = {}
    try:
        request = json.loads(line)
        answer = perform(request)
    except Exception:  # whatever it is, the caller gets an answer, and the trace on standard error
        traceback.print_exc()
        answer = {"exit": 2}
    return {"id": request.get("id"), **answer}


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="Decodes an EvoGS stream to a dump.")
    for name in ("--in", "--out", "--limits", "--arrival"):
        parser.add_argument(name, metavar="FILE")
    for name in ("--verify", "--dump-on-fault", "--capabilities", "--batch"):
        parser.add_argument(name, action="store_true")
    parser.add_argument("--mode", choices=("file", "progressive"), default="file")
    parser.add_argument("--level", type=int, metavar="K")
    request = vars(parser.parse_args())
    if request["capabilities"]:
        able = dict.fromkeys(("codes", "verify", "limits", "arrival", "batch"), True)
        able["dump_on_fault"] = True
        most = {"modes": ["file", "progressive"], "max_tier": 3, "max_sh_degree": 3}
        print(json.dumps({"name": "cleanroom", "version": "1.0", **able, **most}))
        return 0
    if request["batch"]:
        for line in filter(str.strip, sys.stdin):
            print(json.dumps(attempt(line)), flush=True)
        return 0
    answer = attempt(json.dumps(request))
    if "code" in answer:
        print(json.dumps({"code": answer["code"], "offset": answer["offset"]}))
    return int(answer["exit"])


if __name__ == "__main__":
    sys.exit(main())
