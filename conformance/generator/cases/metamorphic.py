"""One scene written in many ways: the dump is the same, whatever changed.

So are the dumps of the vectors named `quantisers-`, in which the scene is twice as large.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import (
    DROP,
    REFINE,
    SPLIT,
    Chunk,
    Packet,
    Stream,
    Tile,
    Values,
    compressed,
    raw,
    runs,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "metamorphic"
CORES = (
    Packet(adds=numbers(60, spread=3)),
    Packet(
        records={0: SPLIT, 2: REFINE, 3: SPLIT, 4: DROP},
        psi=numbers(3, seed=1),
        level=1,
        adds=numbers(1, seed=2),
    ),
    Packet(records={1: SPLIT, 5: DROP, 6: REFINE}, psi=numbers(2, seed=3), level=2),
)
TILE_0 = list(banded(CORES, 2))
TILE_1 = list(banded([replace(core, tile=1) for core in CORES[:2]], 2, seed=6))
SCENE = Stream(
    [*TILE_0, *TILE_1],
    degree=2,
    n_levels=3,
    tiles=(Tile(), Tile((9, 9, 9))),
    alphas={(1, 0): (2, [3]), (2, 4): (1, [5])},
)


def told(name: str, stream: Stream, rules: str, tests: str, faulty: str) -> Case:
    """A case of the scene told in another way."""
    return case(name, stream, rules, f"the scene, {tests}", faulty, runs=(FILE, PROGRESSIVE))


def original() -> Iterator[Case]:
    """The scene."""
    yield told(
        "original",
        SCENE,
        "R-4.1-2 7.7",
        "from which the others of the family are made",
        "gives another dump than for the others",
    )


def orders() -> Iterator[Case]:
    """Packets in other orders."""
    a, b = TILE_0, TILE_1
    core = [p for p in (*a, *b) if p.component == 0]
    bands = [p for p in (*a, *b) if p.component > 0]
    rows = [
        ("tiles-swapped", [*b, *a], "tile 1 before tile 0"),
        ("core-first", [*core, *bands], "core of all tiles before all bands"),
        (
            "bands-descending",
            [p for k in range(0, 9, 3) for p in (a[k], a[k + 2], a[k + 1])] + b,
            "band 2 before band 1 in each step",
        ),
        ("level-by-level", sorted([*a, *b], key=lambda p: _level_of(p, a, b)), "level by level"),
        (
            "bands-one-by-one",
            [
                *core,
                *[p for p in bands if p.component == 2],
                *[p for p in bands if p.component == 1],
            ],
            "band 2, then band 1",
        ),
    ]
    for name, packets, tests in rows:
        yield told(
            f"order-{name}",
            replace(SCENE, packets=packets),
            "R-5.6-2 R-5.6-3 R-6.4-2 R-7.5-1 3.5",
            tests,
            "depends on the order of the packets in the file",
        )


def _level_of(packet: Packet, *tiles: list[Packet]) -> int:
    place = tiles[packet.tile].index(packet)
    return tiles[packet.tile][place - packet.component].level


def frames() -> Iterator[Case]:
    """Planes in other frames and blocks."""
    for name, style, tests in (
        ("runs", runs, "in run-length blocks"),
        ("raw-of-7", lambda c: raw(c, 7), "in raw blocks of 7 bytes"),
        ("zstd-1", compressed(1), "compressed at level 1"),
        ("zstd-22", compressed(22), "compressed at level 22"),
        ("wide-content-size", lambda c: raw(c, width=8), "with Frame_Content_Size in 8 bytes"),
    ):
        yield told(
            f"frames-{name}",
            replace(SCENE, packets=[replace(p, style=style) for p in SCENE.packets]),
            "R-5.10-3 R-5.10-5 R-5.10-6",
            tests,
            "lacks a part of Zstandard",
        )
    codings = {
        "wide": (0x28, "every list in 8 low bits and two planes"),
        "no-low": (0x20, "every list in two planes without low bits"),
        "narrow": (0x13, "every list in 3 low bits and a plane"),
    }
    for name, (coding, tests) in codings.items():
        packets = [_coded(p, coding) for p in SCENE.packets]
        yield told(
            f"codings-{name}",
            replace(SCENE, packets=packets),
            "R-5.9-2 R-5.9-9 7.1",
            tests,
            "knows only the codings that its own encoder writes",
        )
    packets = [
        replace(p, codings={f"adds {c}": 0x68 for c in p.adds}) if p.adds else p
        for p in SCENE.packets
    ]
    yield told(
        "codings-delta",
        replace(SCENE, packets=packets),
        "R-5.9-3 R-7.1-1 7.1",
        "all adds as differences",
        "carries a sum from channel to channel",
    )


def _coded(packet: Packet, coding: int) -> Packet:
    names = [f"adds {c}" for c in packet.adds] + [f"psi {c}" for c in packet.psi]
    if packet.records:
        names.append("gaps")
        kinds = set(packet.records.values())
        names += ["kinds"] if len(kinds) > 1 else []
    return replace(packet, codings=dict.fromkeys(names, coding))


def chunks() -> Iterator[Case]:
    """Other chunks and header fields around the same packets."""
    extra = Chunk(b"teXt", b"not for you")
    rows = [
        ("unknown-first", lambda c: [extra, *c], "an unknown ancillary chunk before all others"),
        (
            "unknown-between",
            lambda c: [x for y in c for x in (y, extra)],
            "an unknown ancillary chunk behind each chunk",
        ),
        ("alfa-explicit", lambda c: c, "a table of alpha = 1 where there was none"),
    ]
    for name, edit, tests in rows:
        alphas = (
            {(0, 3): (0, [1]), **SCENE.alphas}
            if name == "alfa-explicit" and SCENE.alphas
            else SCENE.alphas
        )
        yield told(
            f"chunks-{name}",
            replace(SCENE, chunks=edit, alphas=alphas),
            "R-8.1-2 R-5.2-3 5.2" if "unknown" in name else "R-5.4-2 5.4",
            tests,
            "finds chunks by their number",
        )
    meta = replace(
        SCENE, metadata={"comment": "x" * 300}, digests={(0, 0, 2): None, (1, 2, 1): None}
    )
    yield told(
        "chunks-ancillary-first",
        replace(meta, chunks=lambda c: [*c[-2:][::-1], *c[:-2]]),
        "R-5.2-3 R-5.2-4 5.2",
        "dGST and mETa before QUAN",
        "wants QUAN at offset 64",
    )
    yield told(
        "header-other-hints",
        replace(SCENE, header={"unit": 2, "up_axis": 3, "flags": 0x7F, "version_minor": 9}),
        "R-5.1-3 R-4.4-2 5.1",
        "other hints, unused flags, minor version 9",
        "refuses or uses what it does not know",
    )
    yield told(
        "rows-other-errors",
        replace(
            SCENE, packets=[replace(p, row={"error": k * 7}) for k, p in enumerate(SCENE.packets)]
        ),
        "R-5.6-9 5.6",
        "other error hints",
        "stops where the error is small",
    )
    yield told(
        "tier-3",
        replace(SCENE, tier=3),
        "R-5.1-4 R-8.2-1 8.2",
        "tier 3",
        "supports tier 1 only and says so",
    )


def _doubled(values: Values) -> dict[int, list[int]]:
    return {c: [2 * v for v in q] for c, q in values.items() if not isinstance(q, int)}


def steps() -> Iterator[Case]:
    """The same integers by other quantisers and steps."""
    halves = {(row, c): (1, 1) for row in range(4) for c in range(7)}
    double = [
        replace(
            p,
            adds=_doubled(p.adds),
            psi=_doubled(p.psi),
        )
        for p in SCENE.packets
    ]
    yield told(
        "quantisers-e-for-m",
        replace(SCENE, quantisers=halves, packets=SCENE.packets),
        "R-5.3-1 R-5.3-2 7.3",
        "every step 2 by E",
        "mixes up M and E",
    )
    yield told(
        "quantisers-m-for-e",
        replace(SCENE, quantisers=dict.fromkeys(halves, (2, 0))),
        "R-5.3-1 R-5.3-2 7.3",
        "every step 2 by M",
        "mixes up M and E",
    )
    yield told(
        "quantisers-q-for-m",
        replace(SCENE, packets=double),
        "R-5.3-1 R-7.3-1 7.3",
        "every step 1, and q twice as large",
        "rounds q",
    )
    k_table = {(1, 0): (4, [12]), (2, 4): (3, [20])}
    yield told(
        "alpha-by-a-larger-k",
        replace(SCENE, alphas=k_table),
        "R-5.4-1 R-7.3-2 4.2 7.3",
        "the same alphas with K larger by 2",
        "rounds twice",
    )
    empty = [
        *TILE_0[:3],
        Packet(level=1),
        Packet(component=1),
        Packet(component=2),
        *TILE_0[3:],
        *TILE_1,
    ]
    yield told(
        "steps-of-nothing-between",
        replace(SCENE, packets=empty),
        "R-5.6-5 R-7.5-1 3.4",
        "a step of nothing between the first and the second",
        "shifts bands by a step",
    )


RECIPES: tuple[Recipe, ...] = (original, orders, frames, chunks, steps)
