"""Limits of the decoder's own, and small files that claim to be large."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import DROP, RLE, SPLIT, Chunk, Packet, Stream, Tile, frame
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "limits"
SCENE = Stream(
    list(banded([Packet(adds=numbers(3), tile=k % 2, level=k // 2) for k in range(4)], 1)),
    degree=1,
    n_levels=3,
    tiles=(Tile(), Tile(), Tile()),
)
# Of SCENE; the size of its chunks follows from 54 + 24 entries.
COUNTS = {
    "n_tiles": 3,
    "n_packets": 8,
    "n_levels": 3,
    "tile_steps": 2,
    "tile_slots": 6,
    "slots": 12,
}


def own_limits() -> Iterator[Case]:
    """Each limit, reached and exceeded."""
    chunks_size = 3 * 12 + (1 + 3) * 6 * 3 + 3 * 48 + 8 * 36
    for name, count in (COUNTS | {"chunks_size": chunks_size}).items():
        yield case(
            f"own-{name.replace('_', '-')}",
            SCENE,
            "R-8.3-1 R-4.1-2 8.3",
            f"`{name}` is {count}: a decoder's own limit of {count - 1}, then of {count}",
            "refuses what reaches the limit, or does not look at its own limits",
            "E_LIMIT",
            "within-all",
            runs=(
                Run(limits={name: count - 1}),
                Run(limits={name: count}),
                Run("progressive", limits={name: count - 1}),
                Run(limits={name: 0}),
                Run(level=0, limits={name: count - 1}),
            ),
        )
    yield case(
        "within-all",
        SCENE,
        "R-8.3-1 R-4.1-2 8.3",
        "all limits are those of the tier, or far above it",
        "lets its own limits replace those of the tier",
        runs=(FILE, Run(limits=dict.fromkeys([*COUNTS, "chunks_size"], 1 << 40))),
    )
    yield case(
        "own-above-the-tier",
        Stream([Packet(n_adds=1)], tiles=[Tile()] * 65),
        "R-8.2-1 R-8.3-1 8.3",
        "65 tiles in tier 1, the decoder's own limit is a million",
        "lets its own limits replace those of the tier",
        "E_TIER",
        "within-all",
        runs=(Run(limits={"n_tiles": 1000000}), Run(limits={"n_tiles": 10})),
    )
    churn = Stream(
        [
            Packet(adds=numbers(2)),
            Packet(records={0: DROP, 1: SPLIT}, psi=numbers(1)),
            Packet(records={1: DROP, 2: DROP}, adds=numbers(1, seed=1)),
        ]
    )
    yield case(
        "own-slots-of-splits-and-the-dropped",
        churn,
        "R-8.3-1 8.2 8.3",
        "four slots: two adds, a split, an add; never more than two live splats",
        "counts live splats or adds instead of slots",
        "E_LIMIT",
        "within-all",
        runs=tuple(Run(limits={name: n}) for name in ("tile_slots", "slots") for n in (3, 4)),
    )


def claims() -> Iterator[Case]:
    """Small files with large numbers."""
    top = 0xFFFFFFFF
    add = Packet(adds=numbers(1))
    rows = [
        (
            "tiles",
            Stream([add], header={"n_tiles": top}, tier=3),
            "R-8.2-1",
            "E_TIER",
            "4294967295 tiles",
        ),
        (
            "tiles-of-tier-3",
            Stream([add], header={"n_tiles": 65536}, tier=3),
            "R-5.2-5",
            "E_CHUNK",
            "65536 tiles of which one is there",
        ),
        (
            "packets",
            Stream([add], header={"n_packets": top}, tier=3),
            "R-8.2-1",
            "E_TIER",
            "4294967295 packets",
        ),
        (
            "packets-of-tier-3",
            Stream([add], header={"n_packets": 4194304}, tier=3),
            "R-5.2-5",
            "E_CHUNK",
            "4194304 packets of which one is there",
        ),
        (
            "chunks",
            Stream([add], header={"chunks_size": top}, tier=3),
            "R-8.2-1",
            "E_TIER",
            "4294967295 bytes of chunks",
        ),
        (
            "chunks-of-tier-3",
            Stream([add], header={"chunks_size": 536870912}, tier=3),
            "R-6.2-2",
            "E_TRUNCATED",
            "512 MiB of chunks of which a hundred bytes are there",
        ),
        (
            "data",
            Stream([add], header={"data_size": (1 << 64) - 1}),
            "R-5.1-8",
            "E_HEADER",
            "2^64 - 1 bytes of packets",
        ),
        (
            "adds",
            Stream([replace(add, row={"n_adds": top})], tier=3),
            "R-5.6-7",
            "E_AMPLIFICATION",
            "4294967295 adds in fifty bytes",
        ),
        (
            "packet",
            Stream([replace(add, row={"size": top})], header={"data_size": top}),
            "R-6.2-2",
            "E_TRUNCATED",
            "a packet of 4 GiB of which fifty bytes are there",
        ),
        (
            "adds-and-bytes",
            Stream(
                [replace(add, row={"size": 1 << 20, "n_adds": 1 << 24})],
                tier=3,
                header={"data_size": 1 << 20},
            ),
            "R-6.2-2",
            "E_TRUNCATED",
            "16 million adds in a packet of 1 MiB of which fifty bytes are there",
        ),
        (
            "packets-sum-above-2-to-32",
            Stream([replace(add, row={"size": top})] * 3, header={"data_size": 3 * top}, tier=3),
            "R-6.2-2 R-5.1-8",
            "E_TRUNCATED",
            "three packets of 4 GiB each",
        ),
        (
            "packets-sum-wraps",
            Stream([replace(add, row={"size": 1 << 31})] * 2, header={"data_size": 0}, tier=3),
            "R-5.1-8",
            "E_HEADER",
            "two packets of 2 GiB, `data_size` 0",
        ),
        (
            "meta",
            Stream([add], chunks=lambda c: [*c, Chunk(b"mETa", b"\1\xff\xffa")]),
            "R-5.8-1",
            "E_META",
            "a value of 65535 bytes in a chunk of four",
        ),
        (
            "alpha",
            Stream([add], chunks=lambda c: [c[0], Chunk(b"ALFA", b"\0\0\0\xff"), *c[1:]]),
            "R-5.4-3",
            "E_CHUNK",
            "256 entries in a chunk of four bytes",
        ),
        (
            "frames",
            Stream([replace(add, entries=lambda e: [(255, 0xFFFFFFF0)] * 255)]),
            "R-5.9-7",
            "E_PACKET",
            "255 frames of 255 planes and 4 GiB each",
        ),
    ]
    for name, stream, rule, code, tests in rows:
        yield case(
            f"claim-{name}",
            stream,
            rule,
            tests,
            "allocates what the file claims before it looks whether it can be",
            code,
            "core-channel-order-degree-0",
            runs=(FILE, PROGRESSIVE),
        )


def bombs() -> Iterator[Case]:
    """Files that are large when they are decoded, or would be."""
    many = 592
    yield case(
        "bomb-of-slots",
        Stream([Packet(n_adds=many, tile=k) for k in range(8)], tiles=[Tile()] * 8),
        "R-5.6-7 8.3",
        "4736 splats in 296 bytes of packets, the most that their size allows",
        "bounds the slots of a packet by less",
        runs=(FILE,),
    )

    def zeros(size: int, stated: int | None = None) -> bytes:
        blocks, left = list[tuple[int, int, bytes]](), size
        while left:
            blocks.append((RLE, min(left, 131072), b"\0"))
            left -= blocks[-1][1]
        return frame(size if stated is None else stated, blocks, width=8)

    for name, style, tests, code in (
        ("bomb-of-256-mib", lambda _: zeros(1 << 28), "256 MiB of zeros, and says so", "E_FRAME"),
        (
            "bomb-that-says-16-bytes",
            lambda c: zeros(1 << 22, len(c)),
            "4 MiB of zeros in blocks that are longer than the content",
            "E_FRAME",
        ),
        (
            "bomb-of-small-blocks",
            lambda c: frame(len(c), [(RLE, len(c), b"\0")] * 4000, width=4),
            "4000 runs as long as the content",
            "E_ZSTD",
        ),
    ):
        yield case(
            name,
            Stream(
                [Packet(n_adds=16, stored={"adds 0": [0] * 16}, codings={"adds 0": 8}, style=style)]
            ),
            "R-5.10-3"
            if "says" not in name and code == "E_FRAME"
            else "R-5.10-5"
            if code == "E_FRAME"
            else "R-5.10-6",
            f"a frame of {tests}",
            "decompresses before it compares sizes, or lets the library allocate",
            code,
            "zstd-run-blocks",
        )
    yield case(
        "chunks-of-nothing",
        Stream([Packet(n_adds=1)], chunks=lambda c: [*c, *[Chunk(b"noTe")] * 4000]),
        "R-8.1-2 R-5.2-1",
        "4000 chunks without a body",
        "takes time that is quadratic in the number of chunks",
        runs=(FILE,),
    )


RECIPES: tuple[Recipe, ...] = (own_limits, claims, bombs)
