"""Picks of slots that a step refines or splits: bit 2 of the flags of a packet of picks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import (
    ADDS_YCOCG,
    DROP,
    OF_CHANGED,
    PICKS,
    PSI_YCOCG,
    REFINE,
    SPLIT,
    Packet,
    Stream,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, VERIFY, Case, Recipe, case
from conformance.generator.cases.invalid_palette import refused
from conformance.generator.cases.palette import ADD, GROW, entries, picks, with_palette
from conformance.generator.cases.palette_states import without
from conformance.generator.cases.scenes import numbers

FAMILY = "palette"
MIXED = Packet(
    records={0: SPLIT, 1: REFINE, 2: SPLIT}, psi=numbers(3, seed=1), adds=numbers(1, seed=2)
)
REFINES = Packet(records={0: REFINE, 2: REFINE}, psi=numbers(2, seed=3))
DROPS = Packet(records={1: DROP})
BEGIN = (ADD, entries(8), picks(1, 2, 3))


def anew(changed: Sequence[int] = (), new: Sequence[int] = ()) -> Packet:
    """A packet of picks: of slots refined or split, then of new ones; without any, all are 0."""
    return replace(picks(*new), repicks=changed)


def changes() -> Iterator[Case]:
    """Which slots get which pick."""
    rows = [
        (
            "changed-slots",
            [*BEGIN, GROW, anew([5, 6], [7, 8])],
            "R-7.2-4 12 5.9 7.4",
            "new picks of a slot that is split and of one that is refined, then those of new slots",
            "refuses or ignores bit 2, or stores picks of new slots first",
        ),
        (
            "changed-slots-in-order",
            [*BEGIN, MIXED, anew([4, 5, 6], [7, 8, 1])],
            "R-7.2-4 12 5.9",
            "splits of slots 0 and 2 and a refine of slot 1: picks are in order of slot",
            "takes picks of splits first, or of refines, or a pair of them for each split",
        ),
        (
            "changed-slots-and-no-new-ones",
            [*BEGIN, REFINES, anew([7, 8])],
            "R-7.2-4 5.9 7.4",
            "two refines with new picks, and no slot is new",
            "wants no picks where no slot is new",
        ),
        (
            "changed-slots-without-the-flag",
            [*BEGIN, MIXED, picks(4, 5, 6), REFINES, picks()],
            "R-7.2-4 R-5.6-5 12 5.6",
            "bit 2 is not set, and then no bytes are: refined and split slots keep their picks",
            "takes picks of changed slots as of a packet before, or shows 0",
        ),
        (
            "changed-slots-to-0",
            [*BEGIN, MIXED, anew([0, 0, 6], [0, 8, 0])],
            "R-7.2-4 12",
            "picks of 0 of changed slots: their SH above band 0 are 0 from then on",
            "lets 0 mean that a slot keeps its pick",
        ),
        (
            "changed-slots-to-0-without-planes",
            [*BEGIN, GROW, anew()],
            "R-7.2-4 5.6 5.9",
            "bit 2 and a coding byte of 0: picks of changed and of new slots are 0",
            "takes the packet for one of size 0, with which slots keep their picks",
        ),
        (
            "changed-slots-then-size-0",
            [*BEGIN, REFINES, anew([4, 0]), MIXED, picks()],
            "R-7.2-4 R-5.6-5 12",
            "new picks of slots 0 and 2, then splits of both: second children have the new ones",
            "takes the picks of parents that they had at first",
        ),
        (
            "changed-slots-again",
            [*BEGIN, REFINES, anew([4, 5]), GROW, anew([6, 0], [7, 8])],
            "R-7.2-4 12",
            "slot 0 has another pick after each of three steps",
            "keeps the first pick, or gives new picks in one step only",
        ),
        (
            "changed-slots-of-a-step-of-adds",
            [ADD, entries(3), anew([], [3, 1, 2]), Packet(adds=numbers(1, seed=4)), anew([], [2])],
            "R-7.2-4 5.9",
            "bit 2 where no slot is refined or split: picks are of new slots",
            "wants picks of slots that are left as they are",
        ),
        (
            "changed-slots-of-a-step-of-drops",
            [*BEGIN, DROPS, anew(), REFINES, anew([4, 5])],
            "R-5.9-4 R-7.2-4 5.9",
            "bit 2 in a step of a drop alone: it has no picks",
            "takes a pick for a dropped slot",
        ),
        (
            "changed-slots-with-all-flags",
            [*BEGIN, GROW, replace(anew([5, 6], [7, 8]), flags=PSI_YCOCG | ADDS_YCOCG)],
            "R-4.4-1 5.9",
            "bit 2, and both flags of YCoCg-R, which have nothing to act on",
            "refuses them, or transforms SH",
        ),
    ]
    for name, packets, rules, tests, faulty in rows:
        runs = (FILE, Run(level=0))
        yield case(name, with_palette(*packets), rules, tests, faulty, runs=runs)


def late_changes() -> Iterator[Case]:
    """New picks that come after later core packets, or not at all."""
    again = Packet(records={0: SPLIT, 3: REFINE, 1: DROP}, psi=numbers(2, seed=5))
    cores = (ADD, MIXED, again)
    chosen = (picks(1, 2, 3), anew([4, 5, 6], [7, 8, 1]), anew([2, 3], [8]))
    rows = [
        ("late-changes", [*cores, *chosen], "all core packets, then all picks"),
        ("late-changes-but-the-last", [*cores, *chosen[:2]],
         "two packets of picks, under three of core: children show the new pick of the parent"),
        ("late-changes-but-the-first", [*cores, chosen[0]],
         "the picks of the first step alone: slots show those, whatever comes later"),
    ]  # fmt: skip
    for name, packets, tests in rows:
        yield case(
            name,
            with_palette(entries(8), *packets, n_levels=1),
            "R-7.5-1 R-7.2-4 7.4 7.5",
            tests,
            "uses the slots of the last core packet, or shows the pick that a slot was made with",
            runs=(FILE, PROGRESSIVE),
        )
    stream = replace(
        with_palette(entries(8), *cores, *chosen, n_levels=1),
        digests={(0, PICKS, step): None for step in range(3)},
    )
    yield case(
        "late-changes-of-a-dropped-slot",
        stream,
        "R-5.7-3 R-5.7-4 R-7.5-1 7.7",
        "digests after each packet of picks: slot 1 has a new pick before a later step drops it",
        "gives no pick to a slot that core has dropped, or digests picks as they were made",
        runs=(FILE, VERIFY),
    )
    lost = with_palette(*BEGIN, REFINES, anew([7, 8]), GROW, anew([4, 5], [6, 1]))
    yield case(
        "without-changes",
        lost,
        "R-6.4-1 R-7.5-1 6.4 7.5",
        "packets of new picks are missing: slots keep the picks they have",
        "shows 0 where a new pick is missing, or takes that of the next step",
        runs=(without(4, stream=lost), without(6, stream=lost), without(1, stream=lost)),
    )


def faults() -> Iterator[Case]:
    """Picks of changed slots, and bit 2 where it is reserved."""

    def last(packet: Packet, core: Packet = GROW) -> Stream:
        return with_palette(*BEGIN, core, packet)

    bands = Stream([ADD, Packet(component=1, adds=numbers(3, 9), flags=OF_CHANGED)], degree=1)
    yield from refused([
        ("changed-pick-above", last(anew([1, 9], [2, 3])), "R-7.2-4", "E_INDEX",
         "the new pick of a refined slot is of entry 9, and there are eight",
         "holds picks of new slots against the entries, and no others"),
        ("changed-picks-missing", last(replace(picks(5, 6), flags=OF_CHANGED)), "R-5.10-3",
         "E_FRAME", "bit 2 is set, and the plane of picks is as long as if it were not",
         "takes the number of picks from the frame"),
        ("changed-picks-without-the-flag", last(picks(5, 6, 7, 8, 1), MIXED), "R-5.10-3",
         "E_FRAME", "bit 2 is not set, and there are picks of refined slots",
         "takes the number of picks from the frame"),
        ("changed-picks-of-drops", last(replace(anew(), coding_bytes={"picks": 1}), DROPS),
         "R-5.9-4", "E_PACKET", "bit 2 in a step of a drop alone, and a coding byte of 1",
         "counts drops among the slots that have new picks"),
        ("palette-with-bit-2",
         with_palette(ADD, replace(entries(2), flags=OF_CHANGED), picks(1, 2, 0)), "R-4.4-1",
         "E_RESERVED", "bit 2 of the flags of a packet of the palette",
         "allows it in all packets of such a stream"),
        ("core-with-bit-2",
         with_palette(replace(ADD, flags=OF_CHANGED), entries(2), picks(1, 2, 0)), "R-4.4-1",
         "E_RESERVED", "bit 2 of the flags of core, in a stream with a palette",
         "allows it in all packets of such a stream"),
        ("band-with-bit-2", bands, "R-4.4-1", "E_RESERVED",
         "bit 2 of the flags of component 1, in a stream without a palette",
         "allows it in component 1 of any stream"),
    ])  # fmt: skip


RECIPES: tuple[Recipe, ...] = (changes, late_changes, faults)
