"""The subset of Zstandard: what a frame may be, and what only other readers of it accept."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import partial

from conformance.generator.builder import (
    COMPRESSED,
    RAW,
    RESERVED,
    RLE,
    Packet,
    Stream,
    X,
    Y,
    compressed,
    frame,
    raw,
    runs,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "zstd"
N = 12  # splats of most cases, a plane of 8 bits: the content of a frame
VALUES = [3, 3, 3, 3, 200, 5, 5, 9, 9, 9, 9, 1]
Style = Callable[[bytes], bytes]


def framed(style: Style, n: int = N) -> Stream:
    """One channel of stored integers in one frame."""
    values = VALUES if n == N else [VALUES[k * k % 11 % N] + k // 90 % 3 for k in range(n)]
    return Stream([Packet(n_adds=n, stored={"adds 0": values}, codings={"adds 0": 8}, style=style)])


def legal_blocks() -> Iterator[Case]:
    """Blocks of all kinds and sizes."""
    rows: list[tuple[str, Style, str, str]] = [
        ("raw", raw, "one raw block", "knows compressed blocks only"),
        ("raw-blocks-of-1", lambda c: raw(c, 1), "a raw block for each byte", "expects one block"),
        ("run-blocks", runs, "run-length blocks, some of one byte",
         "takes the stored byte for the size of the block"),
        ("raw-and-runs", lambda c: frame(len(c), [(RAW, 4, c[:4]), (RLE, 1, c[4:5]),
                                                  (RAW, 7, c[5:])]),
         "a run-length block between raw blocks", "keeps the kind of the first block"),
        ("empty-raw-last", lambda c: frame(len(c), [(RAW, len(c), c), (RAW, 0, b"")]),
         "an empty raw block at the end", "ends when all bytes are there and finds some left"),
        ("compressed-level-1", compressed(1), "a frame of the library at level 1",
         "knows raw blocks only"),
        ("compressed-level-19", compressed(19), "a frame of the library at level 19",
         "lacks a mode of sequences"),
    ]  # fmt: skip
    for name, style, tests, faulty in rows:
        n = 900 if name.startswith("compressed") else N
        rules = "R-5.10-1 R-5.10-2 R-5.10-5 R-5.10-6"
        yield case(name, framed(style, n), rules, tests, faulty)
    for width, n in ((1, 255), (2, 256), (4, 255), (8, 12)):
        yield case(
            f"content-size-in-{width}-bytes-of-{n}",
            framed(partial(raw, width=width), n),
            "R-5.10-3",
            f"Frame_Content_Size {n} in {width} bytes",
            "knows one width, or forgets the 256 of two bytes",
        )
    n = 3125  # 42 planes of it are 178 bytes more than 128 KiB
    codings = {f"adds {c}": 0x28 for c in range(14)}
    same_byte = {f"adds {c}": [0x070707] * n for c in range(14)}

    def uniform(size: int) -> Stream:
        def style(content: bytes) -> bytes:
            # Raw bytes behind the run, so that the packet is long enough for its adds (R-5.6-7).
            rest = content[size:]
            return frame(len(content), [(RLE, size, b"\7"), (RAW, len(rest), rest)])

        return Stream([Packet(n_adds=n, stored=same_byte, codings=codings, style=style)])

    for size, code in ((131072, None), (131073, "E_FRAME")):
        yield case(
            f"run-of-{size}",
            uniform(size),
            "R-5.10-5",
            f"a run-length block of {size} bytes; 128 KiB are allowed",
            "keeps the size of a block in 17 bits, or does not bound runs",
            code,
            None if code is None else "run-of-131072",
            runs=(FILE,),
        )


def blocks_that_give_much() -> Iterator[Case]:
    """Compressed blocks that regenerate 128 KiB, and a byte more."""
    n = 3125
    codings = {f"adds {c}": 0x28 for c in range(14)}
    same_byte = {f"adds {c}": [0x070707] * n for c in range(14)}
    for size, code in ((131072, None), (131073, "E_ZSTD")):

        def style(content: bytes, size: int = size) -> bytes:
            block, rest = _copies(content[0], size), content[size:]
            return frame(len(content), [(COMPRESSED, len(block), block), (RAW, len(rest), rest)])

        yield case(
            f"block-that-gives-{size}",
            Stream([Packet(n_adds=n, stored=same_byte, codings=codings, style=style)]),
            "R-5.10-6",
            f"a compressed block of a literal and a match that regenerate {size} bytes; 128 KiB are"
            " allowed",
            "leaves it to a library that, called once for the frame, takes it",
            code,
            None if code is None else "block-that-gives-131072",
            runs=(FILE, PROGRESSIVE),
        )


def _copies(byte: int, size: int) -> bytes:
    """A compressed block of a raw literal and a match, 65540 to 131075 times this byte."""
    literals = bytes([1 << 3, byte])
    # A sequence; its codes as runs: a literal, repeated offset 1, match length 65539 + 16 bits.
    sequences = bytes([1, 0b01010100, 1, 0, 52]) + (size - 65540).to_bytes(2, "little") + b"\1"
    return literals + sequences


def frame_headers() -> Iterator[Case]:
    """Faults of the frame header."""

    def whole(c: bytes) -> list[tuple[int, int, bytes]]:
        return [(RAW, len(c), c)]

    def with_descriptor(bits: int, between: bytes = b"") -> Style:
        def style(c: bytes) -> bytes:
            plain = frame(len(c), whole(c), descriptor=bits)
            return plain[:5] + between + plain[5:]

        return style

    windowed = b"\x28\xb5\x2f\xfd\x40\x00" + struct.pack("<H", 300 - 256)
    rows: list[tuple[str, str, Style, str, str]] = [
        ("magic-skippable", "R-5.10-1", lambda c: b"\x50\x2a\x4d\x18" + raw(c)[4:],
         "the magic number of a skippable frame", "skips the frame"),
        ("skippable-before", "R-5.10-1",
         lambda c: b"\x50\x2a\x4d\x18\x01\0\0\0\0" + raw(c),
         "a skippable frame before the frame", "hands both to a library that skips one"),
        ("frame-of-3-bytes", "R-5.10-1", lambda c: raw(c)[:3], "a frame of three bytes",
         "reads past the frame"),
        ("frame-of-4-bytes", "R-5.10-2", lambda c: raw(c)[:4], "a frame that is its magic number",
         "reads past the frame"),
        ("dictionary-id-1", "R-5.10-2", with_descriptor(0x21, b"\0"), "a dictionary id of one byte",
         "skips the field, since the id is 0"),
        ("checksum-flag", "R-5.10-2", lambda c: with_descriptor(0x24)(c) + b"\0\0\0\0",
         "the flag of a content checksum, and four bytes", "leaves the checksum to the library"),
        ("reserved-bit", "R-5.10-2", with_descriptor(0x28), "the Reserved_bit is set",
         "leaves the bit to the library"),
        ("unused-bit", "R-5.10-2", with_descriptor(0x30), "the Unused_bit is set",
         "ignores it, as RFC 8878 says"),
        ("windowed", "R-5.10-2", lambda c: windowed + raw(c)[7:],
         "no single segment, but a window descriptor", "decompresses it as the library does"),
        ("without-content-size", "R-5.10-2", lambda c: b"\x28\xb5\x2f\xfd\x00\x00" + raw(c)[7:],
         "neither a single segment nor a content size", "takes the size that comes out"),
        ("content-size-less", "R-5.10-3",
         lambda c: frame(len(c) - 1, [(RAW, len(c) - 1, c[:-1])]),
         "the content is a byte less than the planes", "fills the plane with 0"),
        ("content-size-more", "R-5.10-3",
         lambda c: frame(len(c) + 1, [(RAW, len(c) + 1, c + b"\0")]),
         "the content is a byte more than the planes", "ignores the byte"),
        ("content-size-plus-2-to-32", "R-5.10-3",
         lambda c: frame(len(c) + (1 << 32), whole(c), width=8),
         "the low 32 bits of Frame_Content_Size are right", "keeps it in 32 bits"),
        ("content-size-without-256", "R-5.10-3",
         lambda c: frame(len(c) + 256, whole(c), width=2),
         "Frame_Content_Size in two bytes, written without taking 256 away",
         "forgets the 256 of two bytes"),
    ]  # fmt: skip
    for name, rule, style, tests, faulty in rows:
        n = 300 if "window" in name or "without-content" in name else N
        yield case(
            name,
            framed(style, n),
            rule,
            tests,
            faulty,
            "E_FRAME",
            "raw" if n == N else "content-size-in-2-bytes-of-256",
            runs=(FILE, PROGRESSIVE) if name == "windowed" else (FILE,),
        )


def block_headers() -> Iterator[Case]:
    """Faults of block headers, and bytes behind the last block."""

    def not_last(c: bytes) -> bytes:
        plain = bytearray(raw(c))
        plain[6] &= 0xFE
        return bytes(plain)

    rows: list[tuple[str, Style, str, str]] = [
        ("block-reserved", lambda c: frame(len(c), [(RESERVED, len(c), c)]),
         "a block of the reserved type", "takes it for raw"),
        ("block-above-content-compressed",
         lambda c: frame(len(c), [(COMPRESSED, len(c) + 1, c + b"\0")]),
         "a compressed block that is longer than the content", "leaves it to the library"),
        ("block-past-the-frame", lambda c: raw(c)[:-1], "the last block lacks a byte",
         "reads on in what follows"),
        ("block-header-cut", lambda c: raw(c)[:8], "a block header of two bytes",
         "reads past the frame"),
        ("empty-raw-first", lambda c: frame(len(c), [(RAW, 0, b""), (RAW, len(c), c)]),
         "an empty raw block that is not the last", "reads any number of blocks that give nothing"),
        ("empty-run-last", lambda c: frame(len(c), [(RAW, len(c), c), (RLE, 0, b"x")]),
         "an empty run-length block at the end", "allows what it allows of raw blocks"),
        ("not-the-last-block", not_last, "no block is the last", "ends with the frame"),
        ("byte-behind-last", lambda c: raw(c) + b"\0", "a byte behind the last block",
         "leaves it to a library that ignores it"),
        ("second-frame", lambda c: raw(c) + raw(c), "a second frame behind the first",
         "joins or ignores it, as its library does"),
        ("skippable-behind", lambda c: raw(c) + b"\x50\x2a\x4d\x18\x01\0\0\0\0",
         "a skippable frame behind the frame", "leaves it to a library that skips it"),
        ]  # fmt: skip
    for name, style, tests, faulty in rows:
        yield case(name, framed(style), "R-5.10-5", tests, faulty, "E_FRAME", "raw")


def contents() -> Iterator[Case]:
    """Blocks that are well framed and do not give the content."""
    rows: list[tuple[str, Style, str, str]] = [
        ("content-too-short", lambda c: frame(len(c), [(RAW, len(c) - 1, c[:-1])]),
         "the blocks give a byte less than Frame_Content_Size", "fills the plane with 0"),
        ("content-too-long", lambda c: frame(len(c), [(RAW, len(c), c), (RLE, 1, b"\0")]),
         "the blocks give a byte more than Frame_Content_Size", "cuts it off"),
        ("content-empty", lambda c: frame(len(c), [(RAW, 0, b"")]),
         "one empty block for twelve bytes", "takes the content for zeros"),
        ("compressed-garbage", lambda c: frame(len(c), [(COMPRESSED, 8, b"\xff" * 8)]),
         "a compressed block of bytes 255", "gives what its library left in the buffer"),
        ("compressed-literals-only-short",
         lambda c: frame(len(c), [(COMPRESSED, 10, b"\x40" + c[:8] + b"\0")]),
         "a compressed block that gives eight literals of twelve bytes",
         "compares nothing with Frame_Content_Size"),
        ("treeless-without-tree",
         lambda c: frame(len(c), [(COMPRESSED, 6, b"\x83\x40\x00\xaa\xaa\0")]),
         "literals that repeat a Huffman tree where there was none",
         "decodes with what its memory holds"),
    ]  # fmt: skip
    for name, style, tests, faulty in rows:
        yield case(
            name,
            framed(style),
            "R-5.10-6",
            tests,
            faulty,
            "E_ZSTD",
            "literals-only",
            runs=(FILE, PROGRESSIVE) if name == "content-empty" else (FILE,),
        )
    yield case(
        "literals-only",
        framed(
            lambda c: frame(len(c), [(COMPRESSED, 10, b"\x40" + c[:8] + b"\0"), (RAW, 4, c[8:])])
        ),
        "R-5.10-6",
        "a compressed block of eight raw literals and no sequences, then a raw block",
        "wants sequences in a compressed block",
    )


def partitions() -> Iterator[Case]:
    """Planes in frames."""
    adds = numbers(5, spread=3000)
    for name, frames, tests in (
        ("one-frame-per-plane", [1] * 28, "each plane in a frame of its own"),
        ("frames-of-uneven-planes", [5, 1, 13, 2, 7], "frames that end within a list"),
    ):
        yield case(
            name,
            Stream(
                [
                    Packet(
                        adds=adds,
                        frames=frames,
                        codings=dict.fromkeys([f"adds {c}" for c in range(14)], 0x18),
                    )
                ]
            ),
            "R-5.9-7 R-5.9-8",
            tests,
            "starts a frame with each list, or joins frames wrongly",
        )
    yield case(
        "second-frame-faulty",
        Stream([Packet(adds={X: [1, 2], Y: [3, 4]}, frames=(1, 1),
                       style=lambda c: raw(c) if c[0] < 5 else frame(len(c), [(RESERVED, 0, b"")]),
                       codings={"adds 0": 8, "adds 1": 8})]),
        "R-5.10-5 R-5.9-7",
        "the second frame of a packet has a block of the reserved type",
        "checks the first frame of a packet only",
        "E_FRAME",
        "one-frame-per-plane",
    )  # fmt: skip
    n = 399458  # 42 planes of it are 20 bytes more than 16 MiB
    yield case(
        "content-above-16-mib",
        Stream([Packet(n_adds=n, edit=lambda body: huge(body, n))]),
        "R-5.10-4",
        f"Frame_Content_Size is {42 * n}, and that of the planes",
        "allocates more than 16 MiB for a frame",
        "E_FRAME",
        "raw",
    )


def huge(body: bytes, n: int) -> bytes:
    """A packet of 42 planes of n bytes, its frame of runs, and raw bytes to be long enough."""
    codings = body[2:23] + b"\x28" * 14
    total, blocks = 42 * n, list[tuple[int, int, bytes]]()
    blocks.append((RAW, 25000, bytes(25000)))
    left = total - 25000
    while left:
        blocks.append((RLE, min(left, 131072), b"\0"))
        left -= blocks[-1][1]
    content = frame(total, blocks)
    return b"\0\1" + codings + struct.pack("<BI", 42, len(content)) + content


RECIPES: tuple[Recipe, ...] = (
    legal_blocks, blocks_that_give_much, frame_headers, block_headers, contents, partitions,
)  # fmt: skip
