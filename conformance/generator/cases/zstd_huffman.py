"""Huffman-coded literals, of which libzstd does not check everything (R-5.10-12 to R-5.10-15)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from conformance.generator.builder import COMPRESSED, RAW, Packet, Stream, frame
from conformance.generator.cases.case import FILE, Case, Recipe, case

FAMILY = "zstd"
Streams = list[bytes]
Change = Callable[[Streams], None]
Part = tuple[int, bytes, int]  # type of a block, its content, bytes that it regenerates
WITH_TREE, TREELESS = 2, 3
OF_TWO = b"\x80\x10"  # a tree: 0 and 1 have a bit each
COPIED = [1, 0, 0, 1, 0, 1, 1, 1]
# No literal, Repeated_Offset3, which is 8, and 3 bytes; one code for all sequences of each kind.
COPY_OF_3 = bytes([1, 0b01010100, 0, 1, 0, 0b10])
NO_SEQUENCE = b"\0"
PLAIN = [k * k % 7 % 2 for k in range(256)]  # so many that libzstd takes its fast way


def stored(values: Sequence[int], parts: Sequence[Part]) -> Stream:
    """Stored integers by these blocks, and a raw one for what they leave."""

    def style(content: bytes) -> bytes:
        blocks, at = [], 0
        for kind, block, n in parts:
            blocks.append((kind, len(block), block))
            at += n
        rest = content[at:]
        return frame(len(content), [*blocks, (RAW, len(rest), rest)])

    lists = {"adds 0": list(values)}
    return Stream([Packet(n_adds=len(values), stored=lists, codings={"adds 0": 8}, style=style)])


def literals(
    values: Sequence[int],
    n_streams: int = 4,
    change: Change = lambda _: None,
    *,
    tree: bytes = OF_TWO,
) -> bytes:
    """A literals section of values that are their own code of a bit; `change` is of its streams.

    Args:
        values: 0 or 1.
        n_streams: 1 or 4.
        change: what is done to the streams.
        tree: its description; none for a section that repeats the one before.
    """
    each = -(-len(values) // n_streams)
    streams = list[bytes]()
    for k in range(n_streams):
        bits = 1  # the end mark; the stream is read from its end, so the first value is next
        for value in values[k * each : (k + 1) * each]:
            bits = bits << 1 | value
        streams.append(coded(bits))
    change(streams)
    return section(len(values), streams, tree)


def coded(bits: int) -> bytes:
    """The bytes of a stream, whose end mark is the highest bit."""
    return bits.to_bytes((bits.bit_length() + 7) // 8, "little")


def section(n: int, streams: Sequence[bytes], tree: bytes) -> bytes:
    """A section of n literals in these streams."""
    body = tree + b"".join(len(stream).to_bytes(2, "little") for stream in streams[:-1])
    body += b"".join(streams)
    kind, form = (WITH_TREE if tree else TREELESS), 1 if len(streams) == 4 else 0
    return (kind | form << 2 | n << 4 | len(body) << 14).to_bytes(3, "little") + body


def one(block: bytes, values: Sequence[int]) -> Stream:
    """A stream of the values of a block and some more."""
    return stored([*values, *COPIED], [(COMPRESSED, block, len(values))])


def behind_a_copy(change: Change = lambda _: None) -> Stream:
    """Literals of a block that also has a sequence."""
    block = literals(PLAIN, change=change) + COPY_OF_3
    values = [*COPIED, *COPIED[:3], *PLAIN, *COPIED]
    copied = (RAW, bytes(COPIED), len(COPIED))
    return stored(values, [copied, (COMPRESSED, block, 3 + len(PLAIN))])


def repeated(first: Change = lambda _: None, second: Change = lambda _: None) -> Stream:
    """Literals of two blocks, of which the second repeats the tree of the first."""
    blocks = [literals(PLAIN, change=first), literals(PLAIN, change=second, tree=b"")]
    parts = [(COMPRESSED, block + NO_SEQUENCE, len(PLAIN)) for block in blocks]
    return stored([*PLAIN, *PLAIN, *COPIED], parts)


def more(which: int, bits: int = 1) -> Change:
    """Bits below those of the codes of a stream."""

    def change(streams: Streams) -> None:
        streams[which] = coded(int.from_bytes(streams[which], "little") << bits)

    return change


def less(which: int) -> Change:
    """The last code of a stream is not there."""

    def change(streams: Streams) -> None:
        streams[which] = coded(int.from_bytes(streams[which], "little") >> 1)

    return change


def deep(log: int) -> bytes:
    """A tree of codes of 1 to `log` bits: of 0 one bit, of 1 two, and so on."""
    weights = [*range(log, 0, -1)] + [0] * (log % 2)
    pairs = zip(weights[::2], weights[1::2], strict=True)
    return bytes([127 + log, *(a << 4 | b for a, b in pairs)])


def of_depth(log: int) -> Stream:
    """20 literals 0, whose code is 1, by a tree of so many bits."""
    bits = (1 << 21) - 1
    block = section(20, [bits.to_bytes(3, "little")], deep(log)) + NO_SEQUENCE
    return one(block, [0] * 20)


def legal() -> Iterator[Case]:
    """What decoders must accept."""
    rows = [
        ("huffman-four-streams", "R-5.10-12 R-5.10-14", one(literals(PLAIN) + NO_SEQUENCE, PLAIN),
         "256 literals in four streams, of one bit each", "wants a bit more of each stream"),
        ("huffman-one-stream", "R-5.10-12", one(literals(PLAIN, 1) + NO_SEQUENCE, PLAIN),
         "256 literals in one stream", "reads a table of sizes before it"),
        ("huffman-and-a-copy", "R-5.10-7 R-5.10-9 R-5.10-12", behind_a_copy(),
         "literals in four streams, and a sequence",
         "takes what a block regenerates for its literals"),
        ("huffman-tree-again", "R-5.10-5 R-5.10-12", repeated(),
         "a second block that repeats the tree of the first", "forgets the tree with the block"),
        ("huffman-11-bits", "R-5.10-13 R-5.10-14", of_depth(11),
         "a Huffman tree of codes of up to 11 bits", "knows codes of 8 bits"),
    ]  # fmt: skip
    for name, rules, stream, tests, faulty in rows:
        yield case(name, stream, f"R-5.10-6 {rules}", tests, faulty, runs=(FILE,))
    # Weights 0, 1 and 1. The state of weight 0 wants 5 bits more, and one is there.
    weights = bytes.fromhex("04 20 7e 02 08")
    values = [1, 2, 1, 2, 1, 2, 1]
    yield case(
        "weights-end-in-an-update",
        one(section(7, [b"\xaa"], weights) + NO_SEQUENCE, values),
        "R-5.10-6 R-5.10-15",
        "the last update of a state of FSE-coded weights lacks four of its five bits",
        "allows only that it lacks all of them",
        runs=(FILE,),
    )


def faults() -> Iterator[Case]:
    """What decoders must refuse."""

    def without_mark(streams: Streams) -> None:
        streams[1] = streams[1][:-1]  # the mark alone; the byte before has the first eight codes

    def to_another(streams: Streams) -> None:
        more(1)(streams)
        less(2)(streams)

    def in_four(change: Change, values: Sequence[int] = PLAIN) -> Stream:
        return one(literals(values, change=change) + NO_SEQUENCE, values)

    with_eight_zeros = [*PLAIN[:64], *[0] * 8, *PLAIN[72:]]

    whole = "huffman-four-streams"
    rows = [
        ("huffman-bit-left", whole, in_four(more(1)), "a bit is left in the second stream",
         "leaves it to libzstd, which does not look"),
        ("huffman-bits-left-first", whole, in_four(more(0, 8)),
         "eight bits are left in the first stream", "looks at the last stream only"),
        ("huffman-bit-left-last", whole, in_four(more(3)), "a bit is left in the last stream",
         "looks at the first stream only"),
        ("huffman-bit-lacking", whole, in_four(less(1)),
         "the second stream lacks its last bit", "reads on in the stream before"),
        ("huffman-bit-lacking-first", whole, in_four(less(0)),
         "the first stream lacks its last bit", "reads on in the sizes of the streams"),
        ("huffman-bit-to-another", whole,
         in_four(to_another),
         "a bit is left in the second stream, and the third lacks one",
         "adds up the bits of the four streams"),
        ("huffman-without-mark", whole, in_four(without_mark, with_eight_zeros),
         "the second stream ends with a byte of 0", "reads the bits of that byte as codes"),
        ("huffman-bit-left-of-one", "huffman-one-stream",
         one(literals(PLAIN, 1, more(0)) + NO_SEQUENCE, PLAIN),
         "a bit is left in the one stream", "looks at four streams only"),
        ("huffman-bit-left-and-a-copy", "huffman-and-a-copy", behind_a_copy(more(2)),
         "a bit is left in the third stream, and the block has a sequence",
         "looks at blocks without sequences only"),
        ("huffman-bit-left-of-a-tree-again", "huffman-tree-again", repeated(second=more(1)),
         "a bit is left where a block repeats the tree of the one before",
         "looks at blocks with a tree only"),
        ("huffman-bit-left-of-first-block", "huffman-tree-again", repeated(first=more(1)),
         "a bit is left in the first of two blocks", "looks at the last block only"),
    ]  # fmt: skip
    for name, twin, stream, tests, faulty in rows:
        yield case(name, stream, "R-5.10-12", tests, faulty, "E_ZSTD", twin, (FILE,))
    yield case(
        "huffman-12-bits",
        of_depth(12),
        "R-5.10-13",
        "a Huffman tree with codes of 12 bits",
        "leaves it to libzstd, whose tables have room for it",
        "E_ZSTD",
        "huffman-11-bits",
        (FILE,),
    )
    yield case(
        "huffman-no-longest-code",
        one(literals(PLAIN[:20], 1, tree=b"\x80\x20") + NO_SEQUENCE, PLAIN[:20]),
        "R-5.10-14",
        "a Huffman tree of two weights 2, which has no code of two bits",
        "takes two codes of one bit for a tree",
        "E_ZSTD",
        "huffman-one-stream",
        (FILE,),
    )


RECIPES: tuple[Recipe, ...] = (legal, faults)
