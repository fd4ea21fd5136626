"""Slots, kinds, alpha indices and numbers that leave their range, one fault each."""

from __future__ import annotations

from collections.abc import Iterator

from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream, X
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "invalid-values"
THREE = Packet(adds=numbers(3))
ONE = numbers(1, seed=1)
TWIN = "core-kinds-of-one-step"


def slots() -> Iterator[Case]:
    """R-7.2-1."""
    rows = [
        ("first-above", [THREE, Packet(records={3: REFINE}, psi=ONE)],
         "a refine of the slot after the last", "reads a slot that is not made"),
        ("made-by-the-step", [THREE, Packet(records={0: SPLIT, 3: REFINE}, psi=numbers(2))],
         "a refine of the second child that the same step makes", "makes slots as it goes"),
        ("added-by-the-step", [THREE, Packet(records={3: DROP}, adds=ONE)],
         "a drop of a splat that the same step adds", "makes adds before it drops"),
        ("dropped-before", [THREE, Packet(records={1: DROP}), Packet(records={1: REFINE}, psi=ONE)],
         "a refine of a slot that a drop left empty", "refines an empty slot"),
        ("far-away", [THREE, Packet(records={0: REFINE}, psi=ONE, stored={"gaps": [0xFFFFFF]})],
         "a gap of 2^24 - 1", "allocates slots up to there"),
        ("last-of-many",
         [Packet(adds=numbers(9)), Packet(records=dict.fromkeys([0, 2, 8, 9], DROP))],
         "the last of four slots is none", "checks the first slot only"),
        ("middle-of-many", [Packet(adds=numbers(5)), Packet(records={2: DROP}),
                            Packet(records=dict.fromkeys([1, 2, 3], DROP))],
         "the second of three slots is empty", "checks the first and the last slot"),
    ]  # fmt: skip
    for name, packets, tests, faulty in rows:
        yield case(
            f"slot-{name}",
            Stream(packets),
            "R-7.2-1",
            tests,
            faulty,
            "E_SLOT",
            TWIN,
            runs=(FILE, PROGRESSIVE),
        )
    n = 257
    gaps = [0xFFFFFF] * 256 + [0]
    yield case(
        "slot-sum-wraps",
        Stream([Packet(adds={X: list(range(n))}), Packet(
            records=dict.fromkeys(range(n), DROP), stored={"gaps": gaps})]),
        "R-7.2-1 7.2",
        "gaps that sum to 2^32 - 1, after which the next slot would be 0",
        "adds gaps in 32 bits and checks the last slot only",
        "E_SLOT",
        "slots-all-of-many",
    )  # fmt: skip
    yield case(
        "slots-all-of-many",
        Stream([Packet(adds={X: list(range(n))}), Packet(records=dict.fromkeys(range(n), DROP))]),
        "R-7.2-1 7.2",
        "all of 257 splats are dropped",
        "takes a list of gaps without planes for no records",
    )


def kinds() -> Iterator[Case]:
    """R-7.2-2."""
    records = {0: SPLIT, 1: REFINE, 2: DROP}
    rows = [
        ("3", [1, 0, 3], "a kind 3, add", "takes it for an add, or for none"),
        ("255", [1, 255, 2], "a kind 255", "takes it for -1"),
        ("257", [257, 0, 2], "a kind 257, which is 1 modulo 256", "keeps kinds in 8 bits"),
        ("split-for-refine", [1, 1, 2], "two splits where the row says one of each",
         "counts the kinds itself and reads psi and alpha by its own counts"),
        ("drop-for-split", [2, 0, 2], "two drops where the row says one",
         "checks the sum of the counts only"),
        ("permuted-counts", [0, 0, 1], "no drop, though the row says one",
         "checks the number of splits only"),
    ]  # fmt: skip
    for name, stored, tests, faulty in rows:
        packet = Packet(records=records, psi=numbers(2), stored={"kinds": stored})
        yield case(
            f"kind-{name}", Stream([THREE, packet]), "R-7.2-2", tests, faulty, "E_KIND", TWIN
        )


def indices() -> Iterator[Case]:
    """R-7.2-3."""
    table = {(0, 1): (0, [1, 2, 3]), (1, 0): (0, [1, 2, 3])}
    rows = [
        ("3-of-3", {1: [3]}, 0, "an index just past its table"),
        ("1-without-table", {0: [1]}, 0, "an index 1 where the table has only the default"),
        ("of-another-level", {1: [1]}, 1, "an index that the table of level 0 would allow"),
        ("of-another-group", {2: [2]}, 0, "an index that the table of rotation would allow"),
        ("65536", {1: [65536]}, 0, "an index that is 0 modulo 65536"),
        ("of-sh", {4: [1]}, 0, "an index of SH 1 where the table has only the default"),
    ]
    for name, alpha, level, tests in rows:
        packet = Packet(records={0: SPLIT}, psi=ONE, alpha=alpha, level=level)
        yield case(
            f"index-{name}",
            Stream([THREE, packet], alphas=table, n_levels=2),
            "R-7.2-3",
            tests,
            "reads past the table, clamps the index, or looks into another table",
            "E_INDEX",
            "index-last",
        )
    packets = [THREE, Packet(records={0: SPLIT}, psi=ONE, alpha={1: [2]}),
               Packet(records={0: SPLIT}, psi=ONE, alpha={0: [2]}, level=1)]  # fmt: skip
    yield case(
        "index-last",
        Stream(packets, alphas=table, n_levels=2),
        "R-7.2-3",
        "the last entry of each table",
        "takes `last` for the number of entries",
    )


RECIPES: tuple[Recipe, ...] = (
    slots,
    kinds,
    indices,
)
