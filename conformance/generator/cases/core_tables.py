"""Tables, tiles, levels, bands, digests: what decides how integers are read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import DROP, OPACITY, REFINE, SPLIT, Packet, Stream, Tile, X
from conformance.generator.cases.case import FILE, PROGRESSIVE, VERIFY, Case, Recipe, case
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "core"


def alphas() -> Iterator[Case]:
    """Tables of alpha by level, group and index."""
    seeds = Packet(adds=numbers(3))
    for group, name in enumerate(("position", "rotation", "scale", "opacity", "sh")):
        yield case(
            f"alpha-{name}",
            Stream(
                [
                    seeds,
                    Packet(
                        records={0: SPLIT, 2: SPLIT},
                        psi=numbers(2, seed=4, spread=99),
                        alpha={group: [1, 2]},
                    ),
                ],
                alphas={(0, group): (3, [8, 5, -11])},
            ),
            "R-5.4-1 R-7.2-3 5.4 7.3",
            f"a table of alpha for {name} only; the other groups split by alpha = 1",
            "uses the table for other groups too, or one index for all groups",
        )
    split = Packet(records={0: SPLIT}, psi=numbers(1, seed=5, spread=500))
    yield case(
        "alpha-by-level",
        Stream(
            [seeds, split, replace(split, level=1), replace(split, level=2)],
            n_levels=3,
            alphas={(0, 0): (0, [2]), (1, 0): (1, [3]), (1, 4): (2, [-1]), (2, 4): (1, [5])},
        ),
        "R-5.4-2 5.4",
        "each level has tables of its own, and some groups have none",
        "uses the tables of level 0, or those of the level before where one is missing",
    )
    yield case(
        "alpha-entries-256",
        Stream(
            [
                seeds,
                Packet(records={0: SPLIT, 1: SPLIT}, psi=numbers(2, seed=3), alpha={1: [255, 128]}),
            ],
            alphas={(0, 1): (6, list(range(-128, 128)))},
        ),
        "R-5.4-3 R-7.2-3",
        "a table of 256 entries, the last of them used",
        "reads the number of entries as `last`, or keeps it in 8 bits",
    )
    yield case(
        "alpha-indices-in-slot-order",
        Stream(
            [
                Packet(adds=numbers(5)),
                Packet(
                    records={0: SPLIT, 1: REFINE, 2: SPLIT, 3: DROP, 4: SPLIT},
                    psi=numbers(4, seed=9, spread=300),
                    alpha={g: [g % 3, 2, 1] for g in range(5)},
                ),
            ],
            alphas={(0, g): (2, [g + 3, -g, 7 - g]) for g in range(5)},
        ),
        "R-7.2-2 R-7.2-3 5.9",
        "splits between refines and drops, each with indices of its own in all groups",
        "counts alpha indices over all records instead of over splits",
    )


def quantisers() -> Iterator[Case]:
    """Which row and column of QUAN applies."""
    steps = {(row, c): (1 + 3 * row + 7 * c, (row + c) % 3) for row in range(4) for c in range(8)}
    cores = [
        Packet(adds=numbers(2)),
        Packet(
            records={0: SPLIT, 1: REFINE}, psi=numbers(2, seed=1), adds=numbers(1, seed=2), level=1
        ),
    ]
    for degree in (0, 3):
        yield case(
            f"steps-by-class-and-level-degree-{degree}",
            Stream(list(banded(cores, degree)), degree=degree, n_levels=3, quantisers=steps),
            "R-5.3-1 R-5.3-2 3.2 5.3",
            f"{5 + degree} classes with steps of their own in each level; adds use the row of adds",
            "uses the row of the level for adds, one row too few, or one class for all SH",
        )
    late = [Packet(adds=numbers(1), level=1), Packet(records={0: REFINE}, psi=numbers(1), level=2)]
    yield case(
        "steps-of-a-band-by-the-level-of-core",
        Stream(list(banded(late, 1)), degree=1, n_levels=3, quantisers=steps),
        "R-5.6-4 5.3",
        "the rows of a band say level 0, and use the steps of the level of their core row",
        "uses the steps of level 0 for the psi of a band",
    )


def tiles_and_levels() -> Iterator[Case]:
    """Several tiles, several levels."""
    a, b = Packet(adds=numbers(2)), Packet(adds=numbers(3, seed=7), tile=1)
    more = Packet(records={0: SPLIT, 1: DROP}, psi=numbers(1, seed=3), level=1)
    yield case(
        "two-tiles",
        Stream(
            [b, a, replace(more, tile=1), more],
            n_levels=2,
            tiles=(Tile((1000, -1, 5)), Tile((-(1 << 33), 2, 3))),
        ),
        "R-5.1-8 R-5.6-1 R-5.6-3 3.5",
        "packets of two tiles interleaved, the second tile first",
        "keeps one array of slots for all tiles, or dumps tiles in order of arrival",
        runs=(FILE, *(replace(FILE, level=k) for k in range(1)), PROGRESSIVE),
    )
    chain = [
        a,
        *(replace(more, records={k: SPLIT}, level=level) for k, level in enumerate((0, 1, 1, 3))),
    ]
    yield case(
        "levels-repeated-and-left-out",
        Stream(chain, n_levels=5),
        "R-5.6-3 3.4 3.6",
        "two steps of level 1, none of levels 2 and 4",
        "takes the level for the number of the step",
        runs=(FILE, *(replace(FILE, level=k) for k in range(5))),
    )
    yield case(
        "levels-that-differ-between-tiles",
        Stream(
            [
                a,
                b,
                replace(more, level=2),
                replace(more, tile=1),
                replace(more, tile=1, records={2: REFINE}, level=2),
            ],
            n_levels=3,
            tiles=(Tile(), Tile()),
        ),
        "R-5.6-3 3.4 3.6",
        "a tile without a step of level 1 stands still there",
        "counts steps over all tiles, or cuts both tiles at the same step",
    )
    refined = Packet(records={2: REFINE}, psi=numbers(1, seed=2), level=2)
    few = [*banded([Packet(adds=numbers(2)), replace(more, records={0: DROP}, psi={}, level=2)], 1)]
    many = [
        Packet(adds=numbers(2)),
        replace(more, level=0),
        replace(more, records={2: SPLIT}),
        refined,
    ]
    yield case(
        "levels-of-bands-in-two-tiles",
        Stream(
            [*few, *banded([replace(core, tile=1) for core in many], 1, seed=3)],
            degree=1,
            n_levels=3,
            tiles=(Tile(), Tile()),
        ),
        "R-5.6-3 3.6",
        "tile 1 has more steps in each level than tile 0, and as many packets of a band",
        "cuts the bands of all tiles where those of tile 0 end",
    )


def bands() -> Iterator[Case]:
    """SH bands."""
    cores = [
        Packet(adds=numbers(3)),
        Packet(
            records={0: SPLIT, 1: REFINE, 2: DROP},
            psi=numbers(2, seed=1),
            adds=numbers(1, seed=3),
            alpha={4: [1], 0: [1]},
            level=1,
        ),
    ]
    table = {(1, 0): (1, [1, 5]), (1, 4): (3, [-3, 13])}
    for degree in (1, 2, 3):
        yield case(
            f"bands-degree-{degree}",
            Stream(list(banded(cores, degree)), degree=degree, n_levels=2, alphas=table),
            "R-4.1-2 5.9 7.4",
            f"kinds, slots and alpha of core apply to {degree} bands",
            "splits a band by alpha of position, or by alpha = 1",
        )
    yield case(
        "band-of-size-0",
        Stream(
            [cores[0], Packet(component=1, adds=numbers(3, 9)), cores[1], Packet(component=1)],
            degree=1,
            n_levels=2,
            alphas=table,
        ),
        "R-5.6-5 R-5.6-8 5.6",
        "a packet of a band with size 0: its psi and adds are 0, and its splits copy",
        "skips the packet, so that new slots have no SH of their own or later steps are shifted",
    )
    yield case(
        "band-of-zeros-in-full",
        Stream(
            [
                cores[0],
                Packet(component=1, is_explicit=True),
                cores[1],
                Packet(component=1, is_explicit=True),
            ],
            degree=1,
            n_levels=2,
            alphas=table,
        ),
        "R-4.1-2 R-5.9-8 5.9",
        "packets of a band with coding bytes 0 and no frame",
        "wants a frame, or refuses a packet that could have been left out",
    )
    yield case(
        "bands-not-in-the-file",
        Stream(cores, degree=3, n_levels=2, alphas=table),
        "R-4.1-2 7.5 7.7",
        "the header says SH degree 3, no packet of a band is there: their SH are 0",
        "leaves the channels out of the dump",
    )
    refine = Packet(records={3: REFINE}, psi=numbers(1, seed=8), level=1)
    last = Packet(component=1, psi=numbers(1, 9, seed=8))
    yield case(
        "band-of-size-0-whose-slots-are-named-later",
        Stream(
            [
                cores[0],
                Packet(component=1, adds=numbers(3, 9)),
                cores[1],
                Packet(component=1),
                refine,
                last,
            ],
            degree=1,
            n_levels=2,
            alphas=table,
        ),
        "R-5.6-5 5.6 7.4",
        "a packet of a band refines a slot that a step made whose packet of the band has no bytes",
        "does not make the slots of the band, and finds none",
    )


def digests_and_text() -> Iterator[Case]:
    """Right digests, metadata, what the header says of the scene."""
    cores = [Packet(adds=numbers(3)), Packet(records={0: SPLIT, 2: DROP}, psi=numbers(1, seed=1))]
    every = {(0, component, step): None for component in range(3) for step in range(2)}
    yield case(
        "digests-of-every-packet",
        Stream(list(banded(cores, 2)), degree=2, digests=every),
        "R-5.7-1 R-5.7-2 R-5.7-3 R-5.7-4 7.7",
        "a digest for each state of each component",
        "leaves `born_from` or the slots of the step out, or hashes shown SH",
        runs=(VERIFY, FILE),
    )
    late = [*cores, Packet(component=1, adds=numbers(3, 9))]
    yield case(
        "digest-of-a-late-band",
        Stream(late, degree=1, digests={(0, 0, 1): None, (0, 1, 0): None}),
        "R-5.7-3 R-5.7-4 7.7",
        "the digest of a band after its step 0, which came after step 1 of core",
        "hashes the band with the slots of core, or with dropped slots as they were",
        runs=(VERIFY,),
    )
    yield case(
        "metadata",
        Stream(
            [cores[0]],
            metadata={"author": "", "licence": "CC0-1.0", "title": "Fünf \u2603 \U0001f30d\n"},
        ),
        "R-5.8-1 R-5.8-2 R-5.8-3 R-5.8-4",
        "an empty value, and one with characters of two, three and four bytes and a line feed",
        "counts characters instead of bytes, or refuses control characters",
    )
    for name, fields in {
        "known": {"coordinate_system": 3, "up_axis": 4, "unit": 5, "colour_space": 2, "flags": 1},
        "unknown": {"coordinate_system": 6, "up_axis": 7, "unit": 255, "colour_space": 3},
    }.items():
        yield case(
            f"registries-{name}",
            Stream([cores[0]], header=fields),
            "R-4.1-2 5.1 8.4",
            f"{name} values of the registries change no integer",
            "refuses an unknown value, or turns axes while it decodes",
        )
    yield case(
        "error-hints",
        Stream([replace(p, row={"error": e}) for p, e in zip(cores, (0, 123456789), strict=True)]),
        "R-5.6-9",
        "errors that rise from packet to packet",
        "takes the hint for a count, or stops where the error is small enough",
    )
    yield case(
        "grid-exponents",
        Stream([cores[0]], grid=(-16, 40, -1, 0, 17)),
        "R-5.1-7 7.7",
        "negative grid exponents stand in the dump, and change no integer",
        "scales the integers",
    )
    yield case(
        "opacity-and-rotation-zero",
        Stream([Packet(adds={X: [5], OPACITY: [-300]})]),
        "R-4.1-2 3.1",
        "the zero quaternion is a legal rotation",
        "normalises while it decodes, or refuses it",
    )


RECIPES: tuple[Recipe, ...] = (
    alphas,
    quantisers,
    tiles_and_levels,
    bands,
    digests_and_text,
)
