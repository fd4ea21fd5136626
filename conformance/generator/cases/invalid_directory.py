"""Faults of the packet table, one each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream, Tile, packet_body
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "invalid-directory"
ADD = Packet(adds=numbers(3))
BAND = Packet(component=1, adds=numbers(3, 9))
SPLIT_ONE = Packet(records={0: SPLIT}, psi=numbers(1), level=1)
BASE = Stream([ADD, BAND, SPLIT_ONE], degree=1, n_levels=3)


def rows_of(*packets: Packet, tier: int = 1, n_tiles: int = 1) -> Stream:
    """BASE with other packets."""
    return replace(BASE, packets=packets, tier=tier, tiles=(Tile(),) * n_tiles)


def legal() -> Iterator[Case]:
    """What the faults are made from."""
    yield case(
        "base",
        BASE,
        "R-5.6-1 R-5.6-2 R-5.6-3 R-5.6-4 R-5.6-5 R-5.6-6 R-5.6-7",
        "two steps of core and one of a band",
        "expects a packet of each band for each step",
    )
    yield case(
        "step-of-nothing",
        rows_of(Packet(), ADD, Packet(level=1), SPLIT_ONE),
        "R-5.6-5 R-5.6-8 R-5.6-3",
        "steps without records have packets without bytes, also before there is a splat",
        "refuses a packet of size 0, or does not count it as a step",
    )


def chains() -> Iterator[Case]:
    """Tiles, components, levels."""
    rows = [
        ("reserved", rows_of(replace(ADD, row={"reserved": 0x8000})), "R-4.4-1", "E_RESERVED",
         "the highest reserved bit of a row is set", "masks the reserved bytes"),
        ("tile-1-of-1", rows_of(replace(ADD, tile=1)), "R-5.6-1", "E_CHAIN",
         "a packet of a tile that is none", "makes the tile, or writes past the last one"),
        ("tile-of-2-to-32", rows_of(replace(ADD, row={"tile": 0xFFFFFFFF})), "R-5.6-1", "E_CHAIN",
         "a packet of tile 4294967295", "takes the index for -1"),
        ("component-2-of-degree-1", rows_of(ADD, replace(BAND, component=2)), "R-5.6-1", "E_CHAIN",
         "a packet of a band above `sh_degree`", "ignores bands that the header does not have"),
        ("component-255", rows_of(ADD, replace(BAND, row={"component": 255})), "R-5.6-1", "E_CHAIN",
         "a packet of component 255", "takes the component for -1"),
        ("band-before-core", rows_of(BAND, ADD), "R-5.6-2", "E_CHAIN",
         "the packet of a band before that of core", "lets it wait, as if it had come early"),
        ("band-twice-for-one-step", rows_of(ADD, BAND, BAND, SPLIT_ONE), "R-5.6-2", "E_CHAIN",
         "a second packet of a band before the second of core", "counts chains at the end only"),
        ("band-of-another-tile", rows_of(ADD, replace(BAND, tile=1), n_tiles=2), "R-5.6-2",
         "E_CHAIN", "a band of a tile that has no core yet", "counts core packets of all tiles"),
        ("level-3-of-3", rows_of(replace(ADD, level=3)), "R-5.6-3", "E_CHAIN",
         "a level that is none", "compares with `n_levels` inclusively"),
        ("level-falls", rows_of(replace(ADD, level=2), SPLIT_ONE), "R-5.6-3", "E_CHAIN",
         "level 1 after level 2", "sorts packets by level"),
        ("level-falls-behind-a-band", rows_of(replace(ADD, level=2), BAND, SPLIT_ONE), "R-5.6-3",
         "E_CHAIN", "level 1 after level 2, the 0 of a band between them",
         "compares with the row before, whatever its component"),
        ("level-falls-behind-an-empty-step",
         rows_of(ADD, Packet(level=2), SPLIT_ONE), "R-5.6-3", "E_CHAIN",
         "level 1 after an empty step of level 2", "leaves steps without records out"),
    ]  # fmt: skip
    for name, stream, rule, code, tests, faulty in rows:
        yield case(name, stream, rule, tests, faulty, code, "base", runs=(FILE, PROGRESSIVE))
    yield case(
        "level-falls-in-another-tile",
        rows_of(replace(ADD, level=2), replace(ADD, tile=1), n_tiles=2),
        "R-5.6-3",
        "level 0 after level 2, of another tile",
        "compares levels over all tiles",
    )


def counts() -> Iterator[Case]:
    """Counts against component, size, and the splats that are there."""
    for name in ("n_adds", "n_splits", "n_refines", "n_drops"):
        yield case(
            f"band-with-{name.replace('_', '-')}",
            rows_of(ADD, replace(BAND, row={name: 1})),
            "R-5.6-4",
            f"the row of a band says `{name}` 1",
            "uses the counts of the row instead of those of core, or ignores them",
            "E_COUNT",
            "base",
        )
    three = {0: DROP, 1: DROP, 2: DROP}
    rows = [
        ("band-with-level", rows_of(ADD, replace(BAND, level=1)), "R-5.6-4",
         "the row of a band says level 1", "takes the level from the row"),
        ("counts-without-bytes", rows_of(ADD, replace(SPLIT_ONE, edit=lambda _: b"")), "R-5.6-5",
         "a row of core with a split and no bytes", "takes all integers for 0"),
        ("bytes-without-counts", rows_of(ADD, Packet(edit=lambda _: bytes(37))), "R-5.6-5",
         "a row of core with 37 bytes and no records", "skips the packet"),
        ("records-without-splats", rows_of(Packet(records={0: REFINE}, psi=numbers(1))), "R-5.6-6",
         "a refine before there is a splat", "checks slots only"),
        ("records-above-live", rows_of(ADD, Packet(records={**three, 3: DROP})), "R-5.6-6",
         "four drops of three splats", "compares with slots made, and counts wrongly"),
        ("records-above-live-after-drops",
         rows_of(ADD, Packet(records={0: DROP}), Packet(records=three)), "R-5.6-6",
         "three drops where a drop left two splats", "compares with slots instead of live splats"),
        ("records-of-splats-of-the-step",
         rows_of(Packet(adds=numbers(1), records={0: REFINE}, psi=numbers(1))), "R-5.6-6",
         "a refine of the splat that the same step adds", "counts adds before records"),
        ("records-of-another-tile", rows_of(ADD, Packet(records={0: DROP}, tile=1), n_tiles=2),
         "R-5.6-6", "a drop in a tile without splats, another has three",
         "counts splats of all tiles"),
        ("records-sum-to-2-to-32",
         rows_of(ADD, replace(SPLIT_ONE, row={"n_refines": 0xFFFFFFFF, "n_splits": 1})), "R-5.6-6",
         "refines and splits sum to 2^32", "adds counts in 32 bits and gets 0"),
        ("drops-2-to-32", rows_of(ADD, replace(SPLIT_ONE, row={"n_drops": 0xFFFFFFFF})), "R-5.6-6",
         "4294967295 drops", "takes the count for -1"),
    ]  # fmt: skip
    for name, stream, rule, tests, faulty in rows:
        yield case(name, stream, rule, tests, faulty, "E_COUNT", "base")
    yield case(
        "records-equal-live",
        rows_of(ADD, Packet(records=three), ADD, Packet(records={3: REFINE, 4: SPLIT, 5: DROP},
                                                       psi=numbers(2))),
        "R-5.6-6",
        "as many records as live splats, twice",
        "counts the live splats one too few, or forgets adds after drops",
    )  # fmt: skip
    yield case(
        "records-sum-above-live",
        rows_of(ADD, Packet(records={0: REFINE, 1: REFINE, 2: DROP, 3: DROP}, psi=numbers(2))),
        "R-5.6-6",
        "two refines and two drops of three splats",
        "compares each count with the splats, and not their sum",
        "E_COUNT",
        "base",
    )


def amplification() -> Iterator[Case]:
    """New slots against bytes."""
    size = 37  # a core packet without planes: header and coding bytes
    for name, n, code in (("least", 16 * size, None), ("beyond", 16 * size + 1, "E_AMPLIFICATION")):
        yield case(
            f"amplification-{name}",
            rows_of(Packet(n_adds=n)),
            "R-5.6-7",
            f"{n} adds in {size} bytes",
            "has no bound, or another one",
            code,
            None if code is None else "amplification-least",
            runs=(FILE,),
        )
    for kind, name in ((SPLIT, "splits"), (REFINE, "refines"), (DROP, "drops")):
        records = dict.fromkeys(range(592), kind)
        packets = [Packet(n_adds=592), Packet(n_adds=8), Packet(records=records, n_adds=1)]
        yield case(
            f"amplification-by-{name}",
            rows_of(*packets),
            "R-5.6-7",
            f"592 {name} and an add in 37 bytes",
            "counts adds only, or new slots only",
            "E_AMPLIFICATION",
            "amplification-least-of-all-kinds",
        )
    mixed = Packet(records={slot: slot % 3 for slot in range(591)}, n_adds=1)
    most = 16 * len(packet_body(mixed, mixed.counts))
    yield case(
        "amplification-least-of-all-kinds",
        rows_of(Packet(n_adds=592), replace(mixed, n_adds=most - 591)),
        "R-5.6-7",
        f"591 records of all kinds and {most - 591} adds, 16 for each byte",
        "counts a split twice",
        runs=(FILE,),
    )
    yield case(
        "amplification-sums-to-2-to-32",
        rows_of(ADD, replace(SPLIT_ONE, row={"n_adds": 0xFFFFFFFF})),
        "R-5.6-7",
        "a split and 4294967295 adds",
        "adds counts in 32 bits and gets 0",
        "E_AMPLIFICATION",
        "amplification-least",
    )


def checksums() -> Iterator[Case]:
    """Checksums of packets in their rows."""
    rows = [
        ("crc-of-an-empty-step", rows_of(ADD, Packet(row={"crc": 1})), "R-5.6-8 R-6.3-1",
         "an empty step with a checksum other than 0", "does not check packets of size 0"),
        ("crc-of-an-empty-band", rows_of(ADD, Packet(component=1, row={"crc": 0xFFFFFFFF})),
         "R-5.6-8 R-6.3-1", "an empty band with the checksum 4294967295",
         "takes the initial value of the checksum for that of no bytes"),
        ("crc-of-core", rows_of(replace(ADD, row={"crc": 0})), "R-6.3-1",
         "the checksum of a core packet is 0", "takes 0 for `not computed`"),
        ("crc-of-band", rows_of(ADD, replace(BAND, row={"crc": 0x1234567})), "R-6.3-1",
         "the checksum of a band packet is wrong", "checks core only"),
    ]  # fmt: skip
    for name, stream, rule, tests, faulty in rows:
        yield case(name, stream, rule, tests, faulty, "E_CRC", "base", runs=(FILE, PROGRESSIVE))


def limits() -> Iterator[Case]:
    """Limits of the tier that are counted row by row."""
    empty = [Packet()] * 1024
    yield case(
        "steps-1025",
        rows_of(*empty, Packet()),
        "R-8.2-1 8.2",
        "1025 steps of one component in tier 1",
        "has no bound on steps",
        "E_TIER",
        "steps-1024",
        runs=(FILE,),
    )
    yield case(
        "steps-1024",
        rows_of(*empty, *[Packet(component=1)] * 1024, *[Packet(tile=1)] * 9, n_tiles=2),
        "R-8.2-1 8.2",
        "1024 steps of core, 1024 of a band, 9 of another tile; legal, and what steps-1025 is held"
        " against",
        "counts steps over components or tiles",
        runs=(FILE,),
    )

    def claim(n: int, tile: int = 0, n_bytes: int = 65537) -> Packet:
        return Packet(tile=tile, edit=lambda _: b"", n_adds=1, row={"n_adds": n, "size": n_bytes})

    rows = [
        ("slots-1048577-of-a-tile", [claim(1048577)], 1, "E_TIER", "a slot more than a tile has"),
        ("slots-1048576-of-a-tile", [claim(1048576)], 1, "E_TRUNCATED", "as many as a tile has"),
        ("slots-2097153", [claim(1048576), claim(1048576, 1), claim(1, 2)], 1, "E_TIER",
         "a slot more than all tiles have"),
        ("slots-2097152", [claim(1048576), claim(1048576, 1)], 1, "E_TRUNCATED",
         "as many as all tiles have"),
        ("slots-in-two-steps", [claim(1048576), claim(1)], 1, "E_TIER",
         "a slot more than a tile has, in its second step"),
        ("slots-of-tier-3", [claim(16777216, n_bytes=1 << 20), claim(1)], 3, "E_TIER",
         "a slot more than a tile of tier 3 has"),
    ]  # fmt: skip
    for name, packets, tier, code, tests in rows:
        n_bytes = sum(packet.row["size"] for packet in packets)
        stream = replace(rows_of(*packets, tier=tier, n_tiles=3), header={"data_size": n_bytes})
        yield case(
            name,
            stream,
            "R-8.2-1 R-5.6-7 8.2" if code == "E_TIER" else "R-8.2-1 R-6.2-2 8.2",
            f"{tests}; the packets are not there",
            "looks for the packets before it counts, or makes slots for what may never come",
            code,
            "base",
            runs=(FILE, PROGRESSIVE) if tier == 1 else (FILE,),
        )


RECIPES: tuple[Recipe, ...] = (legal, chains, counts, amplification, checksums, limits)
