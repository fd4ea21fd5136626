"""SH that is late, and packets outside the cut."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream, Tile, build, places
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.progressive import ADD, GROW, came
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "progressive"


def late_bands() -> Iterator[Case]:
    """SH bands behind the core packets that follow theirs."""
    split = Packet(records={0: SPLIT, 1: SPLIT}, psi=numbers(2, seed=1), adds=numbers(1, seed=2))
    again = Packet(records={3: SPLIT, 4: SPLIT, 0: DROP}, psi=numbers(2, seed=3))
    deep = Packet(records={6: SPLIT, 5: REFINE}, psi=numbers(2, seed=4))
    cores = [ADD, split, again, deep]
    pairs = list(banded(cores, 1))
    core, band = pairs[::2], pairs[1::2]
    rows = [
        ("all-late", [*core, *band], "all core packets, then all of a band"),
        (
            "one-late",
            [core[0], core[1], band[0], core[2], band[1], core[3], band[2], band[3]],
            "the band is always a step late",
        ),
        ("first-only", [*core, band[0]], "one step of the band, under three of core"),
        ("first-two", [*core[:2], band[0], *core[2:], band[1]], "two steps of the band"),
        ("none-for-long", [*core, band[0], band[1], band[2]], "three steps of the band"),
    ]
    for name, packets, tests in rows:
        yield case(
            f"band-{name}",
            Stream(packets, degree=1),
            "R-7.5-1 R-5.6-2 7.5",
            f"{tests}: slots show the SH of the ancestor they were split from",
            "shows 0, the parent only, or SH of a slot of the same number; or SH of empty slots",
            runs=(FILE, PROGRESSIVE),
        )
    yield case(
        "band-of-an-add-is-late",
        Stream(
            [
                core[0],
                Packet(component=1, adds=numbers(3, 9, seed=9)),
                Packet(adds=numbers(2, seed=5)),
                Packet(records={3: SPLIT}, psi=numbers(1, seed=6)),
            ],
            degree=1,
        ),
        "R-7.5-1 7.5",
        "SH of adds that did not come are 0, also those of the splats split from them",
        "shows the SH of some other slot",
    )
    yield case(
        "band-late-for-a-dropped-slot",
        Stream(
            [core[0], Packet(records={1: DROP}), Packet(component=1, adds=numbers(3, 9, seed=8))],
            degree=1,
            digests={(0, 1, 0): None},
        ),
        "R-7.5-1 R-5.7-3 7.5 7.7",
        "SH come for a slot that a later step of core dropped: it shows 0, and the digest has them",
        "shows them, or leaves them out of the state",
        runs=(FILE, Run(verify=True)),
    )
    yield case(
        "band-late-with-alpha-of-its-level",
        Stream(
            [
                core[0],
                replace(split, level=1, alpha={4: [1, 0]}),
                replace(split, level=2, records={3: SPLIT, 4: SPLIT}, alpha={4: [1, 1]}),
                *[Packet(component=1, adds=numbers(3, 9), psi={})],
                Packet(component=1, psi=numbers(2, 9, seed=3), adds=numbers(1, 9, seed=1)),
                Packet(component=1, psi=numbers(2, 9, seed=4), adds=numbers(1, 9, seed=2)),
            ],
            degree=1,
            n_levels=3,
            alphas={(1, 4): (1, [3, 5]), (2, 4): (2, [-7, 9])},
            quantisers={(2, 5): (3, 1), (3, 5): (7, 0)},
        ),
        "R-7.5-1 R-5.4-2 7.4 7.5",
        "late bands use steps, alpha tables and indices of the step they belong to",
        "uses those of the last core packet",
    )
    bands = [
        *core,
        *[Packet(component=3, adds=numbers(3, 21, seed=2))],
        band[0],
        band[1],
        Packet(component=2, adds=numbers(3, 15, seed=1)),
    ]
    yield case(
        "bands-each-at-another-step",
        Stream(bands, degree=3),
        "R-7.5-1 R-5.6-2 7.5",
        "band 1 has two steps, bands 2 and 3 have one, core has four; band 3 came first",
        "uses the steps of one band for all, or wants lower bands first",
    )
    yield case(
        "band-of-size-0-behind-a-missing-packet",
        Stream([core[0], band[0], core[1], Packet(component=1), Packet(adds=numbers(1))], degree=1),
        "R-6.4-1 R-7.5-1 6.4 7.5",
        "a band of size 0 is complete from the start, and waits for its core",
        "applies it at once, or never",
        runs=size_0_runs(
            Stream(
                [core[0], band[0], core[1], Packet(component=1), Packet(adds=numbers(1))], degree=1
            )
        ),
    )


def size_0_runs(stream: Stream) -> tuple[Run, ...]:
    """Without packet 1, without packet 2, without the last."""
    data = build(stream)
    packets, size = places(data).packets, len(data)
    runs = [PROGRESSIVE]
    for k in (1, 2, 4):
        start, end = packets[k]
        runs.append(came(*[p for p in [(0, start), (end, size - end)] if p[1]]))
    return tuple(runs)


def outside_the_cut() -> Iterator[Case]:
    """Faults in packets that the level asked for does not have."""
    bad = [
        ("crc", replace(GROW, row={"crc": 1}), "E_CRC", "has a wrong checksum"),
        ("header", replace(GROW, flags=0x80), "E_RESERVED", "has a reserved flag"),
        (
            "slot",
            replace(GROW, records={0: SPLIT, 9: REFINE}),
            "E_SLOT",
            "names a slot that is none",
        ),
    ]
    rule_of = {"E_CRC": "R-6.3-1", "E_RESERVED": "R-4.4-1", "E_SLOT": "R-7.2-1"}
    for name, packet, code, tests in bad:
        yield case(
            f"level-without-fault-of-{name}",
            Stream([ADD, packet], n_levels=2),
            f"R-4.1-1 R-6.2-3 {rule_of[code]}",
            f"the packet of level 1 {tests}: that matters to level 1 only",
            "examines packets that it was not asked for",
            code,
            "arrival-head-last",
            runs=(FILE, Run(level=0)),
        )
    whole = Stream([ADD, GROW, replace(ADD, level=2)], n_levels=3)
    data = build(whole)
    packets = places(data).packets
    yield case(
        "level-of-a-truncated-file",
        data[: packets[1][1] - 1],
        "R-6.2-2 R-6.2-3 6.2",
        "packet 1 lacks a byte, packet 2 is missing: level 0 is there",
        "wants the whole file for any level",
        "E_TRUNCATED",
        "arrival-head-last",
        runs=(FILE, Run(level=1), Run(level=0), PROGRESSIVE),
    )
    yield case(
        "level-of-a-file-with-a-tail",
        data + b"\0",
        "R-6.2-1 R-6.2-3 6.1",
        "a byte follows the last packet, whatever the level",
        "looks no further than its level",
        "E_TRAILING",
        "arrival-head-last",
        runs=(FILE, Run(level=0)),
    )
    behind = [ADD, GROW, Packet(tile=1)]
    cut_off = build(Stream(behind, n_levels=2, tiles=(Tile(), Tile())))
    yield case(
        "level-whose-empty-packet-is-behind-the-end",
        cut_off[: places(cut_off).packets[0][1]],
        "R-6.2-2 R-6.2-3 6.2",
        "the packet of level 1 is missing; behind it stands a packet of level 0 without bytes",
        "takes a packet of no bytes for missing where the file ends before it",
        "E_TRUNCATED",
        "arrival-head-last",
        runs=(Run(level=1), Run(level=0)),
    )


RECIPES: tuple[Recipe, ...] = (
    late_bands,
    outside_the_cut,
)
