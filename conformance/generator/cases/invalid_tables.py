"""Faults in the bodies of QUAN, ALFA, TILE, dGST and mETa, one each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from conformance.generator.builder import (
    MAX_X,
    PALETTE,
    PICKS,
    SPLIT,
    Chunk,
    Packet,
    Stream,
    Tile,
    build,
    places,
)
from conformance.generator.cases.case import FILE, VERIFY, Case, Recipe, case
from conformance.generator.cases.edits import with_body
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "invalid-tables"
CORES = (Packet(adds=numbers(2)), Packet(records={1: SPLIT}, psi=numbers(1), level=1))
BASE = Stream(
    list(banded(CORES, 1)),
    degree=1,
    n_levels=2,
    alphas={(0, 2): (1, [3]), (1, 0): (12, [5, -7])},
    metadata={"a": "1", "b": "2"},
)


def legal() -> Iterator[Case]:
    """What the faults are made from."""
    yield case(
        "base",
        BASE,
        "R-5.3-1 R-5.4-1 R-5.5-1 R-5.8-1",
        "all tables within their domains",
        "confuses the domains of two tables",
    )


def steps() -> Iterator[Case]:
    """QUAN."""
    rows = [
        ("mantissa-0-last", (2, 5), (0, 0), "R-5.3-1", "M of the last entry is 0"),
        ("shift-25", (1, 1), (1, 25), "R-5.3-2", "E is 25"),
        ("shift-255-last", (2, 5), (1, 255), "R-5.3-2", "E of the last entry is 255"),
    ]
    for name, at, entry, rule, tests in rows:
        yield case(
            f"step-{name}",
            replace(BASE, quantisers={at: entry}),
            rule,
            tests,
            "checks only entries that are used, or shifts by what the machine allows",
            "E_STEP",
            "step-extremes",
        )
    yield case(
        "step-extremes",
        replace(BASE, quantisers={(1, 0): (65535, 0), (1, 5): (65535, 24), (1, 1): (1, 24)}),
        "R-5.3-1 R-5.3-2",
        "the largest M and E in rows of a level that has no psi",
        "refuses a step that no integer but 0 can use",
    )


def alphas() -> Iterator[Case]:
    """ALFA."""
    one = (0, [1])
    rows: list[tuple[str, Mapping[tuple[int, int], tuple[int, list[int]]], str, str]] = [
        ("level-2-of-2", {(2, 0): one}, "R-5.4-1", "a table for a level that is none"),
        ("level-255", {(255, 0): one}, "R-5.4-1", "a table for level 255"),
        ("group-5", {(0, 5): one}, "R-5.4-1", "a table for group 5"),
        ("shift-13", {(0, 0): (13, [1])}, "R-5.4-1", "K is 13"),
        ("groups-decrease", {(0, 1): one, (0, 0): one}, "R-5.4-2", "group 0 after group 1"),
        ("levels-decrease", {(1, 0): one, (0, 4): one}, "R-5.4-2", "level 0 after level 1"),
    ]
    for name, tables, rule, tests in rows:
        yield case(
            f"alpha-{name}",
            replace(BASE, alphas=tables),
            f"{rule} 5.4",
            tests,
            "files tables by level and group and does not mind where they stand",
            "E_ALPHA",
            "base",
        )
    bodies = [
        ("repeated", b"\0\0\0\0\1\0" * 2, "E_ALPHA", "R-5.4-2", "a table twice"),
        ("header-cut", b"\0\0\0\0\1\0" + b"\0\1\0", "E_CHUNK", "R-5.4-3",
         "three bytes follow the last table"),
        ("entries-cut", b"\0\0\0\1\1\0\1", "E_CHUNK", "R-5.4-3",
         "the last byte of the last entry is missing"),
        ("order-before-entries", b"\0\1\0\0\1\0" + b"\0\0\0\xff\1\0", "E_ALPHA", "R-5.4-2 R-6.1-1",
         "a table out of order whose entries are missing, too"),
    ]  # fmt: skip
    for name, body, code, rule, tests in bodies:
        yield case(
            f"alpha-{name}",
            replace(BASE, chunks=with_body(1, body)),
            f"{rule} 5.4",
            tests,
            "reads past the chunk, or drops a table that is not whole",
            code,
            "base",
        )


def tiles() -> Iterator[Case]:
    """TILE."""
    limit, top = 1 << 52, MAX_X
    rows = [
        ("origin-beyond", Tile((0, 0, limit + 1)), "R-5.5-1", "z of the origin is 2^52 + 1"),
        ("origin-below", Tile((-limit - 1, 0, 0)), "R-5.5-1", "x of the origin is -2^52 - 1"),
        ("origin-least-s64", Tile((0, -(1 << 63), 0)), "R-5.5-1", "y of the origin is -2^63"),
        ("box-turned", Tile(low=(0, 0, 1), high=(0, 0, 0)), "R-5.5-2", "z of the box is turned"),
        ("box-below", Tile(low=(-top, -top - 1, -top)), "R-5.5-2", "`box_min` is -2^30"),
        ("box-beyond", Tile(high=(top + 1, top, top)), "R-5.5-2", "`box_max` is 2^30"),
        ("box-largest-s32", Tile(high=((1 << 31) - 1,) * 3), "R-5.5-2", "`box_max` is 2^31 - 1"),
    ]
    for name, tile, rule, tests in rows:
        yield case(
            f"tile-{name}",
            Stream([], tiles=(Tile(), tile)),
            rule,
            f"{tests}, of a tile without splats",
            "checks tiles when they are used, or takes magnitudes in too few bits",
            "E_TILE",
            "tile-extremes",
        )
    yield case(
        "tile-extremes",
        Stream([], tiles=(Tile((limit, -limit, 0)), Tile(low=(top,) * 3, high=(top,) * 3))),
        "R-5.5-1 R-5.5-2",
        "origins of 2^52 and -2^52, and a box of one point in a corner",
        "bounds them by less",
    )


def digests() -> Iterator[Case]:
    """The dGST chunk."""
    right = b"\7" * 32
    rows: list[tuple[str, list[tuple[int, int, int]], str, str]] = [
        ("steps-decrease", [(0, 0, 1), (0, 0, 0)], "R-5.7-1", "step 0 after step 1"),
        ("components-decrease", [(0, 1, 0), (0, 0, 1)], "R-5.7-1", "core after a band"),
        ("tile-that-is-none", [(1, 0, 0)], "R-5.7-2", "a digest of a tile that is none"),
        ("step-that-is-none", [(0, 1, 2)], "R-5.7-2", "a digest of a step that is not there"),
    ]
    for name, keys, rule, tests in rows:
        yield case(
            f"digest-{name}",
            replace(BASE, digests=dict.fromkeys(keys, right)),
            rule,
            tests,
            "does not look at digests that it does not check",
            "E_CHUNK",
            "digests-right",
        )
    yield case(
        "digest-repeated",
        replace(BASE, digests={(0, 0, 0): right},
                chunks=lambda c: [*c[:-1], Chunk(b"dGST", c[-1].body * 2)]),
        "R-5.7-1",
        "a digest twice",
        "keeps the last of the two",
        "E_CHUNK",
        "digests-right",
    )  # fmt: skip
    every = {(0, c, s): None for c in range(2) for s in range(2)}
    yield case(
        "digests-right",
        replace(BASE, digests=every),
        "R-5.7-1 R-5.7-2 R-5.7-3",
        "digests in order of component, then of step",
        "expects the order of the packet table",
        runs=(VERIFY,),
    )
    for name, key in (("first-core", (0, 0, 0)), ("last-core", (0, 0, 1)), ("band", (0, 1, 1))):
        yield case(
            f"digest-wrong-of-{name}",
            replace(BASE, digests={**every, key: right}),
            "R-5.7-3 R-5.7-4",
            f"the digest of {key} is wrong, and matters only to who verifies",
            "does not compare, or refuses although it was not asked to verify",
            "E_DIGEST",
            "digests-right",
            runs=(VERIFY, FILE, replace(VERIFY, level=0)),
        )
    data = build(replace(BASE, digests={(0, 0, 0): None}))
    digest = data[places(data).chunks[b"dGST"] + 21 :][:32]
    yield case(
        "digest-wrong-in-its-last-byte",
        replace(BASE, digests={(0, 0, 0): digest[:-1] + bytes([digest[-1] ^ 1])}),
        "R-5.7-3 R-5.7-4",
        "the last bit of a digest is wrong",
        "compares a part of the digest",
        "E_DIGEST",
        "digests-right",
        runs=(VERIFY,),
    )


def digested() -> Iterator[Case]:
    """Bytes of the states that digests name, against bytes of the file."""
    for name, stream, what in _digested_streams():
        yield case(
            f"digested-{name}-at-the-bound",
            _sized(stream, 0),
            "R-5.7-5 R-5.7-3",
            f"digests name 4096 times the bytes of the file, {what}",
            "has a smaller bound, or other sizes of states",
            runs=(VERIFY,),
        )
        yield case(
            f"digested-{name}-above-the-bound",
            _sized(stream, -1),
            "R-5.7-5",
            f"digests name more than 4096 times the bytes of the file, {what}",
            "has no bound, or a larger one, or other sizes of states",
            "E_AMPLIFICATION",
            f"digested-{name}-at-the-bound",
        )
    _, stream, _ = next(iter(_digested_streams()))
    disordered = replace(
        stream,
        chunks=lambda chunks: [
            Chunk(b"dGST", chunk.body + chunk.body[:41]) if chunk.kind == b"dGST" else chunk
            for chunk in chunks
        ],
    )
    yield case(
        "digested-above-the-bound-before-disorder",
        _sized(disordered, -1),
        "R-6.1-1 R-5.7-5",
        "the last row but one exceeds the bound, the last one is out of order",
        "looks at the order of all rows first, or at the sum of all",
        "E_AMPLIFICATION",
        "digested-core-at-the-bound",
    )


def _digested_streams() -> Iterator[tuple[str, Stream, str]]:
    """Streams of some thousand slots with a digest for every packet."""
    names = [(0, 0, step) for step in range(16)]
    core = [Packet(n_adds=16044, adds={0: [0, -1] * 8022})] + [Packet()] * 15
    yield "core", Stream(core, digests=dict.fromkeys(names)), "of core alone"
    # Slots grow at the last step: what counts is how many there are after the step that is named.
    banded_core = [core[0], *[Packet()] * 10, Packet(n_adds=100, adds={1: [0, -1] * 50})]
    bands = [Packet(component=1)] * 12
    names = [(0, c, step) for c in range(2) for step in range(12)]
    stream = Stream([*banded_core, *bands], degree=1, digests=dict.fromkeys(names))
    yield "bands", stream, "of core and a band"
    entries = Packet(component=PALETTE, adds={0: [0, -1] * 3000})
    palette = [core[0], *[entries, Packet(component=PALETTE)] * 2]
    palette += [Packet(component=PICKS), *[Packet(), Packet(component=PICKS)] * 19]
    names = [(0, c, step) for c in (0, PICKS) for step in range(20)]
    names += [(0, PALETTE, k) for k in range(4)]
    stream = Stream(palette, degree=1, has_palette=True, digests=dict.fromkeys(names))
    yield "palette", stream, "of core, picks and a palette"


def _sized(stream: Stream, more: int) -> Stream:
    """The stream with metadata that make its file as large as its digests need, and `more`."""
    n_above = 3 * (stream.degree + 1) ** 2 - 3
    slots, n_entries, n_core, total = list[int](), 0, 0, 0
    steps = dict.fromkeys(range(1 + PALETTE), 0)
    for packet in stream.packets:
        step, new = steps[packet.component], packet.counts["n_adds"]
        steps[packet.component] += 1
        if packet.component == 0:
            n_core += new
            slots.append(n_core)
            total += 4 + 61 * n_core
        elif packet.component == PALETTE:
            n_entries += new
            total += 4 + 4 * n_above * n_entries
        else:
            total += 4 + 4 * n_above * slots[step]
    wanted = -(-total // 4096) + more
    zeros = dict.fromkeys(stream.digests or (), bytes(32))  # the right ones are as long
    size = len(build(replace(stream, metadata={"a": ""}, digests=zeros)))
    return replace(stream, metadata={"a": "a" * (wanted - size)})


def metadata() -> Iterator[Case]:
    """The mETa chunk."""
    bodies = [
        ("header-cut", b"\1\0", "R-5.8-1", "two bytes, where an entry has three before its key"),
        ("key-cut", b"\5\0\0abc", "R-5.8-1", "a key reaches past the chunk"),
        ("value-cut", b"\1\3\0abc", "R-5.8-1", "a value reaches past the chunk by a byte"),
        ("key-empty", b"\0\1\0x", "R-5.8-2", "a key without characters"),
        ("key-capital", b"\1\0\0A", "R-5.8-2", "a key with a capital letter"),
        ("key-space", b"\3\0\0a b", "R-5.8-2", "a key with a space"),
        ("key-slash", b"\1\0\0/", "R-5.8-2", "a key with the character between `.` and `0`"),
        ("key-latin", b"\1\0\0\xe9", "R-5.8-2", "a key with a byte above 127"),
        ("keys-equal", b"\1\0\0a\1\0\0a", "R-5.8-3", "a key twice"),
        ("keys-prefix-last", b"\2\0\0ab\1\0\0a", "R-5.8-3", "a key after one that it begins"),
        ("keys-by-value-of-bytes", b"\1\0\0a\1\0\0_", "R-5.8-3", "`_` after `a`"),
    ]
    for name, body, rule, tests in bodies:
        yield case(
            f"meta-{name}",
            replace(BASE, chunks=with_body(4, body)),
            rule,
            tests,
            "does not look into metadata, or sorts and accepts what it finds",
            "E_META",
            "meta-edges",
        )
    values = [
        ("lone-continuation", b"\x80"),
        ("overlong-slash", b"\xc0\xaf"),
        ("surrogate", b"\xed\xa0\x80"),
        ("above-10ffff", b"\xf4\x90\x80\x80"),
        ("cut-in-a-character", b"abc\xe2\x98"),
    ]
    for name, value in values:
        yield case(
            f"meta-utf8-{name}",
            replace(BASE, metadata={"title": value}),
            "R-5.8-4",
            f"a value that is not UTF-8: {name.replace('-', ' ')}",
            "replaces what it cannot decode, or takes CESU-8 or bytes as they are",
            "E_META",
            "meta-edges",
        )
    edges: dict[str | bytes, str | bytes] = {
        "-": "\0",
        ".": "\x7f\x80",
        "0": "\u07ff\u0800",
        "_": "\ud7ff\ue000\uffff",
        "a": "",
        "a.": "\U00010000\U0010ffff",
        "z" * 255: "\ufeff",
    }
    yield case(
        "meta-edges",
        replace(BASE, metadata=edges),
        "R-5.8-1 R-5.8-2 R-5.8-3 R-5.8-4",
        "first and last characters of each length, all punctuation in keys, a key of 255 bytes",
        "refuses non-characters, or reads the byte order mark as more than a character",
        runs=(FILE,),
    )


RECIPES: tuple[Recipe, ...] = (legal, steps, alphas, tiles, digests, digested, metadata)
