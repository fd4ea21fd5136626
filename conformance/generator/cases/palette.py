"""Streams with a palette: which slot has which entry, and how entries and picks are stored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import (
    ADDS_YCOCG,
    DELTA,
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


def stored_entries() -> Iterator[Case]:
    """Lists of entries."""
    triples = {c: [9 - c, 40 * (c - 4), 3, -c] for c in range(9)}
    sums = {c: [100 * c, 100 * c + 7, -3000, 5 - c] for c in range(9)}
    deltas = {f"adds {c}": 0x18 | DELTA for c in range(9)}
    step = replace(entries(0), adds={0: [1] * 4, 8: [-1] * 4})
    rows = [
        (
            "entries-in-three-packets",
            [entries(2), ADD, entries(1, seed=1), GROW, entries(2, seed=2), picks(1, 3, 5),
             picks(2, 4)],
            "R-5.6-10 R-7.2-4 12 7.4",
            "entries of three packets, numbered through; core packets stand between them",
            "begins anew with each packet, or keeps the last one only",
        ),
        (
            "entries-as-differences",
            [ADD, replace(entries(0), adds=sums, codings=deltas), picks(4, 3, 2)],
            "R-5.9-3 7.1 5.9",
            "all entries are stored as differences",
            "ignores `delta` of entries, or refuses it as of psi",
        ),
        (
            "entries-of-a-second-packet-as-differences",
            [ADD, replace(step, codings={"adds 0": 2 | DELTA, "adds 8": 2 | DELTA}),
             replace(entries(0), adds=sums, codings=deltas), picks(8, 5, 6)],
            "R-5.9-3 7.1",
            "two packets of differences: the second begins with 0",
            "goes on from the last entry of the packet before",
        ),
        (
            "entries-of-ycocg",
            [ADD, replace(entries(0), adds=triples, flags=ADDS_YCOCG), picks(1, 2, 4)],
            "R-4.1-2 7.1 5.9",
            "Y, Co and Cg of three triples, odd and negative",
            "takes them for R, G, B, or transforms the first triple only",
        ),
        (
            "entries-of-ycocg-as-differences",
            [ADD, replace(entries(0), adds=sums, flags=ADDS_YCOCG, codings=deltas),
             picks(2, 3, 4)],
            "R-5.9-3 7.1",
            "differences of Y, Co and Cg: sums first, then colours",
            "transforms colours before it sums",
        ),
        (
            "entries-with-the-flag-of-psi",
            [ADD, replace(entries(0), adds=triples, flags=PSI_YCOCG), picks(1, 2, 4)],
            "R-4.1-2 7.1 5.9",
            "the flag of psi in a packet of the palette, which has no psi",
            "lets either flag transform entries",
        ),
        (
            "entries-of-zeros",
            [ADD, replace(entries(0), n_adds=3, is_explicit=True), picks(1, 3, 2)],
            "R-5.6-5 5.9",
            "three entries of 0, stored in eleven bytes without a frame",
            "wants a frame, or counts entries by planes",
        ),
        (
            "entries-in-several-frames",
            [ADD, replace(entries(3), frames=(1, 5, 3)), picks(3, 2, 1)],
            "R-5.9-7 5.10",
            "nine planes of entries in three frames",
            "reads the first frame only",
        ),
        (
            "entries-no-one-picks",
            [ADD, entries(3), GROW],
            "R-4.1-2 3.6 7.5",
            "three entries and no packet of picks: SH above band 0 are 0",
            "shows entry 1, or refuses entries that are not used",
        ),
        (
            "entries-of-a-scene-without-splats",
            [entries(3)],
            "R-5.6-2 R-5.6-6 12",
            "three entries and nothing else",
            "makes three slots, or wants core before the palette",
        ),
    ]  # fmt: skip
    for name, packets, rules, tests, faulty in rows:
        yield case(name, with_palette(*packets), rules, tests, faulty, runs=(FILE,))
    yield case(
        "entries-176-in-11-bytes",
        with_palette(ADD, replace(entries(0), n_adds=176, is_explicit=True), picks(176, 1, 0)),
        "R-5.6-7",
        "176 entries of 0 in 11 bytes, 16 for each",
        "bounds entries by less than records",
        runs=(FILE,),
    )
    yield case(
        "no-tiles",
        Stream(tiles=(), degree=1, has_palette=True),
        "R-5.1-9 R-4.1-2 5.1",
        "bit 8 of the flags of a stream without tiles and packets",
        "wants a packet of the palette",
        runs=(FILE, PROGRESSIVE),
    )
    yield case(
        "with-unused-flags",
        replace(BASE, header={"flags": 0x1FF}),
        "R-4.4-2 R-5.1-9 5.1",
        "bit 8 and all unused flags",
        "compares `flags` with 256",
        runs=(FILE,),
    )


def quantised() -> Iterator[Case]:
    """Steps of the quantiser, and ranges."""
    steps = {(0, 5): (3, 1), (0, 6): (7, 0), (0, 7): (1, 4), (0, 4): (2, 0)}
    psi = {(row, c): (11 + row, c) for row in (1, 2) for c in range(4, 8)}
    yield case(
        "quantisers-of-each-band",
        replace(
            with_palette(ADD, entries(3, 3), picks(1, 2, 3), GROW, picks(2, 1), degree=3),
            quantisers=steps | psi,
        ),
        "R-5.3-1 5.3 7.4",
        "steps of adds of bands 1, 2 and 3, others of psi and of band 0",
        "uses the steps of psi, of the level, or those of one band for all",
    )
    yield case(
        "quantisers-of-psi-beyond-all-ranges",
        replace(BASE, quantisers={(row, 5): (65535, 24) for row in (1, 2)}),
        "R-7.3-1 5.3",
        "steps of psi with which no integer but 0 is in range: SH of a palette have no psi",
        "uses them for entries, or for the SH of second children",
    )
    top = 1 << 28
    multiples = [k * ((1 << 23) - 1) for k in range(1, 33)]
    wide = {f"adds {c}": 0x28 | DELTA for c in (0, 8)}
    yield case(
        "entries-at-their-limits",
        with_palette(
            ADD,
            replace(
                entries(0),
                adds={0: [*multiples, top], 8: [*(-q for q in multiples), -top]},
                codings=wide,
            ),
            picks(33, 32, 1),
        ),
        "R-7.1-1 R-7.3-1 7.3",
        "entries of 2^28 and -2^28, as sums of differences",
        "bounds entries as integers of a plane, of 2^23",
        runs=(FILE,),
    )


RECIPES: tuple[Recipe, ...] = (degrees, slots, stored_picks, stored_entries, quantised)
