"""Streams with a palette: which slot has which entry, and how picks are stored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import (
    ADDS_YCOCG,
    DROP,
    PALETTE,
    PICKS,
    PSI_YCOCG,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "palette"
ADD = Packet(adds=numbers(3))
GROW = Packet(
    records={0: SPLIT, 1: REFINE, 2: DROP},
    psi=numbers(2, seed=1),
    adds=numbers(1, seed=2),
    level=1,
)


def entries(n: int, degree: int = 1, seed: int = 0, level: int = 0) -> Packet:
    """A packet of the palette with n entries; without any, of size 0."""
    channels = 3 * ((degree + 1) ** 2 - 1) if n else 0
    return Packet(component=PALETTE, level=level, adds=numbers(n, channels, spread=60, seed=seed))


def picks(*of_slots: int, tile: int = 0) -> Packet:
    """A packet of picks, one for each new slot; without any, of size 0."""
    return Packet(component=PICKS, picks=of_slots, tile=tile)


def with_palette(*packets: Packet, degree: int = 1, n_levels: int = 2, n_tiles: int = 1) -> Stream:
    """A stream with a palette."""
    tiles = (Tile(),) * n_tiles
    return Stream(packets, degree=degree, has_palette=True, n_levels=n_levels, tiles=tiles)


# Three splats; then one splits, one is refined, one is dropped, one is added.
BASE = with_palette(ADD, entries(4), picks(4, 0, 2), GROW, picks(1, 3))


def degrees() -> Iterator[Case]:
    """All kinds of records, each SH degree."""
    for degree in (1, 2, 3):
        packets = (ADD, entries(4, degree), picks(4, 0, 2), GROW, picks(1, 3))
        yield case(
            f"degree-{degree}",
            with_palette(*packets, degree=degree),
            "R-4.1-2 R-5.1-9 R-5.6-1 R-7.2-4 12 5.9 7.4",
            f"four entries of degree {degree}; picks of three adds, of a second child, of an add",
            "numbers entries from 0, or fills the channels of band 1 only",
        )


def slots() -> Iterator[Case]:
    """Which slot has which entry."""
    rows = [
        (
            "first-child-keeps-its-pick",
            [
                ADD,
                entries(6),
                picks(3, 1, 2),
                Packet(records={0: SPLIT, 1: SPLIT, 2: SPLIT}, psi=numbers(3, seed=1)),
                picks(4, 5, 6),
                Packet(records={3: SPLIT, 0: SPLIT}, psi=numbers(2, seed=2)),
                picks(1, 2),
            ],
            "splits of splits: the first child has the pick of its parent, the second its own",
            "gives the new pick to the first child, or to both",
        ),
        (
            "refine-keeps-its-pick",
            [
                ADD,
                entries(3),
                picks(3, 1, 2),
                Packet(records=dict.fromkeys(range(3), REFINE), psi=numbers(3), n_adds=2),
                picks(2, 0),
            ],
            "three splats are refined, and two are added",
            "takes picks for the splats that are refined",
        ),
        (
            "second-children-before-adds",
            [
                ADD,
                entries(4),
                picks(0, 0, 0),
                Packet(
                    records={2: SPLIT, 0: SPLIT}, psi=numbers(2, seed=1), adds=numbers(2, seed=2)
                ),
                picks(1, 2, 3, 4),
            ],
            "picks of two second children, in order of their parents, then of two adds",
            "takes the picks of adds first, or in the order of the parents' picks",
        ),
        (
            "drops-take-no-pick",
            [
                ADD,
                entries(4),
                picks(1, 2, 3),
                Packet(records={0: DROP, 1: SPLIT}, psi=numbers(1)),
                picks(4),
                Packet(records={2: DROP}, adds=numbers(2, seed=3)),
                picks(0, 1),
            ],
            "slots of drops stay empty, and those made after them have picks of their own",
            "takes a pick for a drop, or makes a new splat in its slot",
        ),
    ]
    for name, packets, tests, faulty in rows:
        yield case(name, with_palette(*packets, n_levels=1), "R-7.2-4 3.3 3.4 12", tests, faulty)
    cores = (ADD, replace(ADD, tile=1, adds=numbers(2, seed=5)))
    yield case(
        "two-tiles-share-it",
        with_palette(
            cores[1],
            entries(3),
            cores[0],
            picks(2, 3, tile=1),
            picks(3, 3, 1),
            replace(GROW, tile=1, records={0: SPLIT, 1: REFINE}),
            picks(1, 2, tile=1),
            n_tiles=2,
        ),
        "R-5.6-10 R-7.2-4 12",
        "two tiles pick entries of one palette, which stands before the core of tile 0",
        "keeps a palette per tile, or gives it to tile 0 only",
    )
    yield case(
        "of-a-tile-without-splats",
        with_palette(
            entries(2), replace(ADD, tile=1), picks(2, 0, 1, tile=1), n_levels=1, n_tiles=2
        ),
        "R-5.6-10 R-5.6-6 12",
        "tile 0 has the rows of the palette and nothing else: it has no slots",
        "makes slots of the entries, or wants core before the palette",
        runs=(FILE, PROGRESSIVE),
    )


def stored_picks() -> Iterator[Case]:
    """Lists of picks."""
    refines = Packet(records={0: REFINE, 2: REFINE}, psi=numbers(2, seed=1))
    splits = Packet(
        records={0: SPLIT, 1: SPLIT, 2: DROP}, psi=numbers(2, seed=1), adds=numbers(1, seed=2)
    )
    again = Packet(records={3: SPLIT, 0: SPLIT, 5: SPLIT}, psi=numbers(3, seed=3))
    last = Packet(records={7: SPLIT, 3: SPLIT}, psi=numbers(2, seed=4))
    rows = [
        (
            "picks-of-size-0",
            [ADD, entries(2), picks(), Packet(records={1: SPLIT}, psi=numbers(1)), picks(2)],
            "R-5.6-5 5.6",
            "a packet of picks without bytes: three picks of 0",
            "takes entry 1, or leaves the step out",
        ),
        (
            "picks-stored-as-zeros",
            [ADD, entries(2), replace(picks(), is_explicit=True)],
            "R-5.9-2 5.6 5.9",
            "a packet of picks whose coding byte is 0: three picks of 0",
            "takes entry 1, or wants a plane",
        ),
        (
            "picks-of-size-0-of-splits",
            [ADD, entries(4), picks(4, 0, 2), splits, picks()],
            "R-5.6-5 12 5.6",
            "two splits, a drop, an add: second children have the picks 4 and 0 of their parents",
            "gives second children the pick 0, or the add that of a splat",
        ),
        (
            "picks-of-size-0-of-splits-of-splits",
            [
                ADD,
                entries(4),
                picks(4, 0, 2),
                splits,
                picks(1, 3, 2),
                again,
                picks(),
                last,
                picks(),
            ],
            "R-5.6-5 12 5.6",
            "splits of a first child, of a second one and of an add, twice with picks of size 0",
            "takes the pick of the splat that P was split from, or forgets it after a step",
        ),
        (
            "picks-stored-as-zeros-of-splits",
            [ADD, entries(4), picks(4, 0, 2), splits, replace(picks(), is_explicit=True)],
            "R-5.9-2 12 5.9",
            "a coding byte of 0: second children have the pick 0, whatever their parents have",
            "takes the packet for one of size 0",
        ),
        (
            "picks-of-no-slots",
            [ADD, entries(2), picks(2, 0, 1), refines, picks(), GROW, picks(1, 2)],
            "R-5.6-2 R-5.6-5 5.6",
            "no slot is new in a step: its packet of picks has no bytes, and counts as a step",
            "does not count the step, and gives the next picks to it",
        ),
        (
            "picks-of-no-slots-with-bytes",
            [ADD, entries(2), picks(2, 0, 1), refines, replace(picks(), is_explicit=True)],
            "R-5.9-4 R-5.6-5 5.6",
            "a packet of picks with bytes where no slot is new",
            "refuses bytes without picks, as of core",
        ),
        (
            "picks-without-entries",
            [ADD, picks(), GROW, replace(picks(), is_explicit=True)],
            "R-7.2-4 12",
            "the palette has no packets, and all picks are 0",
            "wants an entry, or reads entry 0 of none",
        ),
        (
            "picks-with-a-palette-of-size-0",
            [ADD, entries(0), picks()],
            "R-5.6-5 R-5.6-8 R-5.6-10",
            "the palette has a packet of no entries and no bytes",
            "does not count it as a step, or wants bytes of the palette",
        ),
        (
            "picks-of-the-last-entry-of-300",
            [ADD, replace(entries(0), adds={0: range(300), 8: range(-300, 0)}), picks(300, 256, 1)],
            "R-7.2-4 7.1 7.2",
            "picks of 9 bits, in a low plane and one above",
            "undoes a zigzag of picks, or keeps them in a byte",
        ),
        (
            "picks-in-the-widest-planes",
            [ADD, entries(2), replace(picks(2, 1, 0), codings={"picks": 0x28})],
            "R-5.9-2 5.9",
            "picks of 1 and 2 in three planes of a byte each",
            "bounds the planes of picks by the number of entries",
        ),
        (
            "picks-of-three-low-bits",
            [ADD, entries(5), replace(picks(5, 3, 4), codings={"picks": 3})],
            "R-5.9-9 5.9",
            "picks of three bits, each in a byte of its own",
            "packs low planes of any width",
        ),
        (
            "picks-with-flags",
            [ADD, entries(3), replace(picks(3, 1, 2), flags=PSI_YCOCG | ADDS_YCOCG)],
            "R-4.4-1 5.9",
            "both flags of YCoCg-R in a packet of picks, where they have nothing to act on",
            "refuses them, or transforms SH or picks",
        ),
    ]
    for name, packets, rules, tests, faulty in rows:
        yield case(name, with_palette(*packets), rules, tests, faulty, runs=(FILE,))


RECIPES: tuple[Recipe, ...] = (degrees, slots, stored_picks)
