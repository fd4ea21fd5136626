"""What every decoder does: kinds, channels, tables, components, tiles, levels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.builder import (
    ADDS_YCOCG,
    BLUE,
    DELTA,
    DROP,
    GREEN,
    OPACITY,
    PSI_YCOCG,
    RED,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    X,
    Y,
    Z,
)
from conformance.cases.case import FILE, PROGRESSIVE, VERIFY, Case, Recipe, case
from conformance.cases.scenes import SMALL, banded, n_channels, numbers, ramp

FAMILY = "core"


def empty() -> Iterator[Case]:
    """Scenes without splats."""
    yield case(
        "no-tiles",
        Stream(tiles=()),
        "R-4.1-2 5.1 7.7",
        "no tiles and no packets",
        "refuses a scene without splats, or writes a dump with a tile",
        runs=(FILE, PROGRESSIVE),
    )
    yield case(
        "tile-without-packets",
        Stream(tiles=(Tile((7, -9, 1 << 40)),)),
        "R-4.1-2 3.4 7.7",
        "a tile of which there is no packet has no slots, and still stands in the dump",
        "leaves the tile out",
    )
    yield case(
        "one-splat-of-zeros",
        Stream([Packet(n_adds=1)]),
        "R-4.1-2 R-5.6-5 5.9",
        "a splat whose integers are all 0 is stored without a frame",
        "wants at least one frame, or leaves the splat out",
    )


def channels() -> Iterator[Case]:
    """Every channel in its place."""
    for degree in range(4):
        packets = [Packet(adds=ramp(2))]
        for band in range(1, degree + 1):
            first = 100 * band
            packets.append(Packet(component=band, adds=ramp(2, n_channels(band), first)))
        yield case(
            f"channel-order-degree-{degree}",
            Stream(packets, degree=degree),
            "R-4.1-2 R-5.1-5 3.2 3.5 7.7",
            f"all numbers of two splats of SH degree {degree} are different",
            "swaps channels, or orders SH by colour before coefficient",
        )


def kinds() -> Iterator[Case]:
    """Refine, split, drop, add, alone and together."""
    three = Packet(adds=numbers(3, spread=90))
    one = [
        (
            "refine",
            REFINE,
            "a refine replaces P by P + psi",
            "makes a new slot, or replaces by psi",
        ),
        (
            "split",
            SPLIT,
            "a split without a table of alpha gives P + psi and P - psi",
            "puts C2 into the slot of the parent, or takes alpha for 1/2",
        ),
        (
            "drop",
            DROP,
            "a drop empties the slot, whose numbers become 0",
            "leaves old numbers in the dump, or moves the slots after it",
        ),
    ]
    for name, kind, tests, faulty in one:
        psi = {} if kind == DROP else numbers(1, seed=2)
        packets = [three, Packet(records={1: kind}, psi=psi)]
        rules = "R-4.1-2 R-7.2-1 3.3 7.4" + (" R-7.3-3" if kind != DROP else "")
        yield case(name, Stream(packets), rules, tests, faulty)
    yield case(
        "kinds-of-one-step",
        SMALL,
        "R-7.2-1 R-7.2-2 R-7.2-3 3.3 3.4",
        "a split, a refine and a drop in one step, the kinds stored",
        "gives psi to the drop, or reads kinds in another order than that of the slots",
    )
    yield case(
        "split-two-and-add-two",
        Stream(
            [
                Packet(adds=numbers(3)),
                Packet(records={0: SPLIT, 2: SPLIT}, psi=ramp(2, first=1), adds=ramp(2, first=50)),
            ]
        ),
        "R-7.2-1 3.4 7.4",
        "new slots are the second children in order of their parents, then the adds",
        "numbers the adds first, or the second children in another order",
    )
    yield case(
        "add-after-drop",
        Stream([Packet(adds=ramp(2)), Packet(records={0: DROP}), Packet(adds=ramp(1, first=70))]),
        "R-7.2-1 3.3",
        "an empty slot is never used again",
        "puts the new splat into the slot that a drop left empty",
    )
    yield case(
        "drop-and-add-in-one-step",
        Stream([Packet(adds=ramp(2)), Packet(records={0: DROP, 1: DROP}, adds=ramp(3, first=40))]),
        "R-7.2-1 3.3 3.4",
        "all splats are dropped while others are added",
        "counts new slots from the live splats instead of from all slots",
    )
    yield case(
        "refine-the-second-child",
        Stream(
            [
                Packet(adds=ramp(1)),
                Packet(records={0: SPLIT}, psi=ramp(1, first=3)),
                Packet(records={0: REFINE, 1: SPLIT}, psi=ramp(2, first=5)),
                Packet(records={2: REFINE}, psi=ramp(1, first=100)),
            ]
        ),
        "R-7.2-1 3.3 3.4",
        "slots made by one step are named by the next",
        "resolves records against the slots before the first step",
    )


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
    """Which row and column of STEP applies."""
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


def colours() -> Iterator[Case]:
    """YCoCg-R, of psi and of adds, of core and of a band."""
    adds = {RED: [60, -7, 5], GREEN: [-3, 9, -8], BLUE: [5, -5, 7], X: [1, 2, 3]}
    psi = {RED: [-3, 6], GREEN: [7, -7], BLUE: [-5, 3], Y: [4, 4]}
    for flags, name in ((0, "neither"), (ADDS_YCOCG, "adds"), (PSI_YCOCG, "psi"), (3, "both")):
        yield case(
            f"ycocg-{name}",
            Stream(
                [
                    Packet(adds=adds, flags=flags & ADDS_YCOCG),
                    Packet(
                        records={0: SPLIT, 1: REFINE},
                        psi=psi,
                        adds={RED: [5], BLUE: [-9]},
                        flags=flags,
                    ),
                ]
            ),
            "R-4.1-2 5.9 7.1",
            f"the flags of YCoCg-R say {name}; odd and negative integers in all three channels",
            "swaps the flags, transforms positions, or divides negative integers toward zero",
        )
    band = Packet(component=1, flags=ADDS_YCOCG, adds=numbers(3, 9, spread=77))
    yield case(
        "ycocg-of-a-band",
        Stream([Packet(adds=adds), band], degree=1),
        "R-4.1-2 5.9 7.1",
        "YCoCg-R of each coefficient of a band, not of the band 0 before it",
        "transforms the first triple only, or the channels in order of colour",
    )
    yield case(
        "ycocg-with-channels-not-stored",
        Stream([Packet(adds={BLUE: [9, -9, 1]}, flags=ADDS_YCOCG)]),
        "R-4.1-2 7.1",
        "only Cg is stored; Y and Co are 0 and take part in the transform",
        "skips the transform if a channel has the coding byte 0",
    )
    yield case(
        "ycocg-with-nothing-to-act-on",
        Stream([Packet(adds={X: [9]}, flags=ADDS_YCOCG | PSI_YCOCG)]),
        "R-4.1-2 5.9",
        "a flag that has nothing to act on is allowed",
        "refuses the flag of psi in a packet without psi",
    )


def deltas() -> Iterator[Case]:
    """Adds as differences."""
    walk = [5, 9, -4, -4, 100, 99, -128]
    yield case(
        "delta-of-adds",
        Stream(
            [
                Packet(
                    adds={X: walk, Y: walk, Z: walk},
                    codings={"adds 0": 0x18 | DELTA, "adds 2": 0x14 | DELTA},
                )
            ]
        ),
        "R-5.9-3 R-7.1-1 7.1",
        "two channels store differences, the one between them does not",
        "applies the bit to all channels, or starts the sums at the second integer",
    )
    yield case(
        "delta-before-ycocg",
        Stream(
            [
                Packet(
                    adds={RED: walk, GREEN: walk[::-1], BLUE: walk},
                    codings={"adds 11": 0x18 | DELTA, "adds 13": 0x18 | DELTA},
                    flags=ADDS_YCOCG,
                )
            ]
        ),
        "R-7.1-1 7.1",
        "sums are taken before YCoCg-R",
        "inverts YCoCg-R first",
    )
    yield case(
        "delta-beyond-24-bits",
        Stream(
            [
                Packet(
                    adds={X: [8388607 * k for k in range(1, 33)]}, codings={"adds 0": 0x28 | DELTA}
                )
            ]
        ),
        "R-7.1-1 R-7.3-1",
        "sums of differences reach 268435424, more than a stored integer can hold",
        "keeps sums in 24 bits",
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
    empty,
    channels,
    kinds,
    alphas,
    quantisers,
    colours,
    deltas,
    tiles_and_levels,
    bands,
    digests_and_text,
)
