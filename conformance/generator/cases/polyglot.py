"""Files that are something else too, or were when they left."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import Chunk, build
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import SMALL

FAMILY = "polyglot"
TWIN = "core-kinds-of-one-step"


def appended() -> Iterator[Case]:
    """Something behind a stream."""
    data = build(SMALL)
    rows = [
        ("zip", stored_zip(b"hello", len(data)), "a zip archive, which readers find from the end"),
        ("itself", data, "the same stream again"),
        ("zeros", bytes(512 - len(data) % 512), "zeros up to a block of 512 bytes"),
        ("line-feed", b"\n", "a line feed, as editors put at the end of a file"),
    ]
    for name, tail, tests in rows:
        yield case(
            f"{name}-behind",
            data + tail,
            "R-6.2-1 6.2",
            f"behind the last packet stands {tests}",
            "reads as far as it needs, so that the file is two things",
            "E_TRAILING",
            TWIN,
            runs=(FILE, PROGRESSIVE),
        )
    inside = replace(SMALL, chunks=lambda c: [Chunk(b"zzZz", stored_zip(b"hello", 76)), *c])
    yield case(
        "zip-in-a-chunk",
        inside,
        "R-8.1-2 R-6.2-1 8.1",
        "a zip archive in an unknown chunk; no reader finds it from the end of the file",
        "looks into unknown chunks",
        runs=(FILE,),
    )


def prepended() -> Iterator[Case]:
    """Something before a stream, or around it."""
    data = build(SMALL)
    rows = [
        ("zip-before", stored_zip(data, 0), "a zip archive that holds the stream uncompressed"),
        ("byte-order-mark", b"\xef\xbb\xbf" + data, "a byte order mark before the stream"),
        ("gzip", stored_gzip(data), "the stream in gzip, as a server may send it"),
        ("html-page", b"<!DOCTYPE html><title>404</title>", "a page that says 404"),
    ]
    for name, bytes_, tests in rows:
        yield case(
            name,
            bytes_,
            "R-5.1-1 5.1",
            tests,
            "searches for a signature, or unwraps what it was not asked to",
            "E_SIGNATURE",
            TWIN,
            runs=(FILE, PROGRESSIVE),
        )


def mangled() -> Iterator[Case]:
    """Streams that were sent as text."""
    data = build(SMALL)
    rows = [
        ("crlf-to-lf", data.replace(b"\r\n", b"\n"), "CR LF became LF", "E_SIGNATURE"),
        ("lf-to-crlf", data.replace(b"\n", b"\r\n"), "LF became CR LF", "E_SIGNATURE"),
        (
            "seven-bits",
            bytes(byte & 127 for byte in data),
            "the highest bits are gone",
            "E_SIGNATURE",
        ),
        ("cut-at-zero", data[: data.index(0)], "the file ends at its first byte 0", "E_TRUNCATED"),
        ("cut-at-1a", data[:6], "the file ends at its byte 1A", "E_TRUNCATED"),
    ]
    for name, bytes_, tests, code in rows:
        yield case(
            f"text-{name}",
            bytes_,
            "R-5.1-1" if code == "E_SIGNATURE" else "R-6.2-2 6.2",
            f"sent as text: {tests}",
            "compares fewer bytes of the signature",
            code,
            TWIN,
        )
    lost = data.index(b"\0\0\0")
    yield case(
        "byte-lost",
        data[:lost] + data[lost + 1 :],
        "R-6.3-1 6.3",
        "a byte of the header was lost",
        "does not notice that all fields moved",
        "E_CRC",
        TWIN,
    )
    other = build(replace(SMALL, packets=SMALL.packets[::-1][1:]))
    yield case(
        "head-of-another-file",
        other[:64] + data[64:],
        "R-6.1-1 6.1",
        "the header of one stream before the chunks of another",
        "takes sizes from the header and contents from wherever they fall",
        "E_CHUNK",
        TWIN,
    )


def swapped(data: bytes) -> bytes:
    """Bytes exchanged in pairs."""
    even = data[: len(data) // 2 * 2]
    return bytes(byte for at in range(0, len(even), 2) for byte in (even[at + 1], even[at]))


def stored_zip(content: bytes, at: int) -> bytes:
    """A zip archive of one file, uncompressed, that begins at this offset."""
    name, crc, size = b"a.evogs", zlib.crc32(content), len(content)
    fields = struct.pack("<HHHHHIIIHH", 20, 0, 0, 0, 33, crc, size, size, len(name), 0)
    local = b"PK\3\4" + fields + name + content
    entry = (
        b"PK\1\2" + struct.pack("<H", 20) + fields + struct.pack("<HHHII", 0, 0, 0, 0, at) + name
    )
    end = struct.pack("<HHHHIIH", 0, 0, 1, 1, len(entry), at + len(local), 0)
    return local + entry + b"PK\5\6" + end


def png() -> bytes:
    """A picture of one grey pixel."""

    def part(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = part(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0))
    pixels = part(b"IDAT", b"\x78\x01\x01\x02\x00\xfd\xff\x00\x80\x00\x82\x00\x81")
    return b"\x89PNG\r\n\x1a\n" + header + pixels + part(b"IEND", b"")


def stored_gzip(content: bytes) -> bytes:
    """The content in gzip, in one stored block."""
    n = len(content)
    block = b"\1" + struct.pack("<HH", n, n ^ 0xFFFF) + content
    out = b"\x1f\x8b\x08" + bytes(6) + b"\xff" + block + struct.pack("<II", zlib.crc32(content), n)
    assert gzip.decompress(out) == content
    return out


RECIPES: tuple[Recipe, ...] = (appended, prepended, mangled)
