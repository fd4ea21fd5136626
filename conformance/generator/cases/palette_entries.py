"""Streams with a palette: how entries are stored and quantised."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import ADDS_YCOCG, DELTA, PSI_YCOCG, Stream
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.palette import ADD, BASE, GROW, entries, picks, with_palette

FAMILY = "palette"


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


RECIPES: tuple[Recipe, ...] = (stored_entries, quantised)
