"""Rows of the palette behind picks, which then do not require them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import REFINE, Packet, build, patched, places
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.palette import ADD, GROW, entries, picks, with_palette
from conformance.generator.cases.palette_changes import anew
from conformance.generator.cases.palette_levels import HIGH, LOW
from conformance.generator.cases.palette_states import without
from conformance.generator.cases.palette_waits import order
from conformance.generator.cases.scenes import numbers

FAMILY = "palette"
LEVELS = (FILE, Run(level=0), PROGRESSIVE)
LATER = entries(1, seed=3, level=1)  # of a level whose picks came

# Packets 0 to 10: row 6 of the palette stands behind picks of its level, and before others of it.
SCENE = with_palette(
    ADD,
    LOW,
    picks(2, 0, 1),
    HIGH,
    GROW,
    picks(3, 4),
    LATER,
    replace(ADD, tile=1),
    picks(1, 2, 0, tile=1),
    replace(GROW, tile=1),
    picks(5, 3, tile=1),
    n_tiles=2,
)
TWIN = "places-between-picks-of-a-level"  # SCENE


def layouts() -> Iterator[Case]:
    """Where rows of the palette may stand."""
    yield case(
        TWIN,
        SCENE,
        "R-5.6-3 R-5.6-10 R-7.2-4 12.2",
        "entries of level 1 before picks of label 1, between them, and before picks of label 0",
        "wants all entries of a level before the first picks of that label",
        runs=LEVELS,
    )
    first, other = replace(ADD, level=1), replace(ADD, tile=1)
    rows = [
        ("after-picks-of-another-tile",
         with_palette(other, picks(0, 0, 0, tile=1), entries(1), ADD, picks(1, 0, 1), n_tiles=2),
         "a row of the palette behind picks of tile 1 and before those of tile 0",
         "counts rows of the palette in each tile"),
        ("after-picks-of-a-higher-level", with_palette(first, picks(), entries(1)),
         "a row of the palette of level 0 behind picks of a step with label 1",
         "wants levels to rise over rows of picks, too"),
        ("of-late-picks", with_palette(ADD, GROW, LOW, picks(2, 0, 1), LATER, picks(3, 1)),
         "both steps of core stand before the palette, and picks of each behind some of it",
         "takes the entries that stand before core for those that picks may be of"),
    ]  # fmt: skip
    for name, stream, tests, faulty in rows:
        rules = "R-5.6-10 R-7.2-4 12.2"
        yield case(f"places-{name}", stream, rules, tests, faulty, runs=LEVELS)


def arrivals() -> Iterator[Case]:
    """Which picks wait for which entries."""
    yield case(
        "places-without-later-entries",
        build(SCENE),
        "R-6.4-1 R-6.4-2 12.2 6.4",
        "entries of level 1 are missing: picks of that label before them are shown",
        "lets picks wait for all entries up to their label",
        runs=(without(6, stream=SCENE), order(*(k for k in range(11) if k != 6), stream=SCENE)),
    )


def faults() -> Iterator[Case]:
    """Faults of entries that stand behind picks, and picks of such entries."""
    data = build(SCENE)
    end = places(data).packets[6][1]
    yield case(
        "places-fault-in-later-entries",
        patched(data, end - 1, bytes([data[end - 1] ^ 1])),
        "R-6.4-4 R-6.3-1 12.2 6.4",
        "entries behind picks of their level are wrong: those picks are shown",
        "lets picks wait for all entries up to their label",
        "E_CRC",
        TWIN,
        runs=(PROGRESSIVE, FILE, Run(level=0)),
    )
    refines = Packet(records={0: REFINE, 2: REFINE}, psi=numbers(2, seed=1))
    grown = (ADD, LOW, picks(2, 0, 1), HIGH, GROW)
    rows = [
        ("behind-it", with_palette(ADD, entries(1), picks(1, 0, 2), entries(1, seed=1)),
         "a pick of an entry of its level that stands behind it",
         "holds picks against the entries of their level"),
        ("behind-it-changed",
         with_palette(ADD, LOW, picks(2, 0, 1), refines, anew([2, 3]), entries(1, seed=1)),
         "a new pick of a refined slot of an entry that stands behind it",
         "holds picks of new slots against the entries before them, and no others"),
        ("before-it-of-a-higher-level",
         with_palette(*grown, picks(3, 4), LATER, replace(ADD, tile=1), picks(1, 5, 0, tile=1),
                      n_tiles=2),
         "a pick of a step with label 0 of an entry of level 1 that stands before it",
         "holds picks against all entries that stand before them"),
    ]  # fmt: skip
    for name, stream, tests, faulty in rows:
        yield case(f"places-pick-{name}", stream, "R-7.2-4 12.2", tests, faulty, "E_INDEX", TWIN,
                   (FILE, PROGRESSIVE))  # fmt: skip
    late = with_palette(ADD, entries(1), picks(1, 0, 2), entries(1, seed=1))
    yield case(
        "places-pick-of-entries-that-came-first",
        build(late),
        "R-6.4-4 R-7.2-4 12.2",
        "a pick of an entry that stands behind it and came before it",
        "holds picks against the entries that are there",
        "E_INDEX",
        TWIN,
        runs=(order(0, 1, 3, 2, stream=late), order(3, 1, 2, 0, stream=late)),
    )


RECIPES: tuple[Recipe, ...] = (layouts, arrivals, faults)
