"""A writer of streams for vectors: everything can be said, also what is wrong.

A stream is described by plain values; sizes, counts, checksums and digests are worked out unless
they are overridden. It knows the bytes of spec 5, not what is legal, and it shares no code with the
codec. Frames are made of raw and run-length blocks by hand, so that bytes do not depend on a
library; `compressed` is the exception.

    build(Stream([Packet(adds={X: [5, -3]}), Packet(records={0: SPLIT}, psi={X: 2})]))
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import groupby

import zstandard

__all__ = [
    "DROP",
    "MAX_X",
    "REFINE",
    "SPLIT",
    "Chunk",
    "Packet",
    "Places",
    "Stream",
    "Tile",
    "build",
    "compressed",
    "frame",
    "patched",
    "places",
    "raw",
    "repaired",
    "runs",
]

REFINE, SPLIT, DROP = range(3)
X, Y, Z, W, OPACITY, RED, GREEN, BLUE = 0, 1, 2, 3, 10, 11, 12, 13  # channels of core
MAX_X = (1 << 30) - 1
SIGNATURE = b"\x89EVG\r\n\x1a\n"
N_CORE, N_GROUPS = 14, 5
PSI_YCOCG, ADDS_YCOCG = 1, 2
DELTA = 64  # bit of a coding byte

Fields = tuple[tuple[str, str], ...]
Values = Mapping[int, Sequence[int] | int]  # by channel of the component; a number for all
FrameStyle = Callable[[bytes], bytes]

HEADER: Fields = (
    *(("signature", "8s"), ("version_major", "B"), ("version_minor", "B"), ("tier", "B")),
    *(("sh_degree", "B"), ("n_levels", "B"), ("grid_exponents", "5s"), ("flags", "H")),
    *(("coordinate_system", "B"), ("up_axis", "B"), ("unit", "B"), ("colour_space", "B")),
    *(("n_tiles", "I"), ("n_packets", "I"), ("chunks_size", "I"), ("data_size", "Q")),
    *(("reserved", "16s"), ("crc", "I")),
)
ROW: Fields = (
    *(("tile", "I"), ("component", "B"), ("level", "B"), ("reserved", "H"), ("size", "I")),
    *(("n_adds", "I"), ("n_splits", "I"), ("n_refines", "I"), ("n_drops", "I")),
    *(("error", "I"), ("crc", "I")),
)
HEADER_SIZE, CHUNK_HEADER_SIZE, ROW_SIZE = 64, 12, 36
ROW_SIZE_AT, ROW_CRC_AT = 8, 32


# ---- frames (spec 5.10, RFC 8878) ----

RAW, RLE, COMPRESSED, RESERVED = range(4)
MAX_BLOCK = 128 << 10
Block = tuple[int, int, bytes]  # type, Block_Size, content


def frame(
    size: int,
    blocks: Iterable[Block],
    *,
    width: int | None = None,
    magic: bytes = b"\x28\xb5\x2f\xfd",
    descriptor: int = 0x20,
) -> bytes:
    """A frame of exactly these blocks; `width` is the bytes of Frame_Content_Size.

    `descriptor` is the Frame_Header_Descriptor without its two highest bits.
    """
    if width is None:
        width = 1 if size < 256 else 2 if size < 65536 + 256 else 4
    stated = size - 256 if width == 2 else size
    out = magic + bytes([descriptor | {1: 0, 2: 1, 4: 2, 8: 3}[width] << 6])
    out += stated.to_bytes(width, "little")
    blocks = list(blocks)
    for k, (kind, block_size, content) in enumerate(blocks):
        last = k == len(blocks) - 1
        out += (last | kind << 1 | block_size << 3).to_bytes(3, "little") + content
    return out


def raw(content: bytes, block: int = MAX_BLOCK, width: int | None = None) -> bytes:
    """A frame of raw blocks of `block` bytes."""
    pieces = [content[at : at + block] for at in range(0, len(content), block)]
    return frame(len(content), [(RAW, len(p), p) for p in pieces], width=width)


def runs(content: bytes) -> bytes:
    """A frame with a run-length block for each run."""
    blocks: list[Block] = []
    for byte, same in groupby(content):
        left = len(list(same))
        while left:
            blocks.append((RLE, min(left, MAX_BLOCK), bytes([byte])))
            left -= blocks[-1][1]
    return frame(len(content), blocks)


def compressed(level: int) -> FrameStyle:
    """Frames by libzstd at a level."""
    compressor = zstandard.ZstdCompressor(
        level=level, write_content_size=True, write_checksum=False, write_dict_id=False
    )
    return lambda content: bytes(compressor.compress(content))


# ---- what a stream says ----


@dataclass(frozen=True)
class Tile:
    """A row of the tile table."""

    origin: tuple[int, int, int] = (0, 0, 0)
    low: tuple[int, int, int] = (-MAX_X,) * 3
    high: tuple[int, int, int] = (MAX_X,) * 3


@dataclass(frozen=True)
class Packet:
    """A packet and its row.

    Attributes:
        adds, psi: q by channel of the component; a channel that is not named has coding byte 0.
        records: kind by slot; n_splits and the like follow.
        alpha: indices by group, one per split.
        n_adds: by default, as many as the longest list of adds.
        flags: of the packet header.
        codings: coding byte by name of the list ("gaps", "kinds", "alpha 3", "psi 0", "adds 13");
            by default the smallest of a few.
        stored: integers by name of the list, instead of what follows from the above.
        frames: planes of each frame; by default all in one.
        style: makes each frame of its content.
        is_explicit: a packet of a band is written although all its integers are 0.
        coding_bytes: written instead of the coding bytes that the planes have.
        entries: changes the frame entries (n_planes, size).
        edit: changes the bytes at the end, before the checksum.
        row: fields of the row that are overridden.
    """

    adds: Values = field(default_factory=dict)
    records: Mapping[int, int] = field(default_factory=dict)
    psi: Values = field(default_factory=dict)
    alpha: Mapping[int, Sequence[int]] = field(default_factory=dict)
    tile: int = 0
    component: int = 0
    level: int = 0
    n_adds: int | None = None
    flags: int = 0
    codings: Mapping[str, int] = field(default_factory=dict)
    stored: Mapping[str, Sequence[int]] = field(default_factory=dict)
    frames: Sequence[int] | None = None
    style: FrameStyle = raw
    is_explicit: bool = False
    coding_bytes: Mapping[str, int] = field(default_factory=dict)
    entries: Callable[[list[tuple[int, int]]], list[tuple[int, int]]] = list
    edit: Callable[[bytes], bytes] = bytes
    row: Mapping[str, int] = field(default_factory=dict)

    @property
    def counts(self) -> dict[str, int]:
        """The four counts of a core packet."""
        kinds = list(self.records.values())
        lengths = [len(q) for q in self.adds.values() if not isinstance(q, int)]
        n_adds = max(lengths, default=0) if self.n_adds is None else self.n_adds
        numbers = (n_adds, kinds.count(SPLIT), kinds.count(REFINE), kinds.count(DROP))
        return dict(zip(("n_adds", "n_splits", "n_refines", "n_drops"), numbers, strict=True))


@dataclass(frozen=True)
class Chunk:
    """A chunk; `size` and `crc` follow from the body unless given."""

    kind: bytes
    body: bytes = b""
    size: int | None = None
    crc: int | None = None

    def __bytes__(self) -> bytes:
        size = len(self.body) if self.size is None else self.size
        head = self.kind + struct.pack("<I", size)
        crc = zlib.crc32(head + self.body) if self.crc is None else self.crc
        return head + struct.pack("<I", crc) + self.body


@dataclass(frozen=True)
class Stream:
    """A stream.

    Attributes:
        packets: in the order of the file.
        degree: of SH.
        n_levels: labels that steps may have.
        tiles: by default one, as large as may be.
        quantisers: (M, E) by (row of STEP, class); (1, 0) elsewhere.
        alphas: (K, entries) by (level, group); None: no ALFA.
        digests: (tile, component, step): the digest, or None for the right one.
        metadata: of mETa, keys in the order given; values are text or bytes; None: no mETa.
        header: fields that are overridden.
        chunks: changes the list of chunks.
        tail: bytes after the packets.
    """

    packets: Sequence[Packet] = ()
    degree: int = 0
    n_levels: int = 1
    tiles: Sequence[Tile] = (Tile(),)
    quantisers: Mapping[tuple[int, int], tuple[int, int]] = field(default_factory=dict)
    alphas: Mapping[tuple[int, int], tuple[int, Sequence[int]]] | None = None
    digests: Mapping[tuple[int, int, int], bytes | None] | None = None
    metadata: Mapping[str | bytes, str | bytes] | None = None
    header: Mapping[str, int | bytes] = field(default_factory=dict)
    grid: tuple[int, int, int, int, int] = (10, 6, 5, 5, 7)
    tier: int = 1
    chunks: Callable[[list[Chunk]], list[Chunk]] = list
    tail: bytes = b""


def build(stream: Stream) -> bytes:
    """The bytes of a stream."""
    bodies, rows = _packets(stream)
    chunks = [
        Chunk(b"STEP", _step_table(stream)),
        Chunk(b"TILE", b"".join(map(_tile_row, stream.tiles))),
        Chunk(b"PACK", b"".join(rows)),
    ]
    if stream.alphas is not None:
        chunks.insert(1, Chunk(b"ALFA", _alpha_tables(stream)))
    if stream.metadata is not None:
        chunks.append(Chunk(b"mETa", b"".join(map(_meta_entry, stream.metadata.items()))))
    if stream.digests is not None:
        rights = _digests(stream, chunks, b"".join(bodies))
        table = b"".join(
            struct.pack("<IBI", tile, component, step)
            + (digest or rights.get((tile, component, step), bytes(32)))
            for (tile, component, step), digest in stream.digests.items()
        )
        chunks.append(Chunk(b"dGST", table))
    return _file(stream, stream.chunks(chunks), b"".join(bodies)) + stream.tail


def _file(stream: Stream, chunks: Iterable[Chunk], data: bytes) -> bytes:
    area = b"".join(map(bytes, chunks))
    fields: dict[str, int | bytes] = {
        "signature": SIGNATURE,
        "version_major": 1,
        "tier": stream.tier,
        "sh_degree": stream.degree,
        "n_levels": stream.n_levels,
        "grid_exponents": struct.pack("<5b", *stream.grid),
        "n_tiles": len(stream.tiles),
        "n_packets": len(stream.packets),
        "chunks_size": len(area),
        "data_size": len(data),
        "reserved": bytes(16),
        **stream.header,
    }
    head = _pack(HEADER[:-1], fields)
    return head + struct.pack("<I", _number(fields.get("crc", zlib.crc32(head)))) + area + data


def _pack(layout: Fields, fields: Mapping[str, int | bytes]) -> bytes:
    values = [fields.get(name, 0) for name, _ in layout]
    return struct.pack("<" + "".join(code for _, code in layout), *values)


def _number(value: int | bytes) -> int:
    assert isinstance(value, int)
    return value


def _step_table(stream: Stream) -> bytes:
    places_ = [(row, c) for row in range(1 + stream.n_levels) for c in range(5 + stream.degree)]
    return b"".join(struct.pack("<HB", *stream.quantisers.get(at, (1, 0))) for at in places_)


def _alpha_tables(stream: Stream) -> bytes:
    return b"".join(
        struct.pack(f"<4B{len(entries)}h", level, group, k, len(entries) - 1, *entries)
        for (level, group), (k, entries) in (stream.alphas or {}).items()
    )


def _tile_row(tile: Tile) -> bytes:
    return struct.pack("<3q6i", *tile.origin, *tile.low, *tile.high)


def _meta_entry(entry: tuple[str | bytes, str | bytes]) -> bytes:
    key, value = (text.encode() if isinstance(text, str) else text for text in entry)
    return struct.pack("<BH", len(key), len(value)) + key + value


def _digests(
    stream: Stream, chunks: Iterable[Chunk], data: bytes
) -> dict[tuple[int, int, int], bytes]:
    """The right digests of the packets before the first fault, by the oracle.

    The codec must confirm them when goldens are made.
    """
    from conformance import oracle

    found: dict[tuple[int, int, int], bytes] = {}

    def note(tile: int, step: int, component: int, state: bytes) -> None:
        found[tile, component, step] = hashlib.sha256(state).digest()

    if None in (stream.digests or {}).values():
        with suppress(oracle.Reject):
            oracle.decode(_file(replace(stream, header={}), chunks, data), trace=note)
    return found


# ---- packets (spec 5.6, 5.9) ----


def _packets(stream: Stream) -> tuple[list[bytes], list[bytes]]:
    """Bodies and rows."""
    bodies, rows = list[bytes](), list[bytes]()
    chains: dict[tuple[int, int], list[Packet]] = {}
    for packet in stream.packets:
        chain = chains.setdefault((packet.tile, packet.component), [])
        cores = chains.get((packet.tile, 0), [])
        # A band packet without its core, which is a fault, has no records.
        core = packet if packet.component == 0 else Packet()
        if packet.component > 0 and len(chain) < len(cores):
            core = cores[len(chain)]
        chain.append(packet)
        body = packet.edit(packet_body(packet, core.counts))
        bodies.append(body)
        fields = {"tile": packet.tile, "component": packet.component, "level": packet.level}
        fields |= packet.counts if packet.component == 0 else {}
        fields |= {"size": len(body), "error": 0xFFFFFFFF, "crc": zlib.crc32(body)}
        rows.append(_pack(ROW, fields | dict(packet.row)))
    return bodies, rows


def packet_body(packet: Packet, counts: Mapping[str, int]) -> bytes:
    """The bytes of a packet of a step with these counts."""
    if not packet.is_explicit and not packet.stored and not packet.psi and not packet.adds:
        is_zero = packet.component > 0 and not packet.coding_bytes
        if is_zero or not any(counts.values()):
            return b""
    lists = _lists(packet, counts)
    codings, planes = list[int](), list[bytes]()
    for name, values in lists.items():
        coding = packet.codings.get(name, coding_for(values))
        planes += planes_of(values, coding)
        codings.append(packet.coding_bytes.get(name, coding))
    partition = packet.frames if packet.frames is not None else [len(planes)] if planes else []
    frames, entries, rest = list[bytes](), list[tuple[int, int]](), list(planes)
    for n_planes in partition:
        frames.append(packet.style(b"".join(rest[:n_planes])))
        entries.append((n_planes, len(frames[-1])))
        del rest[:n_planes]
    entries = packet.entries(entries)
    table = b"".join(struct.pack("<BI", *entry) for entry in entries)
    return bytes([packet.flags, len(entries), *codings]) + table + b"".join(frames)


def _lists(packet: Packet, counts: Mapping[str, int]) -> dict[str, list[int]]:
    """The stored integers of each list, in the order of the coding bytes."""
    slots, lists = sorted(packet.records), dict[str, list[int]]()
    n_psi = counts["n_splits"] + counts["n_refines"]
    n_channels = N_CORE if packet.component == 0 else 3 * (2 * packet.component + 1)
    if packet.component == 0:
        kinds = [packet.records[slot] for slot in slots]
        lists["gaps"] = [b - a - 1 for a, b in zip([-1, *slots], slots, strict=False)]
        lists["kinds"] = kinds if len(set(kinds)) > 1 else []
        for group in range(N_GROUPS):
            lists[f"alpha {group}"] = list(packet.alpha.get(group, ()))
    for kind, values, n in (("psi", packet.psi, n_psi), ("adds", packet.adds, counts["n_adds"])):
        for channel in range(n_channels):
            q = values.get(channel, ())
            name = f"{kind} {channel}"
            qs = [q] * n if isinstance(q, int) else list(q)
            if kind == "adds" and packet.codings.get(name, 0) & DELTA:
                qs = [b - a for a, b in zip([0, *qs], qs, strict=False)]
            lists[name] = [zigzag(q) for q in qs]
    for name, stored in packet.stored.items():
        assert name in lists
        lists[name] = list(stored)
    return lists


def zigzag(q: int) -> int:
    """0, -1, 1, -2 ... become 0, 1, 2, 3 ..."""
    return 2 * q if q >= 0 else -2 * q - 1


def coding_for(values: Sequence[int]) -> int:
    """A coding byte that holds these integers."""
    bits = max(values, default=0).bit_length()
    if bits == 0:
        return 0
    low = next(width for width in (1, 2, 4, 8) if min(bits, 8) <= width)
    return low | max(0, (bits - 1) // 8) << 4


def planes_of(values: Sequence[int], coding: int) -> list[bytes]:
    """The planes of a list; none if the list is empty."""
    low, high = coding & 15, coding >> 4 & 3
    if not values:
        return []
    assert max(values) < 1 << (low + 8 * high), "the coding holds no such integers"
    planes = []
    if low in (1, 2, 4):
        packed = sum((v & ((1 << low) - 1)) << (low * i) for i, v in enumerate(values))
        planes.append(packed.to_bytes((len(values) * low + 7) // 8, "little"))
    elif low:
        planes.append(bytes(v & ((1 << low) - 1) for v in values))
    return planes + [bytes(v >> (low + 8 * k) & 255 for v in values) for k in range(high)]


# ---- streams that are there already ----


@dataclass(frozen=True)
class Places:
    """Offsets in a file: chunks by type, and the begin and end of each packet, in order."""

    chunks: dict[bytes, int]
    packets: list[tuple[int, int]]


def places(data: bytes) -> Places:
    """Where things are, as far as the structure can be made out."""
    chunks, packets = dict[bytes, int](), list[tuple[int, int]]()
    end = HEADER_SIZE + int.from_bytes(data[32:36], "little")
    at, start = HEADER_SIZE, end
    while at + CHUNK_HEADER_SIZE <= min(end, len(data)):
        kind, size = struct.unpack_from("<4sI", data, at)
        begin = at + CHUNK_HEADER_SIZE
        if begin + size > min(end, len(data)):
            break
        chunks[kind] = at
        if kind == b"PACK":
            for row in range(begin, begin + size - ROW_SIZE + 1, ROW_SIZE):
                (n,) = struct.unpack_from("<I", data, row + ROW_SIZE_AT)
                packets.append((start, start + n))
                start += n
        at = begin + size
    return Places(chunks, packets)


def patched(data: bytes, at: int, new: bytes) -> bytes:
    """The bytes with some replaced; no checksum is repaired."""
    assert at + len(new) <= len(data)
    return data[:at] + new + data[at + len(new) :]


def repaired(data: bytes) -> bytes:
    """The bytes with every checksum right, as far as the structure can be made out."""
    out = bytearray(data)
    if len(out) < HEADER_SIZE:
        return data
    found = places(data)
    for kind, at in found.chunks.items():
        begin = at + CHUNK_HEADER_SIZE
        size = int.from_bytes(out[at + 4 : at + 8], "little")
        if kind == b"PACK":
            for k, (start, end) in enumerate(found.packets):
                crc = zlib.crc32(out[start:end])
                struct.pack_into("<I", out, begin + k * ROW_SIZE + ROW_CRC_AT, crc)
        crc = zlib.crc32(out[begin : begin + size], zlib.crc32(out[at : at + 8]))
        struct.pack_into("<I", out, at + 8, crc)
    struct.pack_into("<I", out, 60, zlib.crc32(out[:60]))
    return bytes(out)
