"""The bytes of streams (spec 5.1 to 5.8)."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace

from conformance.generator.builder.packets import packet_body
from conformance.generator.builder.stream import PALETTE, Chunk, Packet, Stream, Tile

__all__ = ["build"]

SIGNATURE = b"\x89EVG\r\n\x1a\n"
HAS_PALETTE = 1 << 8  # of `flags`
Fields = tuple[tuple[str, str], ...]

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


def build(stream: Stream) -> bytes:
    """The bytes of a stream."""
    bodies, rows = _packets(stream)
    chunks = [
        Chunk(b"QUAN", _quantiser_table(stream)),
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
        "flags": HAS_PALETTE if stream.has_palette else 0,
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


def _quantiser_table(stream: Stream) -> bytes:
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
    from conformance.decoders import oracle

    found: dict[tuple[int, int, int], bytes] = {}

    def note(tile: int, step: int, component: int, state: bytes) -> None:
        found[tile, component, step] = hashlib.sha256(state).digest()

    if None in (stream.digests or {}).values():
        with suppress(oracle.FaultError):
            oracle.decode(_file(replace(stream, header={}), chunks, data), trace=note)
    return found


def _packets(stream: Stream) -> tuple[list[bytes], list[bytes]]:
    """Bodies and rows."""
    bodies, rows = list[bytes](), list[bytes]()
    chains: dict[tuple[int, int], list[Packet]] = {}
    n_above = 3 * ((stream.degree + 1) ** 2 - 1)
    for packet in stream.packets:
        chain = chains.setdefault((packet.tile, packet.component), [])
        cores = chains.get((packet.tile, 0), [])
        has_counts = packet.component in (0, PALETTE)
        # A band packet without its core, which is a fault, has no records.
        core = packet if has_counts else Packet()
        if not has_counts and len(chain) < len(cores):
            core = cores[len(chain)]
        chain.append(packet)
        body = packet.edit(packet_body(packet, core.counts, n_above))
        bodies.append(body)
        fields = {"tile": packet.tile, "component": packet.component, "level": packet.level}
        fields |= packet.counts if has_counts else {}
        fields |= {"size": len(body), "error": 0xFFFFFFFF, "crc": zlib.crc32(body)}
        rows.append(_pack(ROW, fields | dict(packet.row)))
    return bodies, rows
