"""Streams that are there already: where things are, and how to change them."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

__all__ = [
    "CHUNK_HEADER_SIZE",
    "HEADER_SIZE",
    "ROW_CRC_AT",
    "ROW_SIZE",
    "ROW_SIZE_AT",
    "Places",
    "patched",
    "places",
    "repaired",
]

HEADER_SIZE, CHUNK_HEADER_SIZE, ROW_SIZE = 64, 12, 36
ROW_SIZE_AT, ROW_CRC_AT = 8, 32


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
