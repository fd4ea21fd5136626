"""Numbers that leave their range, one fault each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import (
    ADDS_YCOCG,
    BLUE,
    DELTA,
    DROP,
    GREEN,
    OPACITY,
    RED,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    X,
    Y,
    Z,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.invalid_values import THREE
from conformance.generator.cases.numeric import ALL, CLASSES
from conformance.generator.cases.numeric_ranges import at_limit, second_child_at
from conformance.generator.cases.scenes import same

FAMILY = "invalid-values"


def deltas() -> Iterator[Case]:
    """R-7.3-1."""
    rows = [
        ("m17-e24", (17, 24), 1, "17 * 2^24 is the first above 2^28 for E = 24"),
        ("m65535-e24", (65535, 24), 1, "the largest step cannot be taken once"),
        ("m65535-e0", (65535, 0), -4097, "-4097 * 65535 is the first below -2^28"),
        ("wraps-to-0", (1, 24), 256, "q * M * 2^E is 2^32"),
        ("wraps-to-small", (1, 24), 257, "q * M * 2^E is 2^32 + 2^24"),
        ("wraps-s32", (65535, 0), 65537, "q * M is 2^32 - 1, which is -1 in 32 bits"),
        ("rounded-bound", (3, 5), 2796203, "the bound (2^28 >> 5) // 3 is rounded down"),
    ]
    for name, m_e, q, tests in rows:
        for where in ("adds", "psi"):
            if where == "psi" and name not in ("m17-e24", "wraps-to-0", "rounded-bound"):
                continue
            row = 0 if where == "adds" else 1
            packets = [THREE, Packet(records={0: REFINE}, psi={3: [q]})]
            yield case(
                f"delta-{name}-of-{where}",
                Stream([Packet(adds={3: [q]})] if where == "adds" else packets,
                       quantisers={(row, 1): m_e}),
                "R-7.3-1 R-7.3-5",
                f"{tests}, of {where}",
                "multiplies before it checks, in 32 bits, or saturates",
                "E_RANGE",
                "numeric-delta-m1-e24",
            )  # fmt: skip
    yield case(
        "delta-wraps-64-bits",
        Stream([Packet(adds={3: [8388607 * k for k in range(1, 33)] + [1 << 28]},
                       codings={"adds 3": 0x28 | DELTA})], quantisers={(0, 1): (32768, 24)}),
        "R-7.3-1 R-7.3-5",
        "q of 2^28 with M = 2^15 and E = 24: 2^67, which is 0 in 64 bits",
        "multiplies in 64 bits before it checks",
        "E_RANGE",
        "numeric-sums-to-the-limits",
    )  # fmt: skip
    yield case(
        "delta-of-a-band",
        Stream([THREE, Packet(component=1, adds={8: [0, 0, 17]})], degree=1,
               quantisers={(0, 5): (1, 24)}),
        "R-7.3-1 R-7.3-5",
        "the last coefficient of a band is the first above 2^28",
        "checks core only",
        "E_RANGE",
        "numeric-x-largest-of-bands",
    )  # fmt: skip
    big = [8388607 * k for k in range(1, 33)] + [1 << 28]
    yield case(
        "sum-above",
        Stream([Packet(adds={X: [*big, (1 << 28) + 1]}, codings={"adds 0": 0x28 | DELTA})]),
        "R-7.1-1 R-7.3-5",
        "a running sum of 2^28 + 1",
        "bounds Delta only, or differences only",
        "E_RANGE",
        "numeric-sums-to-the-limits",
    )
    yield case(
        "sum-below-and-back",
        Stream([Packet(adds={X: [-v for v in big] + [-(1 << 28) - 1, 0 - (1 << 28) + 8000000]},
                       codings={"adds 0": 0x28 | DELTA})]),
        "R-7.1-1 R-7.3-5",
        "a running sum of -2^28 - 1 on the way; the last is within range",
        "checks the last sum only",
        "E_RANGE",
        "numeric-sums-to-the-limits",
    )  # fmt: skip
    beyond, chroma = (1 << 28) + 1, {"adds 12": 0x28 | DELTA}
    for name, sums, tests in (
        ("above-but-halved", [*big, beyond], "of 2^28 + 1 at the end"),
        ("below-but-halved", [*(-v for v in big), -beyond], "of -2^28 - 1 at the end"),
        ("above-on-the-way-but-halved", [*big, beyond, beyond - 9], "of 2^28 + 1, then less"),
    ):
        yield case(
            f"sum-{name}",
            Stream([Packet(adds={GREEN: sums}, flags=ADDS_YCOCG, codings=chroma)]),
            "R-7.1-1 R-7.3-5",
            f"a running sum of Co {tests}; R and B are half as large, and in range",
            "bounds what comes out of YCoCg-R only, or the last sum",
            "E_RANGE",
            "numeric-ycocg-whose-parts-cancel",
        )
    yield case(
        "colour-above",
        Stream([Packet(adds={RED: big, GREEN: [2] * 33}, flags=ADDS_YCOCG,
                       codings={"adds 11": 0x28 | DELTA})]),
        "R-7.3-1 R-7.3-5 7.1",
        "Y of 2^28 and Co of 2 give R of 2^28 + 1",
        "bounds the stored integers only",
        "E_RANGE",
        "numeric-ycocg-of-the-largest-sums",
    )  # fmt: skip
    yield case(
        "colour-below",
        Stream(
            [
                Packet(
                    adds={RED: [-v for v in big], BLUE: [2] * 33},
                    flags=ADDS_YCOCG,
                    codings={"adds 11": 0x28 | DELTA},
                )
            ]
        ),
        "R-7.3-1 R-7.3-5 7.1",
        "Y of -2^28 and Cg of 2 give R and B of -2^28 - 1",
        "bounds the stored integers only",
        "E_RANGE",
        "numeric-ycocg-of-the-largest-sums",
    )


def products() -> Iterator[Case]:
    """R-7.3-2."""
    rows = [
        (
            "first-above",
            -32768,
            1,
            32768,
            "a * Delta is -2^30, and the half of K = 1 makes it more",
        ),
        ("first-above-of-k0", 32767, 0, 32770, "a * Delta is 2^30 + 32766"),
        ("half-of-k12", 4, 12, 268434945, "4 * Delta + 2048 is 2^30 + 4"),
        ("wraps", 32767, 0, 1 << 28, "a * Delta is -2^28 modulo 2^32"),
        ("wraps-to-0", 16384, 0, 1 << 18, "a * Delta is 2^32"),
        ("small-after-shift", 4096, 12, 1 << 19, "alpha is 1, and C2 would be small"),
        ("negative", -5, 1, -(1 << 28) + 1, "both negative: the product is positive"),
    ]
    for name, a, k, delta, tests in rows:
        m, q = (1, delta)
        e = 0
        while abs(q) >= 1 << 23:
            if q % 2:
                # Odd and large: as a product of two odd numbers, or the next that is one.
                m, q = next(
                    (d, q // d) for d in range(3, 65536, 2) if q % d == 0 and abs(q // d) < 1 << 23
                )
            else:
                q, e = q // 2, e + 1
        yield case(
            f"product-{name}",
            Stream([THREE, Packet(records={1: SPLIT}, psi={X: [q]})], alphas={(0, 0): (k, [a])},
                   quantisers={(1, 0): (m, e)}),
            "R-7.3-2 R-7.3-5",
            tests,
            "multiplies in 32 bits, or bounds C2 and not the product",
            "E_RANGE",
            "numeric-product-least-a",
        )  # fmt: skip


def ranges() -> Iterator[Case]:
    """R-7.3-3."""
    for sign, name in ((1, "above"), (-1, "below")):
        yield case(
            f"x-{name}",
            at_limit(sign, excess=True),
            "R-7.3-3 R-7.3-5",
            f"all channels of core come to {sign} * 2^30",
            "saturates, wraps at 2^31 only, or keeps float32",
            "E_RANGE",
            "numeric-x-largest" if sign > 0 else "numeric-x-least",
        )
        yield case(
            f"x-{name}-of-bands",
            at_limit(sign, degree=2, excess=True),
            "R-7.3-3 R-7.3-5",
            f"all channels of the bands come to {sign} * 2^30",
            "checks core only",
            "E_RANGE",
            "numeric-x-largest-of-bands" if sign > 0 else "numeric-x-least-of-bands",
        )
    yield case(
        "x-above-of-second-child",
        second_child_at(2, OPACITY),
        "R-7.3-3 R-7.3-5",
        "opacities of second children come to 2^30 and -2^30, the first stay small",
        "checks the splats that keep their slots only",
        "E_RANGE",
        "numeric-x-largest-of-second-child",
    )
    steps = {(row, c): (16, 24) for row in range(2) for c in CLASSES}
    up = Packet(records={0: REFINE}, psi=same([1], [OPACITY]))
    yield case(
        "x-above-for-a-step",
        Stream([Packet(adds=same([1], [OPACITY])), up, up, up,
                replace(up, psi=same([-1], [OPACITY]))], quantisers=steps),
        "R-7.3-3 R-7.3-5",
        "opacity is 2^30 after a step and would come back with the next",
        "checks the last state only",
        "E_RANGE",
        "numeric-x-largest",
    )  # fmt: skip
    yield case(
        "x-above-and-dropped",
        Stream([Packet(adds=same([1], ALL)), *[replace(up, psi=same([1]))] * 3,
                Packet(records={0: DROP})], quantisers=steps),
        "R-7.3-3 R-7.3-5",
        "a splat is at 2^30 for a step, then it is dropped",
        "checks the splats that are left only",
        "E_RANGE",
        "numeric-x-largest",
        runs=(FILE, PROGRESSIVE),
    )  # fmt: skip


def boxes() -> Iterator[Case]:
    """R-7.3-4."""
    tile = Tile(low=(-5, -6, -7), high=(5, 6, 7))
    for axis, name in ((X, "x"), (Y, "y"), (Z, "z")):
        limit = tile.high[axis] + 1
        for q, side in ((limit, "above"), (-limit, "below")):
            yield case(
                f"box-{name}-{side}",
                Stream([Packet(adds={axis: [0, q, 0]})], tiles=(tile,)),
                "R-7.3-4 R-7.3-5",
                f"an add just {side} the box in {name}",
                "checks another axis or side, or widens the box",
                "E_RANGE",
                "box-full",
            )
    inner = Packet(adds={X: [5, -5], Y: [6, -6], Z: [7, -7]})
    rows = [
        ("refined", Packet(records={1: REFINE}, psi={Y: [-1]}), "a refine leaves the box"),
        ("first-child", Packet(records={0: SPLIT}, psi={X: [1]}), "a first child leaves the box"),
        (
            "second-child",
            Packet(records={0: SPLIT}, psi={Z: [-1]}),
            "a second child leaves the box",
        ),
    ]
    for name, packet, tests in rows:
        yield case(
            f"box-{name}",
            Stream([inner, packet], tiles=(tile,)),
            "R-7.3-4 R-7.3-5",
            tests,
            "checks adds only",
            "E_RANGE",
            "box-full",
        )
    yield case(
        "box-for-a-step",
        Stream([inner, Packet(records={0: REFINE}, psi={X: [1]}),
                Packet(records={0: REFINE}, psi={X: [-1]})], tiles=(tile,)),
        "R-7.3-4 R-7.3-5",
        "a splat leaves the box for a step",
        "checks the last state only",
        "E_RANGE",
        "box-full",
    )  # fmt: skip
    yield case(
        "box-of-another-tile",
        Stream([inner, replace(inner, tile=1)], tiles=(tile, Tile(high=(4, 10, 10)))),
        "R-7.3-4 R-7.3-5",
        "splats fit the box of tile 0 and not that of tile 1",
        "uses one box for all tiles",
        "E_RANGE",
        "box-full",
    )
    yield case(
        "box-full",
        Stream([inner, Packet(records={0: REFINE, 1: REFINE}, psi={X: [-10, 10], Y: [-12, 12]})],
               tiles=(tile,)),
        "R-7.3-4",
        "splats in corners of the box, before and after a step to the corners across",
        "wants positions inside the box",
    )  # fmt: skip


RECIPES: tuple[Recipe, ...] = (
    deltas,
    products,
    ranges,
    boxes,
)
