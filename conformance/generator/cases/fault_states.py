"""The state beside a fault: a packet is applied whole or not at all (R-6.4-5).

In each scene a packet of tile 0 breaks one of the checks that come last. What does not require it
is decoded: packets before it, and those of tile 1 behind it. What requires it waits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from conformance.generator.builder import (
    BLUE,
    DROP,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    Z,
    build,
    raw,
)
from conformance.generator.cases.case import Case, Recipe, case
from conformance.generator.cases.faulty_scene import ALL, CRC, FAMILY, RULES, Fault, Scene, came
from conformance.generator.cases.palette import picks
from conformance.generator.cases.scenes import n_channels, numbers
from conformance.generator.cases.siblings import star

BOX = Tile(low=(-500,) * 3, high=(500,) * 3)
WIDE = (1, 24)  # a quantiser: q of 16 is the last within 2^28

ADD = Packet(adds={c: q for c, q in numbers(3).items() if c <= 10})  # without SH
GROW = Packet(
    records={0: SPLIT, 1: REFINE, 2: DROP},
    psi={c: q for c, q in numbers(2, seed=1).items() if c <= 10} | {BLUE: [3, -5]},
    adds={c: q for c, q in numbers(1, seed=2).items() if c <= 10} | {BLUE: [4]},
    level=1,
)
AGAIN = Packet(records={1: SPLIT, 3: REFINE}, psi=numbers(2, seed=3), level=2)
OF_TILE_1 = replace(ADD, tile=1)


def stray_bit(body: bytes) -> bytes:
    """The last plane, whose values have less than eight bits, has a bit above them."""
    return body[:-1] + bytes([body[-1] | 0x80])


def long_last_frame(content: bytes) -> bytes:
    """A frame; that of a single plane has a byte more than the plane."""
    return raw(content if len(content) > 2 else content + b"\0")


def psi(channel: int, q: Sequence[int]) -> dict[str, Any]:
    """Another psi of a channel of GROW."""
    return {"psi": {**GROW.psi, channel: q}}


CORE = Scene(
    "core",
    "a packet of core",
    2,
    1,
    Stream([ADD, OF_TILE_1, GROW, replace(GROW, tile=1), AGAIN], n_levels=3, tiles=(BOX, Tile())),
)
TWIN = f"{FAMILY}-core-without-a-fault"
STRAY = "a bit of the last plane belongs to no value"


def core() -> Iterator[Case]:
    """Packets of core."""
    of_blue = {"quantisers": {(2, 4): WIDE}}
    yield from CORE.twin()
    yield from CORE.refused([
        Fault("box-of-a-refine", "R-7.3-4", "E_RANGE", "a refine leaves the box in z",
              psi(Z, [5, 1000])),
        Fault("box-of-an-add", "R-7.3-4 3.4", "E_RANGE", "an add is outside of the box in z",
              {"adds": {**GROW.adds, Z: [1000]}}),
        Fault("delta-of-the-last-psi", "R-7.3-1", "E_RANGE", "the last psi of blue is too large",
              psi(BLUE, [0, 17]), of_blue),
        Fault("alpha-of-blue", "R-7.3-2", "E_RANGE", "alpha times psi of blue is too large",
              psi(BLUE, [1, 0]) | {"alpha": {4: [1]}},
              of_blue | {"alphas": {(1, 4): (0, [1, 32767])}}),
        Fault("alpha-index-of-sh", "R-7.2-3", "E_INDEX", "the alpha index of SH is past its table",
              {"alpha": {4: [2]}}, {"alphas": {(1, 4): (0, [1, 3])}}),
        Fault("kinds", "R-7.2-2", "E_KIND", "the last of the kinds is not as counted",
              {"stored": {"kinds": [1, 0, 0]}}),
        Fault("last-slot", "R-7.2-1", "E_SLOT", "the last slot is none",
              {"stored": {"gaps": [0, 0, 1]}}),
        Fault("last-frame", "R-5.10-3", "E_FRAME", "the last frame has a byte more than its plane",
              {"frames": (24, 1), "style": long_last_frame}),
        Fault("last-plane", "R-5.9-9", "E_PACKET", STRAY,
              {"codings": {"adds 13": 4}, "edit": stray_bit}),
        CRC,
    ])  # fmt: skip
    bright = replace(ADD, adds={**ADD.adds, BLUE: [16, 16, 16]})
    steps = [Packet(records={0: REFINE}, psi={Z: [3], BLUE: [16]}) for _ in range(3)]
    quantisers = {(0, 4): WIDE, (1, 4): WIDE}
    packets = [bright, OF_TILE_1, *steps, replace(steps[0], tile=1)]
    stream = Stream(packets, tiles=(BOX, Tile()), quantisers=quantisers)
    yield from Scene("core", "the fourth packet of core", 4, 1, stream).refused(
        [Fault("x-of-blue", "R-7.3-3", "E_RANGE", "blue of a refine is 2^30")]
    )


def band(component: int, n_adds: int, n_psi: int = 0, tile: int = 0) -> Packet:
    """A packet of an SH band with numbers of at most 16."""
    c = n_channels(component)
    return Packet(
        component=component,
        tile=tile,
        adds=numbers(n_adds, c, spread=16, seed=component) if n_adds else {},
        psi=numbers(n_psi, c, spread=16, seed=component + 5) if n_psi else {},
    )


BAND = Scene(
    "band",
    "a packet of SH band 1",
    4,
    2,
    Stream(
        [ADD, band(1, 3), OF_TILE_1, GROW, band(1, 1, 2), band(1, 3, tile=1), AGAIN, band(1, 0, 2)],
        degree=1,
        n_levels=3,
        tiles=(BOX, Tile()),
    ),
)


def bands() -> Iterator[Case]:
    """Packets of SH bands; core goes on, and its new slots show the SH of their ancestors."""
    at_fault, last, of_band = BAND.stream.packets[4], 8, {"quantisers": {(2, 5): WIDE}}
    yield from BAND.twin()
    yield from BAND.refused([
        Fault("delta-of-the-last-psi", "R-7.3-1", "E_RANGE", "the last psi is too large",
              {"psi": {**at_fault.psi, last: [0, 17]}}, of_band),
        Fault("alpha-of-the-last-channel", "R-7.3-2", "E_RANGE",
              "alpha times psi of the last channel is too large",
              {"psi": {0: [0, 9], last: [1, 0]}}, of_band | {"alphas": {(1, 4): (0, [32767])}}),
        Fault("last-plane", "R-5.9-9", "E_PACKET", STRAY,
              {"adds": {**at_fault.adds, last: [3]}, "codings": {"adds 8": 7}, "edit": stray_bit}),
        CRC,
    ])  # fmt: skip
    big = replace(band(3, 0), adds=dict.fromkeys(range(21), 16))
    late = [Packet(records={0: REFINE, 2: REFINE}, psi=numbers(2, seed=k)) for k in range(3)]
    more = [Packet(component=3, psi={0: [1, -1], 20: [0, 16]}) for _ in late]
    low, low_more = ([band(b, n, m) for b in (1, 2)] for n, m in ((3, 0), (0, 2)))
    packets = [ADD, *low, big, OF_TILE_1, *late, *more, *low_more, band(1, 3, tile=1)]
    stream = Stream(packets, degree=3, tiles=(BOX, Tile()), quantisers={(0, 7): WIDE, (1, 7): WIDE})
    yield from Scene("band", "the fourth packet of SH band 3", 10, 4, stream).refused(
        [Fault("x-of-band-3", "R-7.3-3", "E_RANGE", "the last number of a refine is 2^30")]
    )


def entries(n: int, level: int, seed: int = 0) -> Packet:
    """A packet of the palette, of degree 1, with numbers of at most 16."""
    return Packet(component=5, level=level, adds=numbers(n, 9, spread=16, seed=seed))


def with_palette(*packets: Packet) -> Stream:
    """A stream of two tiles with a palette of degree 1."""
    return Stream(packets, degree=1, has_palette=True, n_levels=3, tiles=(BOX, Tile()))


LOW, HIGH = entries(2, 0), entries(2, 1, seed=1)
PICKS = Scene(
    "picks",
    "a packet of picks",
    5,
    3,
    with_palette(
        *(ADD, LOW, picks(2, 1, 2), OF_TILE_1, GROW, picks(1, 2)),
        *(picks(1, 0, 2, tile=1), AGAIN, picks(2)),
    ),
)


def of_picks() -> Iterator[Case]:
    """Packets of picks; core goes on, and its new slots show the entries of their ancestors."""
    yield from PICKS.twin()
    yield from PICKS.refused([
        Fault("last", "R-7.2-4", "E_INDEX", "the last pick is above all entries",
              {"picks": [1, 3]}),
        Fault("last-of-changed", "R-7.2-4 5.9", "E_INDEX",
              "slots change their picks, and the last pick of new slots is above all entries",
              {"picks": [1, 3], "repicks": [1, 2]}),
        Fault("last-plane", "R-5.9-9", "E_PACKET", STRAY,
              {"repicks": [1, 2], "codings": {"picks": 7}, "edit": stray_bit}),
        CRC,
    ])  # fmt: skip
    levels = with_palette(
        *(ADD, LOW, HIGH, OF_TILE_1, picks(2, 4, 3)),
        *(picks(1, 0, 2, tile=1), GROW, picks(4, 3)),
    )
    above = "picks of label 0 are of entries of level 1, which are there"
    yield from Scene("picks", "a packet of picks", 4, 3, levels).refused(
        [Fault("of-a-higher-level", "R-7.2-4 12", "E_INDEX", above)]
    )


PALETTE = Scene(
    "palette",
    "entries of level 1",
    3,
    2,
    with_palette(
        *(ADD, LOW, picks(2, 1, 2), HIGH, GROW, picks(1, 2), OF_TILE_1, picks(1, 0, 2, tile=1)),
        *(entries(1, 2, seed=2), AGAIN, picks(5)),
    ),
)


def of_palette() -> Iterator[Case]:
    """Packets of the palette; picks that require the entries wait, and other picks do not."""
    last, top = 8, (1 << 23) - 1
    rising = [(k + 1) * top for k in range(32)] + [(1 << 28) + 1]
    yield from PALETTE.twin()
    yield from PALETTE.refused([
        Fault("delta-of-the-last-entry", "R-7.3-1", "E_RANGE",
              "the last number of the last entry is too large",
              {"adds": {**HIGH.adds, last: [16, 17]}}, {"quantisers": {(0, 5): WIDE}}),
        Fault("sums", "R-7.1-1", "E_RANGE", "the last sum of the last channel is 2^28 + 1",
              {"adds": {0: list(range(33)), last: rising}, "codings": {"adds 8": 0x68}}),
        Fault("last-plane", "R-5.9-9", "E_PACKET", STRAY,
              {"adds": {**HIGH.adds, last: [3, 2]}, "codings": {"adds 8": 7}, "edit": stray_bit}),
        CRC,
    ])  # fmt: skip


BIRTHS = [Packet(adds={Z: [1, 2]}), *(Packet(records={0: SPLIT}, psi={Z: [k]}) for k in (3, 4))]
LAYER = Packet(  # slots 2 and 3 were born from slot 0
    records=dict.fromkeys(range(4), REFINE),
    psi=numbers(4, spread=4),
    siblings=range(14),
    level=1,
)
NEXT_LAYER = Packet(
    records=dict.fromkeys(range(3), REFINE), psi=numbers(3, seed=1), siblings=range(14), level=2
)
SIBLINGS = Scene(
    "siblings",
    "a packet of sibling differences",
    4,
    1,
    Stream(
        [BIRTHS[0], OF_TILE_1, *BIRTHS[1:], LAYER, NEXT_LAYER],
        n_levels=3,
        tiles=(BOX, Tile()),
    ),
)


def of_siblings() -> Iterator[Case]:
    """Packets of sibling differences; the next refines the same slots, and waits."""
    yield from SIBLINGS.twin()
    yield from SIBLINGS.refused([
        Fault("box-of-a-parent", "R-7.3-4", "E_RANGE", "differences take a parent out of the box",
              {"psi": {**LAYER.psi, Z: [200, 0, 150, 160]}}),
        Fault("delta-of-the-last-child", "R-7.3-1", "E_RANGE",
              "the psi of blue of the last child is too large",
              {"psi": {**LAYER.psi, BLUE: [9, 0, 0, -8]}}, {"quantisers": {(2, 4): WIDE}}),
        Fault("delta-of-a-parent", "R-7.3-1", "E_RANGE",
              "the psi of blue of a parent is too large",
              {"psi": {**LAYER.psi, BLUE: [9, 0, 0, 8]}}, {"quantisers": {(2, 4): WIDE}}),
        Fault("drop", "R-5.9-3", "E_PACKET", "the last record is a drop",
              {"records": {**LAYER.records, 3: DROP}, "psi": numbers(3)}),
    ])  # fmt: skip
    *births, layer = star((1 << 28) + 1)
    packets = [births[0], OF_TILE_1, *births[1:], layer, replace(layer, psi={Z: [1] * 34})]
    scene = replace(SIBLINGS, at=len(packets) - 2, stream=replace(SIBLINGS.stream, packets=packets))
    yield from scene.refused(
        [Fault("sum", "R-7.1-2", "E_RANGE", "the sum of a parent is 2^28 + 1")]
    )


def several() -> Iterator[Case]:
    """Two packets with a fault."""
    grow = replace(GROW, **psi(Z, [5, 1000]))
    packets = [ADD, OF_TILE_1, grow, replace(grow, tile=1), AGAIN]
    data = build(replace(CORE.stream, packets=packets, tiles=(BOX, BOX)))
    yield case(
        "two-of-two-tiles",
        data,
        f"{RULES} R-6.4-4 R-7.3-4",
        "refines of both tiles leave their boxes: the first is reported, the state is without both",
        "keeps the packet whose fault is not the one that it reports",
        "E_RANGE",
        TWIN,
        runs=(ALL, came(data, range(4, -1, -1)), came(data, (3, 1, 0)), came(data, (1, 3))),
    )


def of_no_packet() -> Iterator[Case]:
    """Faults that are not of a packet."""
    stream = CORE.stream
    whole = build(stream)
    parts = came(whole, (3, 0))
    yield case(
        "trailing-byte",
        whole + b"?",
        f"{RULES} R-6.2-1",
        "a byte behind the last packet: the state is that of the packets",
        "takes the last packet for wrong, or has no state",
        "E_TRAILING",
        TWIN,
        runs=(ALL, replace(parts, arrival=((len(whole), 1), *(parts.arrival or ())))),
    )
    data = build(replace(stream, digests={(0, 0, 1): bytes(32), (1, 0, 0): None}))
    yield case(
        "digest",
        data,
        f"{RULES} R-5.7-3 R-5.7-4",
        "a digest of step 1 of tile 0 is wrong: the packet has no fault, and the state holds it",
        "takes back the packet whose digest differs, or does not go on behind it",
        "E_DIGEST",
        TWIN,
        runs=(replace(ALL, verify=True), replace(came(data, (4, 2, 0)), verify=True), ALL),
    )
    for name, rule, code, fields, tests in (
        ("header", "R-5.1-6", "E_HEADER", {"header": {"n_levels": 0}}, "a header of no levels"),
        ("chunks", "R-5.8-2", "E_META", {"metadata": {"A": ""}}, "a key with a capital letter"),
    ):
        yield case(
            f"no-state-{name}",
            replace(stream, **fields),
            f"{RULES} {rule}",
            f"{tests}: there is no state, and so no dump",
            "gives an empty dump, or goes on",
            code,
            TWIN,
            runs=(ALL,),
        )
    yield case(
        "no-state-limits",
        stream,
        f"{RULES} R-8.3-1",
        "more slots than the decoder's own limit, and as many",
        "gives a dump of what is within its limit",
        "E_LIMIT",
        TWIN,
        runs=(replace(ALL, limits={"slots": 10}), replace(ALL, limits={"slots": 11})),
    )


RECIPES: tuple[Recipe, ...] = (
    *(core, bands, of_picks, of_palette),
    *(of_siblings, several, of_no_packet),
)
