"""Sequences of compressed blocks, and bits without a meaning (R-5.10-16 to R-5.10-19)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from conformance.generator.builder import Stream
from conformance.generator.cases.case import FILE, Case, Recipe, case
from conformance.generator.cases.zstd_huffman import (
    COPY_OF_3,
    NO_SEQUENCE,
    OF_TWO,
    coded,
    one,
    section,
)
from conformance.generator.cases.zstd_libraries import COPIED, copies, parted

FAMILY = "zstd"
OWN_OFFSETS = 0b01100100  # Symbol_Compression_Modes: offset codes by a table of the block
NO_LITERAL = b"\0"  # a section of raw literals
# Copies of 3 bytes: from 8 bytes before, then from 4 before.
TWO_COPIES, OF_TWO_COPIES = copies(2, 2), [*COPIED, 3, 1, 4, 6, 3, 1]
EIGHT = [0, 1, 0, 1, 1, 0, 1, 0]


def described(log: int, probabilities: Sequence[int], unused: int = 0) -> bytes:
    """The description of an FSE table (RFC 8878, 4.1.1).

    Args:
        log: its Accuracy_Log.
        probabilities: of each code from 0; -1 for "less than 1".
        unused: the value of each bit behind the last one.
    """
    bits, at, left, k = log - 5, 4, 1 << log, 0
    while left:
        width, value = (left + 1).bit_length(), probabilities[k] + 1
        n_short = (1 << width) - 2 - left  # so many values take a bit less
        if value < n_short:
            width -= 1
        elif value >= 1 << width - 1:
            value += n_short
        bits |= value << at
        at, left, k = at + width, left - abs(probabilities[k]), k + 1
        if probabilities[k - 1] != 0:
            continue
        more = 3
        while more == 3:  # how many codes behind have no probability
            n_zeros = next(n for n, p in enumerate(probabilities[k:]) if p)
            more = min(n_zeros, 3)
            bits |= more << at
            at, k = at + 2, k + more
    size = -(-at // 8)
    if unused:
        bits |= (1 << 8 * size) - (1 << at)
    return bits.to_bytes(size, "little")


def by_a_table(largest: int, unused: int = 0) -> Stream:
    """A copy of 3 bytes whose offset code is 1, of a table that has `largest` as well."""
    table = described(5, [0, 31, *[0] * (largest - 2), -1], unused)
    state_and_bit = coded(1 << 6)  # state 0 of 32, which is that of code 1; Repeated_Offset3
    block = NO_LITERAL + bytes([1, OWN_OFFSETS, 0]) + table + b"\0" + state_and_bit
    return parted([*COPIED, 3, 1, 4, 1, 5, 9], block, 8, 11)


def legal() -> Iterator[Case]:
    """What decoders must accept."""
    behind = parted([1, *EIGHT, *EIGHT[-7:-4], 1], section(0, [b"\1"], OF_TWO) + COPY_OF_3, 9, 12)
    odd = section(8, [coded(1 << 8 | 0x5A)], b"\x80\x1f") + NO_SEQUENCE
    rows = [
        ("two-repeated-offsets", "R-5.10-7 R-5.10-9 R-5.10-16",
         parted(OF_TWO_COPIES, TWO_COPIES, 8, 14),
         "two sequences whose bits end with those of the last offset",
         "updates the states behind the last sequence, and finds no bits for it"),
        ("huffman-stream-of-no-literal", "R-5.10-8 R-5.10-12 R-5.10-16", behind,
         "literals in one stream that are none, and a sequence",
         "asks a library for no bytes, or wants a literal of each stream"),
        ("weights-odd-nibble-set", "R-5.10-12 R-5.10-19", one(odd, EIGHT),
         "one directly stored weight, and 15 in the other half of its byte",
         "reads a weight from both halves, or wants the other to be 0"),
        ("offset-code-31-named", "R-5.10-16 R-5.10-18", by_a_table(31),
         "a table of offset codes with 31, which never occurs",
         "bounds the codes of a table by what a frame can hold"),
        ("table-unused-bits-set", "R-5.10-16 R-5.10-19", by_a_table(28, unused=1),
         "the unused bits of the last byte of an FSE table are 1", "wants them to be 0"),
    ]  # fmt: skip
    for name, rules, stream, tests, faulty in rows:
        yield case(name, stream, f"R-5.10-6 {rules}", tests, faulty, runs=(FILE,))


def faults() -> Iterator[Case]:
    """What decoders must refuse."""
    bits, head = TWO_COPIES[-1], TWO_COPIES[:-1]
    rows = [
        ("sequences-bit-left", "R-5.10-16", bits << 1, "a bit is left behind the last sequence",
         "stops reading when it has all sequences"),
        ("sequences-bit-lacking", "R-5.10-6 R-5.10-16", bits >> 1,
         "the bitstream of sequences lacks its last bit, which is 0", "takes a missing bit for 0"),
    ]  # fmt: skip
    for name, rules, bitstream, tests, faulty in rows:
        stream = parted(OF_TWO_COPIES, head + bytes([bitstream]), 8, 14)
        yield case(name, stream, rules, tests, faulty, "E_ZSTD", "two-repeated-offsets")
    raw = bytes([8 << 3, *COPIED])
    for name, rules, number, twin, tests, faulty in (
        ("byte-behind-no-sequences", "R-5.10-17", b"\0", "literals-only",
         "a Number_of_Sequences of 0", "ignores it, since there is nothing to read"),
        ("byte-behind-no-sequences-in-two-bytes", "R-5.10-11 R-5.10-17", b"\x80\0",
         "no-sequences-in-two-bytes",
         "a Number_of_Sequences of 0 in two bytes",
         "takes it for Symbol_Compression_Modes, as libzstd 1.5.4 does"),
    ):  # fmt: skip
        stream = parted(COPIED * 3, raw + number + b"\0", 0, 8)
        says = f"a byte of 0 behind {tests}"
        yield case(name, stream, rules, says, faulty, "E_ZSTD", twin)
    yield case(
        "offset-code-32-named",
        by_a_table(32),
        "R-5.10-18",
        "a table of offset codes with 32, which never occurs",
        "bounds the codes that occur only",
        "E_ZSTD",
        "offset-code-31-named",
    )


RECIPES: tuple[Recipe, ...] = (legal, faults)
