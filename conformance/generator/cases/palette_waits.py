"""Picks that wait for the entries of their level, and packets that wait for none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import Stream, build, patched, places
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.palette import ADD, GROW, entries, picks, with_palette
from conformance.generator.cases.palette_levels import HIGH, LOW, SCENE, TWIN
from conformance.generator.cases.palette_states import without
from conformance.generator.cases.progressive import came

FAMILY = "palette"


def order(*numbers_: int, stream: Stream = SCENE) -> Run:
    """These packets of a stream came, in this order."""
    spans = places(build(stream)).packets
    pieces = (spans[k] for k in numbers_)
    return came((0, spans[0][0]), *((begin, end - begin) for begin, end in pieces))


def arrivals() -> Iterator[Case]:
    """Which picks wait for which entries."""
    data = build(SCENE)
    rows: list[tuple[str, tuple[Run, ...], str, str]] = [
        (
            "levels-without-level-1",
            (without(3, stream=SCENE), order(*(k for k in range(11) if k != 3))),
            "entries of level 1 are missing: picks of level 0 are shown, later ones wait",
            "lets all picks wait for the whole palette, or those of level 2 for their own entries",
        ),
        (
            "levels-without-level-2",
            (without(8, stream=SCENE), order(0, 1, 2, 3, 4, 5)),
            "entries of level 2 are missing: picks of levels 0 and 1 are shown",
            "lets all picks wait for the whole palette",
        ),
        (
            "levels-without-level-0",
            (without(1, stream=SCENE), order(0, 4, 3, 8, 2, 5)),
            "entries of level 0 are missing: no picks are shown",
            "applies entries of level 1 without those before them, or picks that are of those",
        ),
        (
            "levels-with-later-core",
            (order(0, 4, 1, 2, 5), order(6, 9, 7, 1, 10), order(0, 6, 9, 4, 7, 1, 2)),
            "core of labels 0 and 1, entries and picks of level 0: those picks are shown",
            "takes the label of picks from the last step of core that is there",
        ),
        (
            "levels-palette-last",
            (order(0, 2, 4, 5, 6, 7, 9, 10, 8, 3, 1), order(*range(10, -1, -1))),
            "core and picks, then the palette, its last packet first; all packets backwards",
            "numbers entries as they came, or examines picks before their entries are there",
        ),
        (
            "levels-of-one-tile",
            (order(0, 1, 2, 3, 4, 5), order(6, 7, 1), order(6, 7, 9, 10, 1, 3, 8)),
            "core and picks of a tile, and the entries that they require",
            "waits for packets of the other tile",
        ),
    ]
    for name, runs, tests, faulty in rows:
        yield case(name, data, "R-6.4-1 R-6.4-2 12 6.4", tests, faulty, runs=runs)
    yield case(
        "levels-boundaries",
        data,
        "R-6.4-1 R-6.4-3 12 6.4",
        "the file up to the end of each packet",
        "waits for entries of higher levels, or for core",
        runs=tuple(came((0, end)) for _, end in places(data).packets),
    )
    behind = with_palette(ADD, LOW, HIGH, GROW, picks(2, 0, 1), picks(3, 4))
    yield case(
        "levels-of-late-picks-without-level-1",
        build(behind),
        "R-6.4-1 12 6.4",
        "picks of level 0 stand behind core and entries of level 1, and the entries are missing",
        "takes the label of picks from the last step of core before them",
        runs=(without(2, stream=behind), without(2, 5, stream=behind)),
    )
    empty = with_palette(
        ADD, LOW, picks(2, 0, 1), HIGH, GROW, picks(), replace(ADD, tile=1), picks(tile=1),
        n_tiles=2,
    )  # fmt: skip
    yield case(
        "levels-without-those-of-picks-of-size-0",
        empty,
        "R-6.4-1 R-5.6-5 7.5 6.4",
        "picks of size 0 wait for entries of level 1: the second child shows what P does",
        "shows 0 where picks wait, or lets those of level 0 wait too",
        runs=(without(3, stream=empty), without(1, 3, stream=empty), PROGRESSIVE),
    )
    hollow = with_palette(LOW, entries(0, level=1), ADD, picks(1, 2, 1), GROW, picks(2, 1))
    yield case(
        "levels-without-the-packet-before-one-of-size-0",
        hollow,
        "R-6.4-1 R-5.6-5 6.4",
        "a packet of the palette of size 0 and of level 1 behind one that is missing",
        "takes the entries of level 1 for all there are",
        runs=(without(0, stream=hollow), PROGRESSIVE),
    )


def faults() -> Iterator[Case]:
    """Faults of packets that wait for entries of their level, or do not."""
    data = build(SCENE)
    spans = places(data).packets

    def damaged(*numbers_: int) -> bytes:
        out = data
        for k in numbers_:
            out = patched(out, spans[k][1] - 1, bytes([out[spans[k][1] - 1] ^ 1]))
        return out

    missing = without(3, stream=SCENE)
    rows: list[tuple[str, bytes, tuple[Run, ...], str | None, str]] = [
        ("of-level-0-without-level-1", damaged(7), (missing, order(6, 1, 7)), "E_CRC",
         "picks of level 0 are wrong, and entries of level 1 are missing"),
        ("of-level-1-without-level-1", damaged(5, 8, 10), (missing, order(0, 1, 2, 4, 5)), None,
         "picks and entries of higher levels are wrong, and wait for entries of level 1"),
        ("of-level-1-without-level-2", damaged(5), (without(8, stream=SCENE), FILE), "E_CRC",
         "picks of level 1 are wrong, and entries of level 2 are missing"),
        ("in-entries-of-level-1", damaged(3), (PROGRESSIVE, order(3, 1), order(3, 0)), "E_CRC",
         "entries of level 1 are wrong"),
        ("in-picks-and-later-entries", damaged(2, 3), (order(3, 1, 0, 2), FILE, Run(level=0)),
         "E_CRC", "picks of level 0 are wrong, and so are entries of level 1, which came first"),
    ]  # fmt: skip
    for name, bytes_, runs, code, tests in rows:
        yield case(
            f"levels-fault-{name}",
            bytes_,
            "R-6.4-4 R-6.3-1 12 6.4",
            tests,
            "examines picks before the entries that they require, or after all of the palette",
            code,
            None if code is None else TWIN,
            runs=runs,
        )
    above = with_palette(LOW, HIGH, ADD, picks(3, 0, 1))
    yield case(
        "levels-fault-of-a-pick",
        above,
        "R-6.4-4 R-7.2-4 6.4",
        "a pick of label 0 of an entry of level 1, which is there, or is not",
        "holds picks against the entries that are there, or waits for them",
        "E_INDEX",
        TWIN,
        runs=(PROGRESSIVE, without(1, stream=above), without(0, stream=above)),
    )


RECIPES: tuple[Recipe, ...] = (arrivals, faults)
