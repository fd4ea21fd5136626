"""Arithmetic at its limits: |X|, Delta, products, chains, boxes."""

from __future__ import annotations

from collections.abc import Iterator

from conformance.decoders.outcomes import Run
from conformance.generator.builder import MAX_X, RED, REFINE, SPLIT, Packet, Stream, Tile, X, Y, Z
from conformance.generator.cases.case import FILE, Case, Recipe, case
from conformance.generator.cases.numeric import CLASSES
from conformance.generator.cases.scenes import class_of, numbers, same

FAMILY = "numeric"


def ranges() -> Iterator[Case]:
    """|X| up to 2^30 - 1."""
    for sign, name in ((1, "largest"), (-1, "least")):
        yield case(
            f"x-{name}",
            at_limit(sign),
            "R-7.3-1 R-7.3-3 R-7.3-4 7.3",
            f"every channel of core reaches {sign * MAX_X}",
            "keeps numbers in float32 or 24 bits, or takes the bound for 2^29",
        )
    for sign, name in ((1, "largest"), (-1, "least")):
        yield case(
            f"x-{name}-of-bands",
            at_limit(sign, degree=3),
            "R-7.3-1 R-7.3-3 7.3",
            f"every channel of all SH bands reaches {sign * MAX_X}",
            "keeps SH in 16 bits or float16",
        )
    yield case(
        "x-largest-of-second-child",
        second_child_at(1),
        "R-7.3-2 R-7.3-3 7.3",
        "a second child reaches 2^30 - 1 and another -(2^30 - 1)",
        "checks the first child only against a smaller bound, or saturates",
    )
    yield case(
        "x-16777217",
        Stream(
            [
                Packet(adds=same([1])),
                Packet(records={0: SPLIT}, psi=same([1])),
            ],
            quantisers={(0, c): (1, 24) for c in CLASSES},
        ),
        "R-7.3-3 7.3",
        "2^24 + 1 in every channel: float32 has no such number",
        "keeps numbers in float32",
    )
    yield case(
        "x-2-to-the-24-plus-odd-after-split",
        Stream(
            [
                Packet(adds=same([1, -1])),
                Packet(records={0: SPLIT, 1: SPLIT}, psi=numbers(2, spread=1 << 20)),
            ],
            quantisers={(0, c): (3, 24) for c in CLASSES},
            alphas={(0, g): (1, [3]) for g in range(5)},
        ),
        "R-7.3-2 R-7.3-3 7.3",
        "parents of 3 * 2^24 with odd psi, and alpha = 3/2",
        "adds in float32",
    )


def steps() -> Iterator[Case]:
    """Delta = q * M * 2^E up to 2^28."""
    rows = [
        ("m1-e24", 1, 24, 16),
        ("m16-e24", 16, 24, 1),
        ("m65535-e0", 65535, 0, 4096),
        ("m65535-e24", 65535, 24, 0),
        ("m255-e12", 255, 12, 257),
        ("m3-e5", 3, 5, 2796202),
        ("m17-e23", 17, 23, 1),
    ]
    for name, m, e, most in rows:
        q = [most, -most, min(most, 1), 0]
        psi = [q[1], q[0], q[3], q[2]]
        yield case(
            f"delta-{name}",
            Stream(
                [
                    Packet(adds=same(q), n_adds=4),
                    Packet(records=dict.fromkeys(range(4), REFINE), psi=same(psi)),
                ],
                quantisers={(row, c): (m, e) for row in range(2) for c in CLASSES},
            ),
            "R-5.3-1 R-5.3-2 R-7.3-1 7.3",
            f"M = {m}, E = {e}: the largest |q| of both signs is {most}",
            "keeps q * M in 16 or 32 bits, or bounds |q| and not |Delta|",
        )
    yield case(
        "stored-integers-of-24-bits",
        Stream(
            [
                Packet(adds=same([8388607, -8388608, 0, -1, 1])),
                Packet(records={0: SPLIT, 3: REFINE}, psi=same([-8388608, 8388607])),
            ]
        ),
        "R-7.3-1 7.1",
        "the largest and the least integer that 24 bits hold after zigzag",
        "reads planes as signed bytes, or keeps the sign as a bit",
    )


def products() -> Iterator[Case]:
    """|a * Delta| + half up to 2^30."""
    rows = [
        ("least-a", -32768, 0, 32768, 1),
        ("largest-a", 32767, 0, 32769, 1),
        ("with-half", 32767, 12, 32768, 1),
        ("tight-with-half", 4, 12, 524287, 512),
        ("of-the-largest-delta", 4, 1, 16385, 16383),
    ]
    for name, a, k, q, m in rows:
        sign = 1 if a < 0 else -1
        yield case(
            f"product-{name}",
            Stream(
                [
                    Packet(adds=same([-5 * sign, 5 * sign])),
                    Packet(records={0: SPLIT, 1: SPLIT}, psi=same([q, -q])),
                ],
                quantisers={(1, c): (m, 0) for c in CLASSES},
                alphas={(0, g): (k, [a]) for g in range(5)},
            ),
            "R-7.3-2 7.3",
            f"a = {a}, K = {k}, |Delta| = {q * m}: the product is at or just below 2^30",
            "keeps the product in 24 or 31 bits",
        )


def chains() -> Iterator[Case]:
    """64 generations."""
    step = {(1 + level, c): (1, 24) for level in range(63) for c in CLASSES}
    step |= {(64, c): (4095, 0) for c in CLASSES}
    last = 4097  # 4095 * 4097 = 2^24 - 1
    for name, sign, table, of_second in (
        ("first-children-up", 1, None, False),
        ("first-children-down", -1, None, False),
        ("second-children-up", -1, None, True),
        ("second-children-down", 1, None, True),
    ):
        packets = [Packet(n_adds=1)]
        for level in range(64):
            slot = level if of_second else 0
            q = sign if level < 63 else sign * last
            kind = SPLIT if of_second or level % 8 == 0 else REFINE
            packets.append(Packet(records={slot: kind}, psi=same([q]), level=level))
        yield case(
            f"chain-{name}",
            Stream(packets, n_levels=64, quantisers=step, alphas=table),
            "R-7.3-3 R-7.3-4 3.4 7.3",
            f"64 {name.replace('-', ' ')}, each 2^24 further, the last at the limit of |X|",
            "lets the error of float32 grow, or bounds the number of generations",
            runs=(FILE, Run(level=0), Run(level=31), Run(level=62)),
        )
    packets = [Packet(adds=numbers(1, spread=4000))]
    for level in range(64):
        psi = numbers(1, spread=300000, seed=level)
        packets.append(Packet(records={level: SPLIT}, psi=psi, level=level))
    yield case(
        "chain-of-roundings",
        Stream(
            packets,
            n_levels=64,
            alphas={
                (lv, g): (g + 3, [(lv * 7 + g) % 23 - 11]) for lv in range(64) for g in range(5)
            },
        ),
        "R-7.3-2 R-7.3-3 4.2 7.3",
        "64 splits of the newest splat, each with other alphas: a wrong rounding adds up",
        "rounds otherwise, or keeps the unrounded value of the parent",
        runs=(FILE, Run(level=0), Run(level=9), Run(level=40)),
    )


def boxes() -> Iterator[Case]:
    """Positions against the box."""
    yield case(
        "box-of-one-point",
        Stream(
            [
                Packet(adds={X: [-7], Y: [9], Z: [0]}),
                Packet(records={0: SPLIT}, psi={X: [0]}),
                Packet(records={0: REFINE}, psi={RED: [5]}),
            ],
            tiles=(Tile(low=(-7, 9, 0), high=(-7, 9, 0)),),
        ),
        "R-5.5-2 R-7.3-4 5.5",
        "splats on all six faces of a box without volume",
        "wants positions inside, not on, the box",
    )
    yield case(
        "box-does-not-bind-the-dropped",
        Stream(
            [
                Packet(adds={X: [10, 12]}),
                Packet(records={0: 2}),
                Packet(records={1: REFINE}, psi={X: [1]}),
            ],
            tiles=(Tile(low=(10, 0, 0), high=(13, 0, 0)),),
        ),
        "R-7.3-4 3.3",
        "an empty slot has position 0, which is outside the box",
        "checks empty slots against the box",
    )
    yield case(
        "box-with-large-origin",
        Stream(
            [Packet(adds={X: [5], Y: [-5]})],
            tiles=(Tile((1 << 52, -(1 << 52), 0), (0, -5, 0), (5, 0, 0)),),
        ),
        "R-5.5-1 R-7.3-4 5.5",
        "the box bounds X, without the origin",
        "adds the origin before it compares, or keeps it in float64 with the fraction",
    )


def at_limit(sign: int, degree: int = 0, excess: bool = False) -> Stream:
    """Every channel of core, or of all bands, comes to sign * (2^30 - 1), or 1 beyond."""
    m, q = ((16, 24), sign) if excess else ((16383, 0), sign * 16385)
    rows = {0: (16, 24), 1: (16, 24), 2: m}
    quantisers = {(row, c): me for row, me in rows.items() for c in CLASSES[: 5 + degree]}

    def step(component: int, q: int, k: int) -> Packet:
        channels = range(14 if component == 0 else 3 * (2 * component + 1))
        values = same([q], channels) if component > 0 or degree == 0 else {}
        if k == 0:
            return Packet(adds=values, n_adds=1, component=component)
        records = {0: REFINE} if component == 0 else {}
        level = int(k == 3 and component == 0)
        return Packet(psi=values, records=records, level=level, component=component)

    packets = [step(c, q if k == 3 else sign, k) for k in range(4) for c in range(degree + 1)]
    return Stream(packets, degree=degree, n_levels=2, quantisers=quantisers)


def second_child_at(excess: int, channel: int = X) -> Stream:
    """Second children at 2^30 - 2 + excess and its negative, by alpha = 1."""
    # C2 = 3 * 2^28 + Delta, Delta = 2^28 - 1 or 2^28.
    m_e, q = ((16383, 0), 16385) if excess == 1 else ((16, 24), 1)
    big, both = {channel: [1, -1]}, {0: REFINE, 1: REFINE}
    packets = [
        Packet(adds=big),
        Packet(records=both, psi=big),
        Packet(records=both, psi=big),
        Packet(records={0: SPLIT, 1: SPLIT}, psi={channel: [-q, q]}, level=1),
    ]
    kind = class_of(channel)
    quantisers = {(0, kind): (16, 24), (1, kind): (16, 24), (2, kind): m_e}
    return Stream(packets, n_levels=2, quantisers=quantisers)


RECIPES: tuple[Recipe, ...] = (
    ranges,
    steps,
    products,
    chains,
    boxes,
)
