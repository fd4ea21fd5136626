"""What Zstandard decoders differ in within a compressed block (R-5.10-7 to R-5.10-11)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from conformance.generator.builder import COMPRESSED, RAW, Packet, Stream, frame
from conformance.generator.cases.case import FILE, Case, Recipe, case

FAMILY = "zstd"
RUNS = 0b01010100  # Symbol_Compression_Modes: one code for all sequences, of each kind
COPIED = [3, 1, 4, 1, 5, 9, 2, 6]
BITS = [0, 1] * 20
WEIGHED = [0, 2, 0, 2, 0, 2, 0, *range(20)]  # the first seven by FSE-coded weights


def parted(values: Sequence[int], block: bytes, begin: int, end: int) -> Stream:
    """Stored integers, those from `begin` to `end` by a compressed block, the others raw."""

    def style(content: bytes) -> bytes:
        parts = [(RAW, content[:begin]), (COMPRESSED, block), (RAW, content[end:])]
        return frame(len(content), [(kind, len(part), part) for kind, part in parts if part])

    stored = {"adds 0": list(values)}
    return Stream([Packet(n_adds=len(values), stored=stored, codings={"adds 0": 8}, style=style)])


def copies(*repeats: int, modes: int = RUNS) -> bytes:
    """A block of sequences without literals, each a copy of 3 bytes.

    Args:
        repeats: Offset_Value of each, 2 or 3, which without literals are Repeated_Offset3 and
            Repeated_Offset1 - 1.
        modes: Symbol_Compression_Modes.
    """
    bits = 1  # the bit of the last sequence is the lowest: the stream is read from its end
    for value in repeats:
        bits = bits << 1 | value - 2
    # No literals; the number of sequences; the modes; the codes: no literal, offset 1, 3 bytes.
    return bytes([0, len(repeats), modes, 0, 1, 0, bits])


def in_four_streams(content: Sequence[int]) -> bytes:
    """A block of 0 and 1 as literals in four streams, of one bit each, and no sequences."""
    length = (len(content) + 3) // 4
    streams = bytearray()
    for begin in range(0, 4 * length, length):
        bits = 1
        for value in content[begin : begin + length]:
            bits = bits << 1 | value
        streams.append(bits)
    # The tree by one weight of 4 bits, the sizes of three streams, the streams.
    body = b"\x80\x10" + b"\1\0" * 3 + bytes(streams)
    header = 2 | 1 << 2 | len(content) << 4 | len(body) << 14
    return header.to_bytes(3, "little") + body + b"\0"


def of_seven(states: bytes) -> bytes:
    """A block of seven literals by a tree of FSE-coded weights, and no sequences.

    That of the states `1f 02` is the example of libzstd's documentation
    (`decompressor_permissive.md`).

    Args:
        states: two bytes with the initial states of the weights, of 5 bits each.
    """
    return bytes.fromhex("72 80 01 04 20 7e") + states + b"\xaa\0"


def legal() -> Iterator[Case]:
    """What decoders must accept."""
    yield case(
        "repeated-offset-less-1",
        parted([*COPIED, 3, 1, 4, 5, 9, 2], copies(2, 3), 8, 14),
        "R-5.10-6 R-5.10-7 R-5.10-9",
        "a copy from 8 bytes before, then one from Repeated_Offset1 - 1, which is 7",
        "takes the third repeated offset for what it is behind literals",
        runs=(FILE,),
    )
    yield case(
        "four-streams-of-6",
        parted(BITS, in_four_streams(BITS[:6]), 0, 6),
        "R-5.10-6 R-5.10-8",
        "six literals in four streams, the last of which holds none",
        "refuses a stream without literals",
        runs=(FILE,),
    )
    yield case(
        "no-sequences-in-two-bytes",
        parted(COPIED * 3, bytes([8 << 3, *COPIED, 0x80, 0]), 0, 8),
        "R-5.10-6 R-5.10-11 R-5.10-17",
        "a Number_of_Sequences of 0 in two bytes",
        "looks for Symbol_Compression_Modes behind it, as libzstd 1.5.4 does",
        runs=(FILE,),
    )
    yield case(
        "weights-of-two-states",
        parted(WEIGHED, of_seven(b"\x20\x04"), 0, 7),
        "R-5.10-6 R-5.10-10",
        "the FSE-coded weights of a Huffman tree, as few as two initial states hold",
        "knows weights of 4 bits only, or wants bits behind the states",
        runs=(FILE,),
    )


def faults() -> Iterator[Case]:
    """What decoders must refuse."""
    rows = [
        ("repeated-offset-of-0", "R-5.10-7", "repeated-offset-less-1",
         parted([*COPIED, 6, 6, 6], copies(3), 8, 11),
         "a copy from Repeated_Offset1 - 1, which is 0", "takes it for 1, as libzstd 1.5.4 does"),
        ("four-streams-of-4", "R-5.10-8", "four-streams-of-6",
         parted(BITS, in_four_streams(BITS[:4]), 0, 4),
         "four literals in four streams", "decodes a literal from each stream"),
        ("modes-with-a-reserved-bit", "R-5.10-9", "repeated-offset-less-1",
         parted([*COPIED, 3, 1, 4, 5, 9, 2], copies(2, 3, modes=RUNS | 1), 8, 14),
         "a Reserved bit of Symbol_Compression_Modes is set",
         "ignores it, as libzstd 1.5.4 does"),
        ("weights-without-a-bit", "R-5.10-10", "weights-of-two-states",
         parted(WEIGHED, of_seven(b"\x1f\x02"), 0, 7),
         "the FSE-coded weights of a Huffman tree lack a bit of the second initial state",
         "takes the missing bit for 0, as libzstd 1.5.4 does"),
    ]  # fmt: skip
    for name, rule, twin, stream, tests, faulty in rows:
        yield case(name, stream, rule, tests, faulty, "E_ZSTD", twin)


RECIPES: tuple[Recipe, ...] = (legal, faults)
