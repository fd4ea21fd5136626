"""Faults of streams with a palette, and two faults of which the first is reported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import DELTA, PALETTE, REFINE, Packet, Stream, build, raw
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.palette import ADD, BASE, GROW, entries, picks, with_palette
from conformance.generator.cases.scenes import SMALL, numbers

FAMILY = "palette"
TWIN = "degree-1"  # BASE
Row = tuple[str, Stream, str, str, str, str]  # name, stream, rules, code, what, mistake


def refused(rows: list[Row], *runs: Run) -> Iterator[Case]:
    """A case of each row."""
    for name, stream, rules, code, tests, faulty in rows:
        yield case(name, stream, rules, tests, faulty, code, TWIN, runs=runs or (FILE, PROGRESSIVE))


def header() -> Iterator[Case]:
    """Bit 8 of `flags`."""
    yield from refused([
        ("of-degree-0", replace(SMALL, header={"flags": 1 << 8}), "R-5.1-9", "E_HEADER",
         "bit 8 of the flags, and no SH above band 0", "takes bit 8 for a reserved or unused one"),
        ("of-degree-0-with-picks", with_palette(ADD, picks(1, 0, 1), degree=0), "R-5.1-9 R-6.1-1",
         "E_HEADER", "bit 8 of the flags of degree 0, and a packet of component 4",
         "finds the packet first"),
        ("of-degree-0-and-tiles", replace(SMALL, header={"flags": 1 << 8, "n_tiles": 65}),
         "R-5.1-9 R-6.1-1 6.1", "E_HEADER", "bit 8 of the flags of degree 0, and 65 tiles",
         "checks limits before the flags"),
        ("reserved-flag-and-degree-0", replace(SMALL, header={"flags": 3 << 8}),
         "R-4.4-1 R-6.1-1 6.1", "E_RESERVED", "bits 8 and 9 of the flags of degree 0",
         "looks at bit 8 before reserved bits"),
        ("reserved-flag-9", replace(BASE, header={"flags": 3 << 8}), "R-4.4-1", "E_RESERVED",
         "bits 8 and 9 of the flags, degree 1", "masks reserved flags with 0xFC00"),
    ])  # fmt: skip


def chains() -> Iterator[Case]:
    """Components and places of rows."""
    yield from refused([
        ("component-3", with_palette(ADD, Packet(component=3, n_adds=0, row={"component": 3}),
                                     degree=3),
         "R-5.6-1", "E_CHAIN", "a row of component 3, degree 3", "takes it for SH band 3"),
        ("band-1-beside-picks", with_palette(ADD, Packet(component=1, adds=numbers(3, 9))),
         "R-5.6-1", "E_CHAIN", "a row of component 1, degree 1",
         "takes it for picks, as draft 1 did, or for SH band 1"),
        ("component-6", with_palette(ADD, entries(2), Packet(row={"component": 6})), "R-5.6-1",
         "E_CHAIN", "a row of component 6", "has no upper end of components"),
        ("picks-without-a-palette", Stream([ADD, picks(1, 0, 1)], degree=3), "R-5.6-1", "E_CHAIN",
         "a row of component 4, degree 3, and bit 8 is not set", "takes it for SH band 4"),
        ("rows-without-the-flag", replace(BASE, header={"flags": 0}), "R-5.6-1", "E_CHAIN",
         "rows of picks and of the palette, degree 1, and bit 8 is not set",
         "tells a palette by its rows"),
        ("picks-before-core", with_palette(entries(2), picks(1, 2, 0), ADD), "R-5.6-2", "E_CHAIN",
         "picks before the core of their tile", "lets them wait, as if they had come early"),
        ("picks-twice-for-a-step", with_palette(ADD, entries(2), picks(1, 2, 0), picks(1), GROW),
         "R-5.6-2", "E_CHAIN", "a second packet of picks before the second of core",
         "counts chains at the end only"),
        ("picks-of-another-tile",
         with_palette(ADD, entries(2), picks(1, 2, 0, tile=1), n_tiles=2), "R-5.6-2", "E_CHAIN",
         "picks of a tile that has no core", "counts core packets of all tiles"),
        ("palette-of-tile-1",
         with_palette(ADD, replace(entries(2), tile=1), picks(1, 2, 0), n_tiles=2), "R-5.6-10",
         "E_CHAIN", "a row of the palette that says tile 1", "takes the palette from any tile"),
        ("palette-of-size-0-of-tile-1",
         with_palette(ADD, replace(entries(0), tile=1), picks(), n_tiles=2), "R-5.6-10", "E_CHAIN",
         "a row of the palette without entries that says tile 1", "looks at rows with entries"),
        ("palette-of-no-tile", with_palette(replace(entries(2), tile=1)), "R-5.6-1", "E_CHAIN",
         "a row of the palette that says a tile that is none", "does not look at its tile"),
    ])  # fmt: skip


def counts() -> Iterator[Case]:
    """Counts of rows of picks and of the palette."""
    rows: list[Row] = [
        (f"picks-with-{name.replace('_', '-')}",
         with_palette(ADD, entries(2), replace(picks(1, 2, 0), row={name: 1})), "R-5.6-4",
         "E_COUNT", f"the row of picks says `{name}` 1", "takes the number of picks from their row")
        for name in ("n_adds", "n_splits", "level")
    ]  # fmt: skip
    rows += [
        (f"palette-with-{name.replace('_', '-')}",
         with_palette(ADD, replace(entries(2), row={name: 1}), picks(1, 2, 0)), "R-5.6-4",
         "E_COUNT", f"a row of the palette says `{name}` 1", "allows what core has")
        for name in ("n_splits", "n_refines", "n_drops")
    ]  # fmt: skip
    yield from refused([
        *rows,
        ("entries-without-bytes", with_palette(ADD, replace(entries(2), edit=lambda _: b"")),
         "R-5.6-5", "E_COUNT", "a row of the palette of two entries and no bytes",
         "takes all entries for 0"),
        ("bytes-without-entries", with_palette(ADD, Packet(component=PALETTE, is_explicit=True)),
         "R-5.6-5", "E_COUNT", "a row of the palette of 11 bytes and no entries",
         "skips the packet"),
        ("entries-are-no-splats",
         with_palette(entries(4), Packet(records={0: REFINE}, psi=numbers(1))), "R-5.6-6",
         "E_COUNT", "four entries, then a refine where no splat is", "counts entries as splats"),
        ("entries-beside-three-splats",
         with_palette(ADD, entries(1), Packet(records=dict.fromkeys(range(4), REFINE))), "R-5.6-6",
         "E_COUNT", "three splats and an entry, then four refines", "counts entries as splats"),
        ("entries-177-in-11-bytes",
         with_palette(ADD, replace(entries(0), n_adds=177, is_explicit=True)), "R-5.6-7",
         "E_AMPLIFICATION", "177 entries in 11 bytes", "has no bound on entries"),
        ("crc-of-an-empty-palette", with_palette(ADD, replace(entries(0), row={"crc": 1})),
         "R-5.6-8 R-6.3-1", "E_CRC", "a row of the palette of size 0 with a checksum of 1",
         "does not check packets of size 0"),
    ])  # fmt: skip


def limits() -> Iterator[Case]:
    """Entries are bounded like the slots of a tile, and are among those of all."""
    stream = with_palette(
        ADD,
        entries(4),
        replace(ADD, tile=1),
        entries(2, seed=1),
        picks(1, 2, 6),
        picks(3, 4, 5, tile=1),
        n_tiles=2,
    )
    rows = [
        ("tile-slots", 6, "tiles have three slots, and there are six entries in two packets"),
        ("slots", 12, "two tiles have three slots each, and there are six entries"),
        ("tile-steps", 2, "the palette has two steps, each tile one"),
    ]
    for name, most, tests in rows:
        limit = name.replace("-", "_")
        yield case(
            f"limit-of-{name}",
            stream,
            "R-8.3-1 R-4.1-2 8.2 8.3",
            f"{tests}: limits of {most - 1} and of {most}",
            "counts no entries, those of a packet, or entries and slots of tile 0 together",
            "E_LIMIT",
            TWIN,
            runs=(
                Run(limits={limit: most - 1}),
                Run(limits={limit: most}),
                Run(level=0, limits={limit: most - 1}),
            ),
        )

    def claim(n: int) -> Stream:
        row = {"n_adds": n, "size": 65537}
        packet = Packet(component=PALETTE, edit=lambda _: b"", row=row)
        return replace(with_palette(ADD, packet), header={"data_size": 65537 + len(_bodies(ADD))})

    yield from refused([
        ("limit-of-the-tier", claim((1 << 20) + 1), "R-8.2-1 R-5.6-7 8.2", "E_TIER",
         "1048577 entries, one more than a tile has slots; they are not there",
         "counts slots without entries, or looks for the packet first"),
        ("limit-of-the-tier-reached", claim(1 << 20), "R-8.2-1 R-6.2-2 8.2", "E_TRUNCATED",
         "1048576 entries, as many as a tile has slots, and three splats; they are not there",
         "counts entries and slots of tile 0 together"),
        ("limit-of-steps-of-the-tier", with_palette(*[entries(0)] * 1025), "R-8.2-1 8.2", "E_TIER",
         "1025 packets of the palette in tier 1", "has no bound on the palette"),
    ], FILE)  # fmt: skip
    yield case(
        "steps-1024",
        with_palette(*[entries(0)] * 1024, ADD),
        "R-8.2-1 8.2",
        "1024 packets of the palette, of size 0, and one of core",
        "counts steps of the palette and of core together",
        runs=(FILE,),
    )


def _bodies(*packets: Packet) -> bytes:
    """The bytes of packets of a stream."""
    data = build(with_palette(*packets))
    return data[64 + int.from_bytes(data[32:36], "little") :]


def packets() -> Iterator[Case]:
    """Packet headers."""

    def with_picks(**changes: object) -> Stream:
        made = replace(picks(1, 2, 0), **changes)  # type: ignore[arg-type]
        return with_palette(ADD, entries(2), made)

    def with_entries(**changes: object) -> Stream:
        made = replace(entries(2), **changes)  # type: ignore[arg-type]
        return with_palette(ADD, made, picks(1, 2, 0))

    nothing_new = Packet(records={0: REFINE}, psi=numbers(1))
    yield from refused([
        ("picks-of-two-bytes", with_picks(edit=lambda b: b[:2]), "R-5.9-1", "E_PACKET",
         "a packet of picks without its coding byte", "reads past the packet"),
        ("picks-with-codings-of-a-band", with_picks(edit=lambda b: b[:3] + bytes(17) + b[3:]),
         "R-5.9-7 R-5.9-8", "E_PACKET", "picks with the 18 coding bytes of band 1",
         "reads as many coding bytes as a band has"),
        ("palette-of-ten-bytes", with_entries(edit=lambda b: b[:10]), "R-5.9-1", "E_PACKET",
         "a packet of the palette without its last coding byte", "reads past the packet"),
        ("picks-with-reserved-flag", with_picks(flags=8), "R-4.4-1", "E_RESERVED",
         "the lowest reserved flag in a packet of picks", "does not look at flags of picks"),
        ("palette-with-reserved-flag", with_entries(flags=128), "R-4.4-1", "E_RESERVED",
         "a reserved flag in a packet of the palette", "looks at the two flags only"),
        ("picks-with-low-9", with_picks(coding_bytes={"picks": 9}), "R-5.9-2", "E_PACKET",
         "picks of 9 low bits", "takes any number of low bits"),
        ("entries-with-delta-alone", with_entries(coding_bytes={"adds 3": DELTA}), "R-5.9-2",
         "E_PACKET", "entries with `delta` and no planes", "takes them for zeros"),
        ("picks-with-delta", with_picks(codings={"picks": 2 | DELTA}), "R-5.9-3", "E_PACKET",
         "picks with `delta`", "sums picks, or ignores the bit"),
        ("picks-of-no-slots-with-a-coding",
         with_palette(ADD, entries(2), picks(1, 2, 0), nothing_new,
                      replace(picks(), is_explicit=True, coding_bytes={"picks": 1})),
         "R-5.9-4", "E_PACKET", "no slot is new, and the coding byte of picks is 1",
         "ignores the coding of a list without integers"),
        ("entries-with-a-plane-less", with_entries(entries=lambda e: [(8, e[0][1])]), "R-5.9-7",
         "E_PACKET", "a frame that says 8 of the 9 planes of entries",
         "does not count the planes of entries"),
        ("picks-with-bits-of-no-slot", with_picks(style=lambda c: raw(bytes([c[0] | 0x80]))),
         "R-5.9-9", "E_PACKET", "bits of the low plane of picks that belong to no pick",
         "does not look at the bits behind the picks"),
        ("entries-of-a-wrong-size", with_entries(style=lambda c: raw(c + b"\0")), "R-5.10-3",
         "E_FRAME", "a frame of entries that gives a byte too many",
         "takes the number of entries from the frame"),
    ])  # fmt: skip


def values() -> Iterator[Case]:
    """Picks that are none, and entries out of their range."""
    multiples = [k * ((1 << 23) - 1) for k in range(1, 34)]
    yield from refused([
        ("pick-of-entry-3-of-2", with_palette(ADD, entries(2), picks(1, 2, 3)), "R-7.2-4",
         "E_INDEX", "the third pick is of entry 3, and there are two",
         "compares with the number of entries inclusively from 0, or shows zeros"),
        ("pick-of-a-second-child-above",
         with_palette(ADD, entries(2), picks(1, 2, 0), GROW, picks(3, 0)), "R-7.2-4", "E_INDEX",
         "the pick of a second child is above the entries", "checks picks of the first step only"),
        ("pick-without-entries", with_palette(ADD, picks(0, 1, 0)), "R-7.2-4", "E_INDEX",
         "a pick of 1 and no palette", "takes entry 1 for 0 where there is no palette"),
        ("pick-of-65537-of-2", with_palette(ADD, entries(2), picks(1, (1 << 16) + 1, 0)), "R-7.2-4",
         "E_INDEX", "a pick of 65537, and there are two entries", "keeps picks in 16 bits"),
        ("pick-of-257-of-1", with_palette(ADD, entries(1), picks(1, 257, 0)), "R-7.2-4",
         "E_INDEX", "a pick of 257, and there is one entry", "keeps picks in a byte"),
        ("entry-out-of-range",
         replace(with_palette(ADD, replace(entries(0), adds={8: [0, -4097]}), picks(1, 1, 0)),
                 quantisers={(0, 5): (65535, 0)}),
         "R-7.3-1 R-7.3-5", "E_RANGE", "an entry below -2^28, which no one picks",
         "looks at entries when they are picked, or saturates"),
        ("entry-out-of-range-picked",
         replace(with_palette(ADD, replace(entries(0), adds={8: [0, -4097]}), picks(1, 2, 1)),
                 quantisers={(0, 5): (65535, 0)}),
         "R-7.3-1 R-7.3-5", "E_RANGE", "a splat whose pick is an entry below -2^28",
         "shows it as it is, or saturates"),
        ("entries-whose-sum-is-out-of-range",
         with_palette(ADD, replace(entries(0), adds={4: multiples},
                                   codings={"adds 4": 0x28 | DELTA}), picks(1, 1, 0)),
         "R-7.1-1", "E_RANGE", "differences of entries sum to more than 2^28",
         "does not bound the sums of entries"),
    ])  # fmt: skip


def order() -> Iterator[Case]:
    """Two faults each."""
    bad_picks = replace(picks(3, 3, 3), style=lambda c: raw(bytes([c[0] | 0x80])))
    rows: list[Row] = [
        ("order-count-and-tile",
         with_palette(ADD, replace(entries(1), tile=1, row={"n_drops": 1}), n_tiles=2),
         "R-6.1-1 R-5.6-4 6.1", "E_COUNT",
         "a row of the palette that says tile 1, with `n_drops` 1",
         "looks at its tile before its counts"),
        ("order-amplification-and-tile",
         with_palette(ADD, replace(entries(0), tile=1, n_adds=177, is_explicit=True), n_tiles=2),
         "R-6.1-1 R-5.6-7 6.1", "E_AMPLIFICATION",
         "a row of the palette that says tile 1, and 177 entries in 11 bytes",
         "looks at its tile before its size"),
        ("order-checksum-and-tile",
         with_palette(ADD, replace(entries(0), tile=1, row={"crc": 1}), n_tiles=2),
         "R-6.1-1 R-5.6-8 6.1", "E_CRC",
         "a row of the palette of size 0 that says tile 1, its checksum 1",
         "looks at its tile before its checksum"),
        ("order-low-plane-and-pick", with_palette(ADD, entries(2), bad_picks),
         "R-6.1-1 R-5.9-9 6.1", "E_PACKET",
         "picks above the entries, and bits that belong to no pick",
         "looks at picks before all bits of the plane"),
        ("order-pick-and-later-core",
         with_palette(ADD, entries(1), picks(2, 0, 0), replace(GROW, row={"crc": 1})),
         "R-6.1-1 R-7.2-4 6.1", "E_INDEX", "a pick above the entries, then core with a wrong crc",
         "applies all core packets first"),
        ("order-core-and-later-palette",
         replace(with_palette(ADD, replace(entries(1), row={"crc": 1})),
                 quantisers={(0, 0): (65535, 24)}),
         "R-6.1-1 R-7.3-1 6.1", "E_RANGE",
         "core out of its range, then the palette with a wrong crc",
         "reads the palette before all core packets"),
    ]  # fmt: skip
    yield from refused(rows, FILE)
    yield from refused([
        ("order-tile-and-limit",
         with_palette(ADD, replace(entries(4), tile=1), n_tiles=2), "R-6.1-1 R-5.6-10 6.1",
         "E_CHAIN", "a row of the palette of tile 1, with more entries than the decoder's limit",
         "looks at limits before tiles"),
    ], Run(limits={"tile_slots": 3}))  # fmt: skip


RECIPES: tuple[Recipe, ...] = (header, chains, counts, limits, packets, values, order)
