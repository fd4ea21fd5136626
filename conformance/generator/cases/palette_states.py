"""Palettes and picks that are late, missing, outside the cut, or asked for by level; digests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import (
    DROP,
    PALETTE,
    PICKS,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    build,
    patched,
    places,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, VERIFY, Case, Recipe, case
from conformance.generator.cases.palette import ADD, GROW, entries, picks, with_palette
from conformance.generator.cases.progressive import Pieces, came
from conformance.generator.cases.scenes import numbers

FAMILY = "palette"
TWIN = "degree-1"
SPLIT_TWO = Packet(records={0: SPLIT, 1: SPLIT}, psi=numbers(2, seed=1), adds=numbers(1, seed=2))
AGAIN = Packet(records={3: SPLIT, 4: SPLIT, 0: DROP}, psi=numbers(2, seed=3))
DEEP = Packet(records={6: SPLIT, 5: REFINE}, psi=numbers(2, seed=4))
CORES = (ADD, SPLIT_TWO, AGAIN, DEEP)
CHOSEN = (picks(5, 1, 0), picks(2, 3, 4), picks(1, 2), picks(6))

# Packets 0 to 8: two of the palette, and steps of two tiles.
SCENE = with_palette(
    ADD,
    entries(2, 2),
    entries(2, 2, seed=1),
    picks(1, 0, 2),
    GROW,
    picks(4, 3),
    replace(ADD, tile=1),
    picks(2, 1, 1, tile=1),
    replace(GROW, tile=1),
    degree=2,
    n_tiles=2,
)
ARRIVED = "arrival-palette-last"  # SCENE


def late_picks() -> Iterator[Case]:
    """Core packets that come before the picks of earlier steps."""
    core, chosen = CORES, CHOSEN
    rows = [
        ("late-all", [*core, *chosen], "all core packets, then all picks"),
        (
            "late-by-a-step",
            [core[0], core[1], chosen[0], core[2], chosen[1], core[3], *chosen[2:]],
            "picks are always a step late",
        ),
        (
            "late-first-only",
            [*core, chosen[0]],
            "picks of the first step, under three more of core",
        ),
        ("late-first-two", [*core, *chosen[:2]], "picks of two steps, under two more of core"),
        ("late-not-the-last", [*core, *chosen[:3]], "picks of all steps but the last"),
    ]
    for name, packets, tests in rows:
        yield case(
            name,
            with_palette(entries(6), *packets, n_levels=1),
            "R-7.5-1 R-5.6-2 7.5",
            f"{tests}: slots show the entry of the ancestor they were split from",
            "shows 0, the parent only, the entry of a slot of the same number, or of empty slots",
            runs=(FILE, PROGRESSIVE),
        )
    yield case(
        "late-for-adds",
        with_palette(
            entries(3), ADD, picks(3, 1, 2), Packet(adds=numbers(2, seed=5)),
            Packet(records={3: SPLIT, 0: SPLIT}, psi=numbers(2, seed=6)), n_levels=1,
        ),
        "R-7.5-1 7.5",
        "SH of adds without picks are 0, also those of the splats split from them",
        "shows entry 1, or that of some other slot",
    )  # fmt: skip
    yield case(
        "late-for-a-dropped-slot",
        replace(
            with_palette(ADD, Packet(records={1: DROP}), entries(3), picks(1, 2, 3), n_levels=1),
            digests={(0, PICKS, 0): None},
        ),
        "R-7.5-1 R-5.7-3 7.5 7.7",
        "the pick of a slot that a later step of core dropped: it shows 0, and the digest has it",
        "shows it, or leaves it out of the state",
        runs=(FILE, VERIFY),
    )


def levels() -> Iterator[Case]:
    """Cuts by level of streams whose entries are all of level 0."""
    yield case(
        "level-0-of-two-palette-packets",
        with_palette(ADD, entries(2), GROW, entries(2, seed=1), picks(4, 1, 3), picks(3, 2)),
        "R-6.2-3 R-7.2-4 3.6",
        "picks of level 0 are of entries that stand behind a core packet of level 1",
        "takes palette packets by the level of a core packet before them, or one per step",
    )
    wrong = replace(entries(2, seed=1), row={"crc": 1})
    small, large = ({channel: [1]} for channel in (0, 9))  # of band 1, of band 2
    first, last = (replace(entries(0), adds=adds) for adds in (small, large))
    out_of_range = with_palette(ADD, first, GROW, last, picks(1, 0, 1), degree=2)
    rows = [
        ("crc", with_palette(ADD, entries(2), GROW, wrong, picks(1, 2, 1)), "E_CRC", "R-6.3-1",
         "the second packet of the palette is wrong, and no pick is of its entries"),
        ("crc-without-picks", with_palette(ADD, GROW, wrong), "E_CRC", "R-6.3-1",
         "the palette is wrong, and there are no picks"),
        ("range", replace(out_of_range, quantisers={(0, 6): (65535, 24)}), "E_RANGE", "R-7.3-1",
         "an entry of the palette leaves its range, and no pick is of it"),
    ]  # fmt: skip
    for name, stream, code, rule, tests in rows:
        yield case(
            f"level-0-with-fault-of-{name}",
            stream,
            f"R-4.1-1 {rule} 3.6",
            f"{tests}: that matters to level 0",
            "takes as much of the palette as its level needs",
            code,
            TWIN,
            runs=(FILE, Run(level=0)),
        )
    late = replace(picks(9, 9), row={"crc": 1})
    yield case(
        "level-0-without-fault-of-picks",
        with_palette(ADD, entries(2), picks(1, 2, 1), GROW, late),
        "R-6.2-3 R-6.3-1 3.6",
        "picks of level 1 are wrong: that matters to level 1 only",
        "examines picks that it was not asked for",
        "E_CRC",
        TWIN,
        runs=(FILE, Run(level=0)),
    )
    whole = with_palette(ADD, entries(2), GROW, entries(2, seed=1))
    yield case(
        "level-0-of-a-truncated-palette",
        build(whole)[:-1],
        "R-6.2-2 3.6 6.2",
        "the last packet of the palette lacks a byte",
        "gives level 0 without it",
        "E_TRUNCATED",
        TWIN,
        runs=(FILE, Run(level=0), PROGRESSIVE),
    )


def digests() -> Iterator[Case]:
    """States of picks and of the palette."""
    of_picks, of_palette = (
        [(0, PICKS, 0), (0, PICKS, 1), (1, PICKS, 0)],
        [(0, PALETTE, 0), (0, PALETTE, 1)],
    )
    right: dict[tuple[int, int, int], bytes | None] = dict.fromkeys(sorted(of_picks + of_palette))
    yield case(
        "digests-of-picks",
        replace(SCENE, digests={(0, 0, 0): None} | dict.fromkeys(of_picks)),
        "R-5.7-1 R-5.7-2 R-5.7-3 R-5.7-4 7.7",
        "digests of picks after each step, with a drop",
        "leaves a dropped slot its SH, or hashes picks, or the channels of band 1",
        runs=(FILE, VERIFY, Run(verify=True, level=0)),
    )
    yield case(
        "digests-of-the-palette",
        replace(SCENE, digests=dict.fromkeys(of_palette)),
        "R-5.7-1 R-5.7-2 R-5.7-3 R-5.7-4 12 7.7",
        "digests of the palette after each of its packets",
        "hashes the entries of the packet, the slots of tile 0, or entry by entry",
        runs=(FILE, VERIFY, Run(verify=True, level=0)),
    )
    for name, key, tests in (
        ("picks", (0, PICKS, 1), "the digest of picks of a step"),
        ("palette", (0, PALETTE, 0), "the digest of the first packet of the palette"),
        (
            "last-palette",
            (0, PALETTE, 1),
            "the digest of the last packet of the palette, at any level",
        ),
    ):
        yield case(
            f"digest-of-{name}-wrong",
            replace(SCENE, digests={**right, key: bytes(32)}),
            "R-5.7-3 R-5.7-4 3.6",
            f"{tests} is wrong",
            "verifies core only",
            "E_DIGEST",
            TWIN,
            runs=(VERIFY, FILE, Run(verify=True, level=0)),
        )
    yield case(
        "digest-of-the-palette-in-tile-1",
        replace(SCENE, digests={(1, PALETTE, 0): bytes(32)}),
        "R-5.7-2",
        "a digest of component 5 of tile 1, which has no rows of the palette",
        "lets every tile have the palette",
        "E_CHUNK",
        TWIN,
    )


def without(*missing: int, stream: Stream = SCENE) -> Run:
    """All bytes but those of these packets came."""
    data = build(stream)
    spans = [span for k, span in enumerate(places(data).packets) if k not in missing]
    head = places(data).packets[0][0]
    return came((0, head), *((begin, end - begin) for begin, end in spans if end > begin))


def arrivals() -> Iterator[Case]:
    """Packets in other orders, and packets that do not come."""
    data = build(SCENE)
    head = places(data).packets[0][0]
    spans = [(begin, end - begin) for begin, end in places(data).packets]

    def order(*numbers_: int) -> Pieces:
        return [(0, head), *(spans[k] for k in numbers_)]

    rows: list[tuple[str, tuple[Run, ...], str, str]] = [
        (
            "arrival-palette-last",
            (came(*order(0, 3, 4, 5, 6, 7, 8, 2, 1)), PROGRESSIVE),
            "core and picks of both tiles, then the palette, its last packet first",
            "examines picks before the palette is there, or never again",
        ),
        (
            "arrival-backwards",
            (came(*order(*range(8, -1, -1))),),
            "all packets, the last first",
            "takes entries in the order in which they came",
        ),
        (
            "without-the-first-palette-packet",
            (without(1), came(*order(0, 2, 3, 4, 5, 6, 7, 8))),
            "the first packet of the palette is missing: no picks, and SH are 0",
            "takes the second for the first",
        ),
        (
            "without-the-last-palette-packet",
            (without(2), came(*order(1, 0, 3))),
            "the last packet of the palette is missing: no picks, also those of other entries",
            "applies picks whose entries are there",
        ),
        (
            "without-the-palette",
            (without(1, 2), came((0, head))),
            "no packet of the palette came; no packet at all",
            "refuses picks without a palette, or is done without it",
        ),
        (
            "without-core",
            (without(0), without(6), came(*order(1, 2))),
            "the palette is complete, and core of a tile, or of both, is missing",
            "wants core before the palette, or picks of one tile before those of another",
        ),
        (
            "without-picks",
            (without(3), without(7), without(5)),
            "a packet of picks is missing",
            "takes the picks of the next step for it",
        ),
    ]
    for name, runs, tests, faulty in rows:
        yield case(name, data, "R-6.4-1 R-6.4-2 12 6.4", tests, faulty, runs=runs)
    ends = [end for _, end in places(data).packets]
    yield case(
        "boundaries-of-packets",
        data,
        "R-6.4-1 R-6.4-3 12 6.4",
        "the file up to the end of each packet, and to the byte before",
        "shows a packet that lacks a byte, or waits for one more",
        runs=tuple(came((0, size)) for end in ends for size in (end - 1, end)),
    )
    empty = with_palette(entries(2), entries(0), ADD, picks(1, 2, 1))
    yield case(
        "without-the-packet-before-one-of-size-0",
        empty,
        "R-6.4-1 R-5.6-5 6.4",
        "a packet of the palette of size 0 is complete from the start; the one before it is not",
        "takes the palette for complete when its last packet is",
        runs=(without(0, stream=empty), without(2, stream=empty), PROGRESSIVE),
    )


def faults() -> Iterator[Case]:
    """Faults of packets that come, beside packets that do not."""
    data = build(SCENE)
    spans = places(data).packets
    head = spans[0][0]

    def damaged(*numbers_: int) -> bytes:
        out = data
        for k in numbers_:
            out = patched(out, spans[k][1] - 1, bytes([out[spans[k][1] - 1] ^ 1]))
        return out

    def order(*numbers_: int) -> Run:
        pieces = [spans[k] for k in numbers_]
        return came((0, head), *((begin, end - begin) for begin, end in pieces))

    rows: list[tuple[str, bytes, tuple[Run, ...], str | None, str]] = [
        ("in-the-palette-without-core", damaged(2), (without(0), order(1, 2)), "E_CRC",
         "the palette is wrong, and core is missing: the palette requires no core"),
        ("in-the-palette-that-must-wait", damaged(2), (without(1), order(2)), None,
         "the first packet of the palette is missing: the second is wrong and not examined"),
        ("in-picks-that-wait-for-the-palette", damaged(3), (without(2), order(0, 3)), None,
         "the palette is not complete: picks are wrong and not examined"),
        ("in-picks-when-the-palette-has-come", damaged(7), (order(0, 6, 7, 2, 1),), "E_CRC",
         "wrong picks that came before the palette"),
        ("in-core-and-palette", damaged(0, 1), (order(2, 1, 0), FILE), "E_CRC",
         "core is wrong, and so is the palette behind it, which came first"),
        ("in-palette-and-later-core", damaged(2, 6), (order(6, 0, 1, 2), FILE), "E_CRC",
         "the palette is wrong, and so is core of another tile, which came first"),
    ]  # fmt: skip
    for name, bytes_, runs, code, tests in rows:
        yield case(
            f"fault-{name}",
            bytes_,
            "R-6.4-4 R-6.3-1 12 6.4",
            tests,
            "reports what came first, what it did not examine, or nothing",
            code,
            None if code is None else ARRIVED,
            runs=runs,
        )
    large = replace(SCENE, packets=[*SCENE.packets[:7], picks(2, 5, 1, tile=1)])
    yield case(
        "fault-of-a-pick-that-came-first",
        large,
        "R-6.4-4 R-7.2-4 6.4",
        "a pick above the entries came before the palette did, and in another run without it",
        "compares picks with the entries that are there, or not at all",
        "E_INDEX",
        ARRIVED,
        runs=(PROGRESSIVE, without(1, stream=large), without(2, stream=large)),
    )


RECIPES: tuple[Recipe, ...] = (late_picks, levels, digests, arrivals, faults)
