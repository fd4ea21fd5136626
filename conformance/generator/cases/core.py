"""What every decoder does: kinds, channels, tables, components, tiles, levels."""

from __future__ import annotations

from collections.abc import Iterator

from conformance.generator.builder import (
    ADDS_YCOCG,
    BLUE,
    DELTA,
    DROP,
    GREEN,
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
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import SMALL, n_channels, numbers, ramp

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
    yield case(
        "ycocg-of-zeros",
        Stream([Packet(n_adds=1, flags=ADDS_YCOCG | PSI_YCOCG)]),
        "R-4.1-2 5.9",
        "both flags in a packet without planes",
        "refuses a flag where nothing is stored",
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


RECIPES: tuple[Recipe, ...] = (
    empty,
    channels,
    kinds,
    colours,
    deltas,
)
