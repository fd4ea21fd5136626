"""Arithmetic: rounding, products, ranges, chains, the transforms of stored integers."""

from __future__ import annotations

from collections.abc import Iterator

from conformance.generator.builder import (
    ADDS_YCOCG,
    BLUE,
    DELTA,
    GREEN,
    PSI_YCOCG,
    RED,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    X,
    Y,
    Z,
)
from conformance.generator.cases.case import Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "numeric"
ALL = tuple(range(14))
CLASSES = tuple(range(8))


def rounding() -> Iterator[Case]:
    """RoundShift, every residue, both signs."""
    for k in (1, 2, 7, 12):
        n = min(2 << k, 33)
        deltas = [(i - n // 2) * max(1, (1 << k) // 16) for i in range(n)]
        records = dict.fromkeys(range(n), SPLIT)
        yield case(
            f"round-shift-k{k}",
            Stream(
                [
                    Packet(adds={X: [0] * n, Y: [1000 + i for i in range(n)]}, n_adds=n),
                    Packet(records=records, psi={X: deltas, Y: deltas, Z: [-d for d in deltas]}),
                ],
                alphas={(0, 0): (k, [1])},
            ),
            "R-7.3-2 4.2 7.3",
            f"{n} products of both signs shifted by {k}, ties among them",
            "truncates, rounds half away from zero or to even, or shifts after it subtracted",
        )
    yield case(
        "round-shift-odd-alphas",
        Stream(
            [
                Packet(adds=numbers(8, spread=500)),
                Packet(
                    records=dict.fromkeys(range(8), SPLIT),
                    psi=numbers(8, spread=63, seed=3),
                    alpha={g: [0, 1, 2, 3, 3, 2, 1, 0] for g in range(5)},
                ),
            ],
            alphas={(0, g): (g + 1, [3, -3, 7, -(1 << g)]) for g in range(5)},
        ),
        "R-7.3-2 4.2 5.4 7.3",
        "every group has a shift of its own, alphas of both signs",
        "uses one shift for all groups, or rounds the magnitude",
    )


def alphas() -> Iterator[Case]:
    """Alpha 0, 1, -1, largest."""
    rows = [
        ("zero", 0, 0, "C2 = P: the second child is a copy", "swaps the children"),
        ("zero-with-a-shift", 5, 0, "RoundShift(0, 5) is 0", "adds the half of the rounding"),
        ("minus-one", 0, -1, "C2 = P + psi: both children are the same", "takes the magnitude"),
        ("largest", 0, 32767, "a = 32767 and K = 0", "keeps a in 8 bits"),
        ("least", 0, -32768, "a = -32768, which has no negative in 16 bits", "negates a in s16"),
        ("one-by-shift", 12, 4096, "a = 4096, K = 12: exactly 1", "rounds where nothing is left"),
        ("least-by-shift", 12, -32768, "a = -32768, K = 12: -8", "shifts before it multiplies"),
        ("tiny", 12, 1, "alpha = 1 / 4096", "divides psi before it multiplies, and gets 0"),
    ]
    for name, k, a, tests, faulty in rows:
        table = {(0, g): (k, [a]) for g in range(5)}
        psi = numbers(2, spread=3000, seed=7)
        packets = [
            Packet(adds=numbers(2, spread=900)),
            Packet(records={0: SPLIT, 1: SPLIT}, psi=psi),
        ]
        rules = "R-5.4-1 R-7.3-2 5.4 7.3"
        yield case(f"alpha-{name}", Stream(packets, alphas=table), rules, tests, faulty)


def sums() -> Iterator[Case]:
    """Running sums of delta."""
    big = 8388607
    up = [big * k for k in range(1, 33)] + [1 << 28]
    names = {f"adds {c}": 0x28 | DELTA for c in (X, Y, RED)}
    yield case(
        "sums-to-the-limits",
        Stream([Packet(adds={X: up, Y: [-v for v in up], RED: up}, codings=names)]),
        "R-7.1-1 R-7.3-1 7.1",
        "running sums end at 2^28 and at -2^28",
        "bounds the sum by 2^28 - 1, or the differences instead of the sums",
    )
    yield case(
        "sums-with-a-step",
        Stream(
            [Packet(adds={X: up[:16]}, codings={"adds 0": 0x28 | DELTA})],
            quantisers={(0, 0): (2, 0)},
        ),
        "R-7.1-1 R-7.3-1 7.1 7.3",
        "the sums are of q, and Delta is twice that",
        "sums Delta and bounds the wrong number",
    )
    yield case(
        "sums-back-and-forth",
        Stream(
            [
                Packet(
                    adds={
                        c: [v * (-1) ** i for i, v in enumerate(range(0, 4000000, 500000))]
                        for c in ALL
                    },
                    codings={f"adds {c}": 0x28 | DELTA for c in ALL},
                )
            ]
        ),
        "R-7.1-1 7.1",
        "differences of alternating sign in all channels, whose sums start anew in each",
        "carries the sum of one channel into the next",
    )


def colours() -> Iterator[Case]:
    """YCoCg-R of large integers."""
    big = 8388607
    triples = [
        (big, big, big),
        (-big - 1, -big - 1, -big - 1),
        (big, -big - 1, 1),
        (-1, -1, -1),
        (0, 1, 1),
        (0, -1, -1),
        (3, -3, 3),
        (-big, 0, big),
    ]
    y, co, cg = (list(column) for column in zip(*triples, strict=True))
    adds = {RED: y, GREEN: co, BLUE: cg}
    yield case(
        "ycocg-extremes",
        Stream(
            [
                Packet(adds=adds, flags=ADDS_YCOCG),
                Packet(records=dict.fromkeys(range(8), REFINE), psi=adds, flags=PSI_YCOCG),
            ]
        ),
        "R-7.3-1 7.1",
        "the largest stored integers and odd negatives through YCoCg-R",
        "divides negative chroma toward zero, or keeps R, G, B in 24 bits",
    )
    limit = [big * k for k in range(1, 33)] + [1 << 28]
    codings = {f"adds {c}": 0x28 | DELTA for c in (RED, GREEN, BLUE)}
    yield case(
        "ycocg-of-the-largest-sums",
        Stream(
            [
                Packet(adds={RED: limit}, flags=ADDS_YCOCG, codings={"adds 11": 0x28 | DELTA}),
                Packet(
                    adds={RED: [-v for v in limit]},
                    flags=ADDS_YCOCG,
                    codings={"adds 11": 0x28 | DELTA},
                ),
            ]
        ),
        "R-7.1-1 R-7.3-1 7.1",
        "Y of 2^28 and -2^28 gives grey at the limit of Delta",
        "bounds the integers before and after the transform by less",
    )
    half = [v // 2 for v in limit]
    yield case(
        "ycocg-whose-parts-cancel",
        Stream(
            [
                Packet(
                    adds={RED: half, GREEN: limit, BLUE: [0] * 33},
                    flags=ADDS_YCOCG,
                    codings=codings,
                )
            ]
        ),
        "R-7.1-1 R-7.3-1 7.1",
        "Co of 2^28 with Y of 2^27: R is 2^28, B is 0",
        "refuses chroma that is larger than a colour may be",
    )


RECIPES: tuple[Recipe, ...] = (
    rounding,
    alphas,
    sums,
    colours,
)
