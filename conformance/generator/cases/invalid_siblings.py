"""Sibling differences where there may be none, and sums of them that leave their range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import BLUE, DELTA, DROP, REFINE, SPLIT, Packet, Stream, X
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.fault_states import stray_bit
from conformance.generator.cases.scenes import numbers
from conformance.generator.cases.siblings import (
    BIRTHS,
    LIMIT,
    SECOND,
    band_of,
    chain,
    layer,
    star,
)

FAMILY = "invalid-siblings"
TWIN = "siblings-every-channel"
BAND_TWIN = "siblings-band-alone"


def where_none_may_be() -> Iterator[Case]:
    """R-5.9-2, R-5.9-3: coding bytes with `delta`."""
    some = {4: REFINE, 7: REFINE, 9: REFINE}
    steps = [
        ("a-split", some | {12: SPLIT}, 4, "and a split"),
        ("a-drop", some | {12: DROP}, 3, "and a drop"),
        ("splits-alone", dict.fromkeys((4, 7, 9), SPLIT), 3, "of splits alone"),
    ]
    for name, records, n_psi, tests in steps:
        core = Packet(records=records, psi=numbers(n_psi, seed=6))
        yield case(
            f"core-with-{name}",
            Stream([*BIRTHS, replace(core, siblings=range(14))]),
            "R-5.9-3",
            f"psi of a step of three {'splits' if name == 'splits-alone' else 'refines'} {tests}"
            " have `delta`",
            "looks at the other count only, or adds siblings of any step",
            "E_PACKET",
            TWIN,
            runs=(FILE, PROGRESSIVE),
        )
    low = [band_of(core, 1, seed=k) for k, core in enumerate(BIRTHS)]
    for name, records, n_psi, tests in steps[:2]:
        core = Packet(records=records, psi=numbers(n_psi, seed=6))
        band = band_of(core, 1, (8,), seed=9)
        yield case(
            f"band-with-{name}",
            Stream([*BIRTHS, core, *low, band], degree=1),
            "R-5.9-3",
            f"the last psi of an SH band have `delta`, of a step of three refines {tests}",
            "looks at the counts in the row of the band, which are 0",
            "E_PACKET",
            BAND_TWIN,
            runs=(FILE, PROGRESSIVE),
        )
    yield case(
        "gaps",
        Stream([*BIRTHS, replace(layer((1, 3, 5)), codings={"gaps": 8 | DELTA})]),
        "R-5.9-3",
        "`delta` in the coding byte of gaps of a step of refines",
        "allows it in all lists of such a step",
        "E_PACKET",
        TWIN,
    )
    for name, stream in (
        ("core", Stream([*BIRTHS, replace(SECOND, psi={}, coding_bytes={"psi 3": DELTA})])),
        ("band", Stream([*BIRTHS, SECOND, *low, replace(band_of(SECOND, 1), psi={},
                         is_explicit=True, coding_bytes={"psi 0": DELTA})], degree=1)),
    ):  # fmt: skip
        yield case(
            f"{name}-of-delta-alone",
            stream,
            "R-5.9-2",
            f"psi of {'an SH band' if name == 'band' else 'core'} have `delta` and no planes",
            "takes it for a list of zeros",
            "E_PACKET",
            "siblings-zeros",
        )
    yield case(
        "core-without-psi",
        Stream([*BIRTHS, Packet(adds=numbers(2), coding_bytes={"psi 0": 4 | DELTA},
                                entries=lambda e: [(e[0][0] + 1, e[0][1])])]),
        "R-5.9-4",
        "psi have `delta` in a step of adds alone, which has no psi",
        "expects planes of 0 bytes, which there are, or does not look",
        "E_PACKET",
        TWIN,
    )  # fmt: skip


def sums() -> Iterator[Case]:
    """R-7.1-2."""
    rows = [
        ("child-above", chain(LIMIT + 1), "the psi of the last slot of a chain is 2^28 + 1",
         "bounds the psi of parents only, or saturates", "largest-of-a-child"),
        ("child-below", chain(-LIMIT - 1), "the psi of the last slot of a chain is -2^28 - 1",
         "bounds numbers above 0 only, or saturates", "least-of-a-child"),
        ("parent-above", star(LIMIT + 1), "the psi of a slot with 33 children comes to 2^28 + 1",
         "bounds the psi of children only, or saturates", "largest-of-a-parent"),
        ("parent-below", star(-LIMIT - 1), "the psi of a slot with 33 children comes to -2^28 - 1",
         "bounds numbers above 0 only, or saturates", "least-of-a-parent"),
        ("parent-above-and-back", star(LIMIT + 9, -900),
         "the psi of a slot comes to 2^28 + 9 and goes back, which leaves its last child above",
         "bounds the psi of parents in the end only, or saturates", "largest-of-a-parent"),
    ]  # fmt: skip
    for name, packets, tests, faulty, twin in rows:
        yield case(
            name,
            Stream(packets),
            "R-7.1-2 R-7.3-5",
            tests,
            faulty,
            "E_RANGE",
            f"siblings-{twin}",
        )

    core, *births, last = star(LIMIT + 1)
    refines = replace(last, psi={}, codings={})
    band = Packet(component=1, psi={8: last.psi[X]}, siblings={8})
    late = [Packet(component=1)] * (1 + len(births))
    yield case(
        "parent-above-of-a-band",
        Stream([core, *births, refines, *late, band], degree=1),
        "R-7.1-2 R-7.3-5",
        "the last psi of an SH band comes to 2^28 + 1 for a slot with 33 children",
        "bounds psi of core only",
        "E_RANGE",
        "siblings-band",
        runs=(FILE, PROGRESSIVE),
    )


def orders() -> Iterator[Case]:
    """A sum that leaves its range, and a fault that comes before it (R-6.1-1)."""
    *births, last = star(LIMIT + 1, 7)
    n = len(last.records)
    rows = [
        ("slot", [*births, replace(last, stored={"gaps": [*[0] * (n - 1), 5]})], "E_SLOT",
         "the slot of the last record is none, and the psi of the first comes to 2^28 + 1",
         "adds siblings before it checks slots, or looks for the birth of a slot that is none"),
        ("plane", [*births, replace(last, codings={**last.codings, "psi 13": 7}, edit=stray_bit,
                                    psi={**last.psi, BLUE: [1] * n})], "E_PACKET",
         "a bit of the last plane belongs to no value, and psi come to 2^28 + 1",
         "adds siblings of a list before it has checked the planes of the next"),
    ]  # fmt: skip
    for name, packets, code, tests, faulty in rows:
        yield case(
            f"{name}-and-sum",
            Stream(packets),
            "R-6.1-1",
            tests,
            faulty,
            code,
            "siblings-largest-of-a-parent",
        )


RECIPES: tuple[Recipe, ...] = (where_none_may_be, sums, orders)
