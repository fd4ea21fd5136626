"""Sibling differences (spec 7.1): psi of slots that were born from others of their step."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import (
    DELTA,
    DROP,
    GREEN,
    OPACITY,
    PSI_YCOCG,
    RED,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    X,
    Y,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, VERIFY, Case, Recipe, case
from conformance.generator.cases.scenes import n_channels, numbers

FAMILY = "siblings"
RULES = "R-5.9-3 R-7.1-2 7.1"
LIMIT = 1 << 28
N_LINKS = 33  # so many differences of 24 bits reach the limit

# Slots 0..6, 8, 10 and 11 are added; 7 and 12 are born from 4, and 9 from 7.
BIRTHS = (
    Packet(adds=numbers(7)),
    Packet(records={4: SPLIT}, psi=numbers(1, seed=1), adds=numbers(1, seed=2)),
    Packet(records={7: SPLIT}, psi=numbers(1, seed=3), adds=numbers(2, seed=4)),
    Packet(records={4: SPLIT}, psi=numbers(1, seed=5)),
)
CORE = range(14)


def layer(slots: Iterable[int], siblings: Iterable[int] = CORE, seed: int = 6) -> Packet:
    """A step that refines these slots; psi of some channels are sibling differences."""
    records = dict.fromkeys(slots, REFINE)
    psi = numbers(len(records), seed=seed)
    return Packet(records=records, psi=psi, siblings=frozenset(siblings))


def band_of(core: Packet, component: int, siblings: Iterable[int] = (), seed: int = 0) -> Packet:
    """The packet of an SH band of a step of core."""
    n, counts = n_channels(component), core.counts
    n_psi, n_adds = counts["n_splits"] + counts["n_refines"], counts["n_adds"]
    return Packet(
        component=component,
        psi=numbers(n_psi, n, seed=seed + 1) if n_psi else {},
        adds=numbers(n_adds, n, seed=seed + 2) if n_adds else {},
        siblings=frozenset(siblings),
    )


SECOND = layer((4, 7, 9, 12))


def births() -> Iterator[Case]:
    """Which records are siblings of which."""
    # In X the numbers of the example of 7.1.
    example = replace(SECOND, psi={**SECOND.psi, X: [10, 3, 1, 2]}, siblings=frozenset({X}))
    star = [Packet(adds=numbers(2)), *[Packet(records={0: SPLIT})] * 4]
    chain = [Packet(adds=numbers(1)), *(Packet(records={k: SPLIT}) for k in range(5))]
    at_once = [
        Packet(adds=numbers(5)),
        Packet(records={3: SPLIT, 1: SPLIT, 4: SPLIT}, psi=numbers(3, seed=8)),
        Packet(records={6: SPLIT, 3: SPLIT}, psi=numbers(2, seed=9)),
    ]
    rows = [
        ("example", [*BIRTHS, example],
         "the example of the text in x: slots 4, 7, 9 and 12; other channels without delta",
         "takes the list for psi, or sums it up"),
        ("every-channel", [*BIRTHS, layer((0, 4, 6, 7, 8, 9, 11, 12))],
         "all channels of core are sibling differences, splats that were added between them",
         "knows siblings of some channels, or takes adds for children"),
        ("chain", [*chain, layer(range(6))],
         "each slot was born from the one before, and all are named",
         "takes the psi that the parent ends with, or began with, for that of the record"),
        ("several-children", [*star, layer(range(6))],
         "four slots were born from slot 0, one after the other",
         "knows one child of a slot, or lets each begin with the first psi of the parent"),
        ("births-of-one-step", [*at_once, layer(range(10))],
         "several slots split in one step, and their children in the next",
         "takes neighbours for siblings"),
        ("without-the-parent", [*BIRTHS, layer((7, 9, 12))],
         "slots 7 and 12 hold their own psi, since slot 4 is not named",
         "takes the psi of a slot that is not named for 0, or slots of one parent for siblings"),
        ("without-the-one-between", [*BIRTHS, layer((4, 9, 12))],
         "slot 9 holds its own psi: slot 7, its parent, is not named, but slot 4 is",
         "looks for any ancestor among the records"),
        ("parent-dropped", [*BIRTHS, Packet(records={7: DROP}), layer((4, 9, 12))],
         "slot 9 holds its own psi: slot 7, its parent, was dropped",
         "takes children of a dropped slot for those of its parent"),
        ("no-siblings", [*BIRTHS, layer((0, 1, 4, 10))],
         "`delta`, and no named slot was born from another: all hold their own psi",
         "takes neighbours for siblings, or sums the list up"),
        ("with-adds", [*BIRTHS, replace(SECOND, adds=numbers(3, seed=7),
                                        codings={"adds 0": 0x48, "adds 12": 0x48})],
         "a step of refines and adds, both with `delta`",
         "wants a step without adds, or undoes both alike"),
        ("zeros", [*BIRTHS, replace(SECOND, psi=dict.fromkeys(CORE, 0),
                                    codings={f"psi {c}": 8 for c in CORE})],
         "lists of zeros that are stored", "refuses them"),
        ("one-record", [*BIRTHS, layer((9,))], "a step of one record", "looks for a sibling"),
    ]  # fmt: skip
    for name, packets, tests, faulty in rows:
        yield case(name, Stream(packets), RULES, tests, faulty, runs=(FILE, PROGRESSIVE))


def steps() -> Iterator[Case]:
    """Several steps with sibling differences."""
    layers = [
        *BIRTHS,
        replace(SECOND, level=1),
        replace(layer((0, 4, 7, 12), (X, OPACITY, RED), seed=7), level=2),
        replace(layer((4, 9, 12), (Y, GREEN), seed=8), level=3),
    ]
    yield case(
        "layers",
        Stream(layers, n_levels=4, quantisers={(2, 0): (7, 2), (3, 0): (3, 1), (4, 0): (1, 1)},
               digests={(0, 0, 4): None, (0, 0, 6): None}),
        f"{RULES} R-5.7-3",
        "three steps of refines of other slots and channels, each by its own quantisers",
        "keeps records of a step for the next",
        runs=(VERIFY, *(Run(level=level) for level in range(3))),
    )  # fmt: skip
    between = [
        *BIRTHS,
        replace(SECOND, level=1),
        Packet(records={7: DROP, 4: REFINE}, psi=numbers(1, seed=9), level=1),
        replace(layer((4, 9, 12), seed=7), level=2),
        Packet(records={9: SPLIT, 12: SPLIT}, psi=numbers(2, seed=2), level=2),
        replace(layer((4, 9, 12, 13, 14), seed=8), level=2),
    ]
    yield case(
        "drops-and-splits-between",
        Stream(between, n_levels=3),
        RULES,
        "between two such steps a slot is dropped, and between the next two others are split",
        "takes `delta` of a step for that of all, or keeps what it knew of births",
    )


def colours() -> Iterator[Case]:
    """SH triples: YCoCg-R is undone first, and the coding byte is that of the channel."""
    turned = replace(SECOND, flags=PSI_YCOCG)
    yield case(
        "ycocg",
        Stream([*BIRTHS, turned]),
        RULES,
        "all of a triple in YCoCg-R are sibling differences",
        "adds siblings before it undoes YCoCg-R, whose halves are rounded otherwise then",
    )
    yield case(
        "ycocg-red-alone",
        Stream([*BIRTHS, replace(turned, siblings=frozenset({RED}))]),
        RULES,
        "of a triple in YCoCg-R only the list of red, which holds Y, has `delta`",
        "adds siblings before YCoCg-R, or to all of a triple or none",
    )
    dark = {c: q for c, q in SECOND.psi.items() if c != RED}
    yield case(
        "ycocg-without-y",
        Stream([*BIRTHS, replace(turned, psi=dark)]),
        RULES,
        "Y has the coding byte 0, and Co and Cg have `delta`: R holds psi, G and B differences",
        "takes the coding byte of Y for that of the triple",
    )
    yield case(
        "ycocg-zeros-of-y",
        Stream([*BIRTHS, replace(turned, psi={**dark, RED: 0}, codings={f"psi {RED}": 8})]),
        RULES,
        "Y is a list of zeros that is stored, with `delta`: R holds differences",
        "forgets `delta` of a list of zeros",
    )
    yield case(
        "green-alone",
        Stream([*BIRTHS, replace(SECOND, siblings=frozenset({GREEN}))]),
        RULES,
        "of a triple that is not in YCoCg-R only green has `delta`",
        "takes the coding byte of one channel for that of the triple",
    )


def bands() -> Iterator[Case]:
    """SH bands."""
    cores = [*BIRTHS, SECOND]
    low = [band_of(core, 1, seed=k) for k, core in enumerate(BIRTHS)]
    of_layer = band_of(SECOND, 1, range(9), seed=9)
    yield case(
        "band",
        Stream([p for pair in zip(cores, [*low, of_layer], strict=True) for p in pair], degree=1),
        RULES,
        "an SH band has `delta`, and core has it, too",
        "knows siblings in core only",
    )
    plain = replace(SECOND, siblings=())
    yield case(
        "band-alone",
        Stream([*BIRTHS, plain, *low, replace(of_layer, siblings=frozenset({1, 5, 6}))], degree=1),
        RULES,
        "some channels of an SH band have `delta`, and none of core",
        "takes the coding bytes of core for those of the band",
    )
    later = [
        Packet(records={4: DROP, 12: SPLIT}, psi=numbers(1, seed=3)),
        Packet(records={7: DROP, 13: SPLIT}, psi=numbers(1, seed=4)),
        layer((9, 12, 13, 14)),
    ]
    late = [band_of(core, 1, seed=k) for k, core in enumerate(later[:2])]
    yield case(
        "band-late",
        Stream([*cores, *later, *low, of_layer, *late, band_of(later[2], 1, (0, 4, 8))], degree=1),
        f"{RULES} R-7.5-1",
        "the band comes when core has gone on: slots that were siblings then are empty by now",
        "takes the records of the last step, or slots that are not empty by now",
        runs=(FILE, PROGRESSIVE),
    )
    high = [band_of(core, 3, seed=k) for k, core in enumerate(BIRTHS)]
    turned = replace(band_of(SECOND, 3, (0, 4, 8, 18, 19, 20), seed=9), flags=PSI_YCOCG)
    yield case(
        "band-in-ycocg",
        Stream([*cores, *high, turned], degree=3),
        RULES,
        "the last triple of band 3 in YCoCg-R has `delta`, of others one channel each",
        "takes the coding byte of one channel for that of a triple",
    )


def limits() -> Iterator[Case]:
    """Numbers at 2^28 (R-7.1-2), made of differences of 24 bits."""
    for side, sign in (("largest", 1), ("least", -1)):
        yield case(
            f"{side}-of-a-child",
            Stream(chain(sign * LIMIT)),
            f"{RULES} R-7.3-1",
            f"in a chain of births the psi of the last slot is {sign} * 2^28",
            "keeps psi in 24 bits, or takes the bound for the first that is too large",
        )
        yield case(
            f"{side}-of-a-parent",
            Stream(star(sign * LIMIT)),
            f"{RULES} R-7.3-1",
            f"the psi of a slot with {N_LINKS} children comes to {sign} * 2^28",
            "keeps psi in 24 bits, or bounds what the list holds",
        )


def parts(total: int, n: int = N_LINKS) -> list[int]:
    """So many numbers of at most 24 bits that sum to `total`, all of its sign."""
    sign, (share, rest) = (1 if total > 0 else -1), divmod(abs(total), n)
    return [sign * (share + (k < rest)) for k in range(n)]


def chain(last: int) -> list[Packet]:
    """Each slot is born from the one before; the psi of the last in x is `last`."""
    splits = [Packet(records={k: SPLIT}) for k in range(N_LINKS)]
    differences = [0, *(-part for part in parts(last))]
    return [Packet(n_adds=1), *splits, refined(differences)]


def star(total: int, *more: int) -> list[Packet]:
    """All slots are born from the first, whose psi in x comes to `total`, and then goes on."""
    differences = [0, *parts(total), *more]
    splits = [Packet(records={0: SPLIT})] * (len(differences) - 1)
    return [Packet(n_adds=1), *splits, refined(differences)]


def refined(differences: list[int]) -> Packet:
    """A step that refines all slots from 0 on, in x."""
    records = dict.fromkeys(range(len(differences)), REFINE)
    return Packet(records=records, psi={X: differences}, codings={"psi 0": 0x28 | DELTA})


RECIPES: tuple[Recipe, ...] = (births, steps, colours, bands, limits)
