"""Shapes of trees."""

from __future__ import annotations

from collections.abc import Iterator

from conformance.decoders.outcomes import Run
from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream, Tile, X, Y
from conformance.generator.cases.case import FILE, Case, Recipe, case
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "shapes"
ONE = Packet(adds=numbers(1))


def one(slot: int, seed: int, level: int = 0, kind: int = SPLIT) -> Packet:
    """A step of one record."""
    psi = {} if kind == DROP else numbers(1, seed=seed)
    return Packet(records={slot: kind}, psi=psi, level=level)


def trees() -> Iterator[Case]:
    """Chains, combs, full trees."""
    rows = [
        (
            "chain-of-second-children",
            [ONE, *(one(k, k) for k in range(40))],
            0,
            "the newest splat splits, 40 times",
            "bounds depth, or recurses",
        ),
        (
            "chain-of-first-children",
            [ONE, *(one(0, k) for k in range(40))],
            0,
            "slot 0 splits, 40 times",
            "takes the children of the first step for those of the last",
        ),
        (
            "chain-with-a-band",
            list(banded([ONE, *(one(k, k) for k in range(9))], 1)),
            1,
            "a chain of ten generations with an SH band",
            "splits bands from another parent",
        ),
    ]
    for name, packets, degree, tests, faulty in rows:
        yield case(f"{name}", Stream(packets, degree=degree), "R-7.2-1 3.4 7.4", tests, faulty)
    full = [ONE]
    for level in range(6):
        n = 1 << level
        full.append(
            Packet(records=dict.fromkeys(range(n), SPLIT), psi=numbers(n, seed=level), level=level)
        )
    yield case(
        "full-binary-tree",
        Stream(full, n_levels=6),
        "R-7.2-1 R-5.6-6 R-5.6-3 3.4",
        "all splats split, six times",
        "numbers second children breadth-first by another order than that of the parents' slots",
        runs=(FILE, *(Run(level=k) for k in range(5))),
    )
    yield case(
        "wide-level",
        Stream(
            [
                Packet(
                    adds={X: list(range(-500, 500)), Y: [k * k % 97 for k in range(1000)]},
                    n_adds=1000,
                ),
                Packet(
                    records={k: k // 3 % 3 for k in range(0, 1000, 3)},
                    psi={X: [k % 23 - 11 for k in range(223)]},
                ),
            ]
        ),
        "R-7.2-1 R-7.2-2 5.9",
        "a thousand splats, of which every third has a record",
        "keeps slots or gaps in 8 bits",
    )


def drops() -> Iterator[Case]:
    """Splats that come and go."""
    yield case(
        "everything-dropped",
        Stream(
            [Packet(adds=numbers(4)), Packet(records=dict.fromkeys(range(4), DROP), level=1)],
            n_levels=2,
        ),
        "R-5.6-6 3.3 7.7",
        "no splat is left: four empty slots",
        "dumps no slots, or refuses a scene without splats",
    )
    again = [
        Packet(adds=numbers(2)),
        Packet(records={0: DROP, 1: DROP}),
        Packet(adds=numbers(3, seed=2)),
        Packet(records={2: SPLIT, 4: DROP}, psi=numbers(1)),
        Packet(records={3: DROP, 5: DROP, 2: DROP}),
    ]
    yield case(
        "dropped-and-added-again",
        Stream(again),
        "R-7.2-1 R-5.6-6 3.3 3.4",
        "all splats are dropped twice; slots go on from where they were",
        "starts again from slot 0 when all slots are empty",
    )
    yield case(
        "second-child-outlives-its-parent",
        Stream(
            list(
                banded(
                    [
                        Packet(adds=numbers(2)),
                        one(0, 1),
                        one(0, 2, kind=DROP),
                        one(2, 3),
                        one(2, 4, kind=DROP),
                    ],
                    1,
                )
            ),
            degree=1,
        ),
        "R-7.2-1 3.3 7.4",
        "parents are dropped after they split, and their children after those",
        "drops a splat with all that was split from it",
    )
    yield case(
        "late-band-of-a-dropped-ancestor",
        Stream(
            [
                Packet(adds=numbers(2)),
                Packet(component=1, adds=numbers(2, 9)),
                one(0, 1),
                one(0, 2, kind=DROP),
                one(2, 3),
            ],
            degree=1,
        ),
        "R-7.5-1 7.5",
        "slots show the SH of an ancestor that was dropped since",
        "shows 0, because the ancestor's slot is empty now",
    )
    yield case(
        "every-other-slot",
        Stream(
            [
                Packet(adds=numbers(24)),
                Packet(records=dict.fromkeys(range(0, 24, 2), DROP)),
                Packet(records=dict.fromkeys(range(1, 24, 2), SPLIT), psi=numbers(12, seed=3)),
            ]
        ),
        "R-7.2-1 7.2",
        "gaps of 1 between all records, over empty slots",
        "counts gaps over live slots only",
    )


def steps() -> Iterator[Case]:
    """Steps without records, levels without steps."""
    yield case(
        "steps-without-records",
        Stream(
            [Packet(), ONE, Packet(), Packet(level=1), one(0, 1, 1), Packet(level=2)], n_levels=4
        ),
        "R-5.6-5 R-5.6-8 3.4",
        "four of six steps have no records",
        "does not count them as steps, or wants a splat first",
    )
    yield case(
        "steps-without-records-with-bands",
        Stream(
            list(banded([Packet(), ONE, Packet(), one(0, 1), Packet()], 1)),
            degree=1,
            digests={(0, 0, 4): None, (0, 1, 4): None},
        ),
        "R-5.6-5 R-5.7-3 3.5",
        "steps without records have packets of bands, of size 0, too",
        "pairs the packets of bands with steps that have records",
        runs=(FILE, Run(verify=True)),
    )
    yield case(
        "level-0-without-steps",
        Stream([Packet(adds=numbers(2), level=2), one(0, 1, 3)], n_levels=5),
        "R-5.6-3 3.4",
        "levels 0 and 1 are empty, level 4 equals level 3",
        "takes the first step for level 0",
        runs=(FILE, *(Run(level=k) for k in range(5))),
    )
    yield case(
        "many-generations-in-one-level",
        Stream([ONE, *(one(k // 2, k, 1) for k in range(12)), one(3, 77, 2)], n_levels=3),
        "R-5.6-3 3.4",
        "twelve steps of level 1",
        "applies one step of each level",
    )
    yield case(
        "tiles-some-empty",
        Stream(
            [
                Packet(adds=numbers(2), tile=3),
                Packet(tile=1),
                Packet(adds=numbers(1, seed=1), tile=4),
            ],
            tiles=[Tile((k, 0, -k)) for k in range(6)],
        ),
        "R-5.6-1 3.5 7.7",
        "six tiles: without packets, with an empty step, with splats",
        "dumps only tiles with splats",
    )
    yield case(
        "refines-only",
        Stream(
            [
                Packet(adds=numbers(5)),
                *(
                    Packet(records=dict.fromkeys(range(5), REFINE), psi=numbers(5, seed=k), level=k)
                    for k in range(1, 4)
                ),
            ],
            n_levels=4,
        ),
        "R-7.2-2 3.3",
        "three levels that refine all splats: the list of kinds is empty",
        "reads kinds that are not stored",
    )
    yield case(
        "adds-only",
        Stream([Packet(adds=numbers(k + 1, seed=k), level=k) for k in range(4)], n_levels=4),
        "R-5.6-6 3.3",
        "four levels of adds",
        "expects records in later levels",
    )


RECIPES: tuple[Recipe, ...] = (trees, drops, steps)
