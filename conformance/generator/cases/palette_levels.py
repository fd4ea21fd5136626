"""Levels of entries: which packets of the palette picks require, a level takes, and rows may be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import PALETTE, PICKS, REFINE, Packet, Stream, build
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.palette import ADD, GROW, entries, picks, with_palette
from conformance.generator.cases.palette_changes import anew
from conformance.generator.cases.scenes import numbers

FAMILY = "palette"
LEVELS = (FILE, Run(level=0), Run(level=1))
LOW, HIGH = entries(2), entries(2, seed=1, level=1)  # entries 1 and 2, then 3 and 4

# Packets 0 to 10: the entries of each level stand before the first picks of them.
SCENE = with_palette(
    ADD,
    LOW,
    picks(2, 0, 1),
    HIGH,
    GROW,
    picks(3, 4),
    replace(ADD, tile=1),
    picks(1, 2, 0, tile=1),
    entries(1, seed=2, level=2),
    replace(GROW, tile=1, level=2),
    picks(5, 3, tile=1),
    n_levels=3,
    n_tiles=2,
)
TWIN = "levels-of-two-tiles"  # SCENE


def layouts() -> Iterator[Case]:
    """Where rows of levels may stand, and which entries picks may be of."""
    yield case(
        "levels-of-two-tiles",
        SCENE,
        "R-5.6-3 R-5.6-4 R-5.6-10 R-7.2-4 3.6 12",
        "entries of levels 0, 1 and 2, each behind picks of lower labels of two tiles",
        "wants the whole palette before any picks, or all of its rows of level 0",
    )
    late, top = replace(ADD, level=1), replace(GROW, level=2)
    rows = [
        (
            "levels-in-front",
            [LOW, HIGH, ADD, picks(2, 0, 1), GROW, picks(3, 4)],
            "R-5.6-3 3.6",
            "all of the palette stands before core, the entries of level 1 before a step of 0",
            "holds the levels of the palette and of core in one chain",
        ),
        (
            "levels-that-no-step-has",
            [entries(1), ADD, picks(1, 0, 1), HIGH, top, picks(3, 2), entries(1, seed=3, level=3)],
            "R-5.6-3 R-5.6-10 3.6",
            "entries of levels 1 and 3, and steps of labels 0 and 2",
            "wants a step of the level of the entries, or picks of its own level alone",
        ),
        (
            "levels-above-all-steps",
            [HIGH, ADD, picks()],
            "R-5.6-3 R-7.2-4 3.6",
            "entries of level 1 alone, and picks of 0 of a step with label 0",
            "wants entries of level 0, or takes the lowest level there is for it",
        ),
        (
            "levels-of-several-packets",
            [entries(1), ADD, picks(1, 0, 1), entries(1, seed=3, level=1), GROW,
             entries(2, seed=4, level=1), picks(4, 2)],
            "R-5.6-3 R-7.2-4 12",
            "two packets of the palette with level 1, and picks of both",
            "wants levels that rise, or a packet for each",
        ),
        (
            "levels-with-a-packet-of-size-0",
            [entries(0), ADD, picks(), entries(0, level=1), GROW, HIGH, picks(1, 2)],
            "R-5.6-3 R-5.6-5 R-5.6-10",
            "packets of the palette of size 0 with levels 0 and 1, then entries of level 1",
            "leaves out rows without bytes, or wants entries of each level",
        ),
        (
            "levels-of-steps-that-begin-late",
            [HIGH, late, picks(2, 1, 0), entries(1, seed=3, level=2), top, picks(3, 1)],
            "R-5.6-10 R-7.2-4 3.6",
            "no step and no entry has level 0",
            "takes the first packet of the palette for that of level 0",
        ),
        (
            "levels-behind-late-picks",
            [ADD, LOW, GROW, picks(2, 0, 1), HIGH, picks(3, 4)],
            "R-5.6-10 12",
            "entries of level 1 behind a step of that label and the picks of the one before it",
            "takes the label of picks from the last step of core before them",
        ),
        (
            "levels-of-picks-below",
            [ADD, LOW, HIGH, picks(2, 0, 1), GROW, picks(1, 2)],
            "R-7.2-4 12",
            "picks of label 1 are of entries of level 0",
            "numbers the entries of each level from 1",
        ),
        (
            "levels-of-changed-picks",
            [ADD, LOW, picks(2, 0, 1), HIGH, GROW, anew([3, 4], [2, 3])],
            "R-7.2-4 12 5.9",
            "new picks of slots that a step of label 1 refines or splits, of entries of level 1",
            "holds picks of changed slots against the entries of before",
        ),
    ]  # fmt: skip
    for name, packets, rules, tests, faulty in rows:
        n_levels = 1 + max(packet.level for packet in packets)
        yield case(name, with_palette(*packets, n_levels=n_levels), rules, tests, faulty)
    steps = {(0, 5): (3, 1), (0, 6): (7, 0)} | {(row, 5): (11 + row, row) for row in (1, 2)}
    yield case(
        "levels-with-quantisers",
        replace(
            with_palette(ADD, entries(2, 2), picks(2, 0, 1), entries(2, 2, seed=1, level=1), GROW,
                         picks(3, 4), degree=2),
            quantisers=steps,
        ),
        "R-5.3-1 5.3 7.4",
        "entries of level 1 have the steps of adds, whatever those of psi of the level are",
        "lets the level of entries choose the row of quantisers",
        runs=(FILE,),
    )  # fmt: skip
    yield case(
        "levels-64",
        with_palette(
            ADD, LOW, picks(2, 0, 1), replace(HIGH, level=63), replace(GROW, level=63),
            picks(3, 4), n_levels=64,
        ),
        "R-5.6-3 3.6",
        "entries of levels 0 and 63, and 64 levels",
        "has a palette for each of a few levels",
        runs=(FILE, Run(level=62), Run(level=63)),
    )  # fmt: skip


def cuts() -> Iterator[Case]:
    """Faults and absence of packets of the palette at cuts by level."""
    wrong = replace(HIGH, row={"crc": 1})
    small, large = ({channel: [1]} for channel in (0, 9))  # of band 1, of band 2
    low, high = replace(entries(0), adds=small), replace(entries(0, level=1), adds=large)
    out_of_range = with_palette(ADD, low, high, picks(1, 0, 1), GROW, picks(1, 2), degree=2)
    rows = [
        ("crc", with_palette(LOW, wrong, ADD, picks(2, 0, 1), GROW, picks(3, 4), n_levels=3),
         "E_CRC", "R-6.3-1", "entries of level 1 are wrong, and stand before all else"),
        ("crc-no-step-needs", with_palette(ADD, LOW, picks(2, 0, 1), wrong, n_levels=3), "E_CRC",
         "R-6.3-1", "entries of level 1 are wrong, and no step has that label"),
        ("crc-without-picks", with_palette(ADD, wrong, GROW, n_levels=3), "E_CRC", "R-6.3-1",
         "entries of level 1 are wrong, and there are no picks"),
        ("range", replace(out_of_range, n_levels=3, quantisers={(0, 6): (65535, 24)}), "E_RANGE",
         "R-7.3-1", "an entry of level 1 leaves its range, and stands before picks of level 0"),
        ("crc-of-a-lower-level",
         with_palette(entries(0), wrong, replace(ADD, level=2), entries(1, level=2), picks(3, 0, 3),
                      n_levels=3),
         "E_CRC", "R-6.3-1", "entries of level 1 are wrong, and picks of level 2 not of them"),
    ]  # fmt: skip
    for name, stream, code, rule, tests in rows:
        yield case(
            f"levels-with-fault-of-{name}",
            stream,
            f"R-6.2-3 {rule} 3.6",
            f"{tests}: that matters from level 1 on",
            "takes the whole palette at each level, or what the picks of the level are of",
            code,
            TWIN,
            runs=LEVELS,
        )
    last = with_palette(ADD, LOW, picks(2, 0, 1), GROW, HIGH, entries(1, level=2), n_levels=3)
    yield case(
        "levels-of-a-truncated-palette",
        build(last)[:-1],
        "R-6.2-2 R-6.2-3 3.6 6.2",
        "the last packet of the palette, of level 2, lacks a byte: lower levels do without it",
        "wants the whole palette at each level, or that of the next level",
        "E_TRUNCATED",
        TWIN,
        runs=(*LEVELS, PROGRESSIVE),
    )


def digests() -> Iterator[Case]:
    """States of the palette and of picks after each packet."""
    keys = [
        (0, 0, 0),
        (0, 0, 1),
        (0, PICKS, 0),
        (0, PICKS, 1),
        (0, PALETTE, 0),
        (0, PALETTE, 1),
        (0, PALETTE, 2),
    ]
    keys += [(1, 0, 0), (1, 0, 1), (1, PICKS, 0), (1, PICKS, 1)]
    right: dict[tuple[int, int, int], bytes | None] = dict.fromkeys(keys)
    runs = tuple(replace(run, verify=True) for run in LEVELS)
    yield case(
        "levels-with-digests",
        replace(SCENE, digests=right),
        "R-5.7-3 R-5.7-4 12 7.7",
        "digests after each packet: those of the palette hold the entries of the levels so far",
        "digests all entries, or those of the packet, of the level, or that picks may be of",
        runs=runs,
    )
    for name, key in (("palette", (0, PALETTE, 1)), ("picks", (0, PICKS, 1))):
        yield case(
            f"levels-with-a-wrong-digest-of-{name}",
            replace(SCENE, digests={**right, key: bytes(32)}),
            "R-5.7-4 3.6 7.7",
            f"the digest of {name} of level 1 is wrong: that matters from level 1 on",
            "verifies it at level 0, or at no level",
            "E_DIGEST",
            TWIN,
            runs=(*runs, FILE),
        )


def chains() -> Iterator[Case]:
    """Levels of rows, and places of rows with levels."""
    rows: list[tuple[str, Stream, str, str, str]] = [
        ("palette-level-2-of-2", with_palette(ADD, replace(HIGH, level=2)), "R-5.6-3",
         "a row of the palette says level 2, and there are two", "does not bound it"),
        ("palette-level-falls", with_palette(HIGH, LOW, ADD), "R-5.6-3",
         "a row of the palette of level 0 behind one of level 1", "lets it fall"),
        ("palette-level-falls-behind-core", with_palette(HIGH, ADD, LOW), "R-5.6-3",
         "the same, with core between them", "compares with the row before"),
        ("palette-level-falls-behind-size-0", with_palette(entries(0, level=1), LOW), "R-5.6-3",
         "a row of the palette of level 0 behind one of level 1 without bytes",
         "compares with rows that have bytes"),
        ("order-level-and-count",
         with_palette(ADD, replace(LOW, row={"level": 2, "n_drops": 1})), "R-6.1-1 R-5.6-3 6.1",
         "a row of the palette says level 2 of 2, and `n_drops` 1",
         "looks at its counts before its level"),
    ]  # fmt: skip
    for name, stream, rules, tests, faulty in rows:
        yield case(name, stream, rules, tests, faulty, "E_CHAIN", TWIN, (FILE, PROGRESSIVE))


def values() -> Iterator[Case]:
    """Picks of entries that are there and that their packet does not require."""
    both = (LOW, HIGH)
    refines = Packet(records={0: REFINE, 2: REFINE}, psi=numbers(2, seed=1))
    late = replace(ADD, tile=1, level=1)
    rows = [
        ("pick-of-a-higher-level", with_palette(*both, ADD, picks(2, 3, 0)),
         "a pick of a step with label 0 of an entry of level 1", "holds it against all entries"),
        ("pick-of-a-higher-level-behind-core", with_palette(*both, ADD, GROW, picks(2, 3, 0)),
         "the same, behind a later step of core with label 1",
         "takes the label of picks from the last step of core before them"),
        ("pick-of-a-higher-level-behind-picks",
         with_palette(*both, late, picks(3, 4, 0, tile=1), ADD, picks(2, 3, 0), n_tiles=2),
         "the same, behind picks of tile 1 with label 1",
         "holds picks against the highest level so far"),
        ("pick-of-level-2-without-level-0",
         with_palette(replace(HIGH, level=2), ADD, picks(1, 0, 0), n_levels=3),
         "a pick of 1 of a step with label 0, and all entries are of level 2",
         "takes the first packet of the palette for that of level 0"),
        ("pick-of-level-2",
         with_palette(*both, entries(1, level=2), ADD, picks(2, 0, 1), GROW, picks(5, 0),
                      n_levels=3),
         "a pick of a step with label 1 of an entry of level 2",
         "holds picks of label 0 against level 0, and all others against all entries"),
        ("pick-of-a-higher-level-changed",
         with_palette(*both, ADD, picks(2, 0, 1), refines, anew([2, 3])),
         "a new pick of a refined slot, of a step with label 0, of an entry of level 1",
         "holds picks of new slots against their levels, and no others"),
    ]  # fmt: skip
    for name, stream, tests, faulty in rows:
        yield case(name, stream, "R-7.2-4", tests, faulty, "E_INDEX", TWIN, (FILE, PROGRESSIVE))


RECIPES: tuple[Recipe, ...] = (layouts, cuts, digests, chains, values)
