"""Legal, and unlike what an encoder writes: codings, lists, tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import DELTA, DROP, REFINE, SPLIT, Packet, Stream, Tile, X, Y
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "odd"


def widths() -> Iterator[Case]:
    """Every coding, with values that use all its bits."""
    for low in (0, 1, 2, 3, 4, 5, 7, 8):
        stored, codings = dict[str, list[int]](), dict[str, int]()
        for high in range(3):
            if low + high == 0:
                continue
            most = (1 << (low + 8 * high)) - 1
            values = [most, 0, most // 3, 1, most - most // 5, most // 2, most // 7]
            stored[f"adds {3 + high}"] = values
            codings[f"adds {3 + high}"] = low | high << 4
        yield case(
            f"coding-low-{low}",
            Stream([Packet(n_adds=7, stored=stored, codings=codings)]),
            "R-5.9-2 R-5.9-9 5.9 7.1",
            f"`low` {low} with every `high`, seven values that use all bits",
            "packs three bits, joins planes in the wrong order, or lacks a width",
        )
    for n in (1, 2, 3, 8, 17):
        bits = [(k * 5 + k // 3) % 16 for k in range(n)]
        stored = {"adds 0": [v & 1 for v in bits], "adds 1": [v & 3 for v in bits], "adds 2": bits}
        yield case(
            f"packed-{n}",
            Stream(
                [Packet(n_adds=n, stored=stored, codings={"adds 0": 1, "adds 1": 2, "adds 2": 4})]
            ),
            "R-5.9-9 5.9 7.1",
            f"{n} values of 1, 2 and 4 bits",
            "takes bits from the top, or rounds the size of a packed plane down",
        )


def side_lists() -> Iterator[Case]:
    """Gaps, kinds and alpha indices in unusual codings."""
    seeds = Packet(adds=numbers(6))
    mixed = Packet(
        records={1: SPLIT, 3: REFINE, 4: DROP, 5: SPLIT},
        psi=numbers(3),
        alpha={0: [1, 0], 3: [2, 1]},
    )
    tables = {(0, 0): (1, [3, -1]), (0, 3): (2, [1, 5, -9])}
    for name, codings, tests in (
        ("gaps-wide", {"gaps": 0x28}, "gaps in 24 bits"),
        ("gaps-without-low", {"gaps": 0x10}, "gaps in a plane without low bits"),
        ("kinds-wide", {"kinds": 0x28}, "kinds in 24 bits"),
        ("kinds-low-3", {"kinds": 0x03}, "kinds in 3 bits, a byte each"),
        ("kinds-without-low", {"kinds": 0x20}, "kinds in two planes without low bits"),
        ("indices-wide", {"alpha 0": 0x28, "alpha 3": 0x21}, "alpha indices in 24 and 17 bits"),
        ("indices-packed", {"alpha 0": 0x01, "alpha 3": 0x02}, "alpha indices packed"),
        ("indices-stored-zeros", {"alpha 1": 0x04, "alpha 2": 0x10}, "indices 0, stored"),
    ):
        stored = {"alpha 1": [0, 0], "alpha 2": [0, 0]} if "zeros" in name else {}
        yield case(
            f"{name}",
            Stream([seeds, replace(mixed, codings=codings, stored=stored)], alphas=tables),
            "R-5.9-2 R-7.2-1 R-7.2-2 R-7.2-3 7.2",
            tests,
            "expects the widths of its own encoder, or applies zigzag to these lists",
        )
    yield case(
        "gaps-of-zero-not-stored",
        Stream(
            [seeds, Packet(records=dict.fromkeys(range(6), SPLIT), psi=numbers(6))], alphas=tables
        ),
        "R-5.9-2 R-7.2-1 5.9",
        "the coding byte of gaps is 0: all records stand side by side",
        "takes it for no records",
    )
    yield case(
        "gap-of-300",
        Stream(
            [
                Packet(adds={X: list(range(320))}),
                Packet(records={300: REFINE, 319: DROP}, psi={Y: [4]}),
            ]
        ),
        "R-7.2-1 7.2",
        "a gap of 300 slots, then one of 18",
        "keeps gaps in 8 bits, or counts from 0 each time",
    )


def zeros() -> Iterator[Case]:
    """Numbers that are 0, written out."""
    zero = {c: [0, 0, 0] for c in range(14)}
    yield case(
        "planes-of-zeros",
        Stream([Packet(adds=zero, n_adds=3, codings={f"adds {c}": 0x28 for c in range(14)})]),
        "R-5.9-2 R-5.9-7 5.9",
        "42 planes of zeros that need not be stored",
        "expects that a list of zeros has the coding byte 0",
    )
    yield case(
        "delta-of-zeros",
        Stream([Packet(adds=zero, codings={f"adds {c}": 0x41 for c in range(14)})]),
        "R-5.9-3 R-7.1-1 7.1",
        "differences of 0, stored",
        "takes a difference of 0 for the end",
    )
    yield case(
        "split-by-zero",
        Stream([Packet(adds=numbers(2)), Packet(records={0: SPLIT, 1: SPLIT})]),
        "R-7.2-1 7.4",
        "splits whose psi are all 0: two pairs of equal splats",
        "merges equal splats, or skips a packet without psi",
    )
    yield case(
        "refine-by-zero",
        Stream([Packet(adds=numbers(2)), Packet(records={1: REFINE})]),
        "R-7.2-1 7.4",
        "a refine that changes nothing",
        "takes a record without psi for a drop",
    )


def sizes() -> Iterator[Case]:
    """As many as a field holds, or one."""
    yield case(
        "sh-degree-3-of-zeros",
        Stream([Packet(adds={X: [1]}), *[Packet(component=b) for b in (1, 2, 3)]], degree=3),
        "R-5.6-5 R-5.9-4 3.2",
        "three bands of size 0",
        "expects coefficients in a file of SH degree 3",
    )
    yield case(
        "alpha-tables-of-all-levels-unused",
        Stream(
            [Packet(n_adds=1)],
            n_levels=4,
            alphas={(level, g): (g, [level - g]) for level in range(4) for g in range(5)},
        ),
        "R-5.4-1 R-5.4-2 5.4",
        "twenty tables of alpha and no split",
        "wants an index for each table",
    )
    yield case(
        "metadata-of-many-keys",
        Stream([Packet(n_adds=1)], metadata={f"k{n:03d}": "v" * (n % 7) for n in range(200)}),
        "R-5.8-1 R-5.8-3 5.8",
        "200 keys",
        "has room for fewer",
    )
    yield case(
        "value-of-65535-bytes",
        Stream([Packet(n_adds=1)], metadata={"comment": "\u00e9" * 32767 + "!"}),
        "R-5.8-1 R-5.8-4 5.8",
        "a value of 65535 bytes",
        "keeps sizes in 15 bits",
    )
    yield case(
        "grid-extremes",
        Stream(
            [Packet(adds=numbers(2))],
            grid=(40, -16, 40, -16, 40),
            tiles=(Tile((1 << 52, -(1 << 52), 1)),),
        ),
        "R-5.1-7 R-5.5-1 7.7",
        "the finest and the coarsest grids, the farthest origins",
        "scales while it decodes",
    )
    yield case(
        "delta-bit-with-every-low",
        Stream(
            [
                Packet(
                    adds={c: [k * (c + 1) for k in range(4)] for c in range(9)},
                    codings={f"adds {c}": DELTA | (c if c else 0x10) for c in range(9)}
                    | {"adds 1": DELTA | 0x11, "adds 2": DELTA | 0x12, "adds 3": DELTA | 0x13},
                )
            ]
        ),
        "R-5.9-2 R-5.9-3 7.1",
        "differences in all widths",
        "knows `delta` with 8 low bits only",
    )
    yield case(
        "drop-only-packet",
        Stream([Packet(adds=numbers(3)), Packet(records={1: DROP})]),
        "R-5.9-4 R-7.2-1 5.9",
        "a packet with one gap and nothing else",
        "expects psi in every packet with records",
        runs=(FILE, PROGRESSIVE),
    )


RECIPES: tuple[Recipe, ...] = (widths, side_lists, zeros, sizes)
