"""Faults of packet headers, planes and values, one each; all checksums are right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream, X, Y, runs
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import numbers

FAMILY = "invalid-packets"
ADD = Packet(adds={X: [5, -3, 9], Y: [1, 0, 1]}, frames=(1, 1))
MIXED = Packet(
    records={0: SPLIT, 1: REFINE, 2: DROP},
    psi={X: [7, -7], Y: [2, 1]},
    alpha={0: [1]},
    adds={X: [300]},
)
BAND = Packet(component=1, adds=numbers(3, 9))
BASE = Stream([ADD, BAND, MIXED], degree=1, alphas={(0, 0): (1, [1, 3])})
TWIN = "base"


def with_add(**changes: object) -> Stream:
    """BASE with another first packet."""
    return replace(BASE, packets=[replace(ADD, **changes), BAND, MIXED])  # type: ignore[arg-type]


def with_mixed(**changes: object) -> Stream:
    """BASE with another last packet."""
    return replace(BASE, packets=[ADD, BAND, replace(MIXED, **changes)])  # type: ignore[arg-type]


def with_band(**changes: object) -> Stream:
    """BASE with another packet of the band."""
    return replace(BASE, packets=[ADD, replace(BAND, **changes), MIXED])  # type: ignore[arg-type]


def legal() -> Iterator[Case]:
    """What the faults are made from."""
    yield case(
        "base",
        BASE,
        "R-5.9-1 R-5.9-2 R-5.9-7 R-5.9-8 R-7.2-1 R-7.2-2 R-7.2-3",
        "packets with one frame, two frames, all lists in use",
        "expects a frame for each packet",
        runs=(FILE, PROGRESSIVE),
    )


def headers() -> Iterator[Case]:
    """Packet headers that are cut, and reserved bits."""
    rows = [
        ("codings-cut", with_add(edit=lambda body: body[:36]), "R-5.9-1", "E_PACKET",
         "a core packet of 36 bytes lacks its last coding byte", "takes it for 0"),
        ("codings-of-band-cut", with_band(edit=lambda body: body[:19]), "R-5.9-1", "E_PACKET",
         "a packet of band 1 of 19 bytes lacks its last coding byte", "takes it for 0"),
        ("entries-cut", with_add(edit=lambda body: body[:46]), "R-5.9-1", "E_PACKET",
         "the second frame entry lacks its last byte", "takes it for 0"),
        ("flag-2", with_add(flags=4), "R-4.4-1", "E_RESERVED", "the lowest reserved flag is set",
         "ignores reserved flags"),
        ("flag-7", with_band(flags=128), "R-4.4-1", "E_RESERVED",
         "the highest reserved flag is set, in the packet of a band", "checks core only"),
        ("coding-bit-7", with_add(coding_bytes={"adds 0": 0x84}), "R-4.4-1", "E_RESERVED",
         "the reserved bit of a coding byte is set", "masks it away"),
        ("coding-bit-7-of-band", with_band(coding_bytes={"psi 8": 0x80}), "R-4.4-1", "E_RESERVED",
         "the reserved bit of the coding byte of a list without integers",
         "looks only at coding bytes that it uses"),
    ]  # fmt: skip
    for name, stream, rule, code, tests, faulty in rows:
        yield case(name, stream, rule, tests, faulty, code, TWIN)


def codings() -> Iterator[Case]:
    """Coding bytes that are none."""
    for name, byte, tests in (
        ("low-9", 0x09, "`low` is 9"),
        ("low-15", 0x1F, "`low` is 15"),
        ("high-3", 0x30, "`high` is 3"),
        ("low-0-high-3-delta", 0x70, "`high` is 3, and the list is `delta`"),
    ):
        yield case(
            f"coding-{name}",
            with_add(adds={X: [5, -3, 9]}, frames=None, codings={"adds 0": byte}),
            "R-5.9-2",
            f"{tests}, in a coding byte of adds; planes, frames and bytes are as many as it says",
            "derives a number of planes from it",
            "E_PACKET",
            TWIN,
        )
    yield case(
        "coding-delta-alone",
        with_add(adds={}, n_adds=3, frames=None, coding_bytes={"adds 0": 0x40}),
        "R-5.9-2",
        "`delta` without planes, of which there are none",
        "takes it for a list of zeros",
        "E_PACKET",
        TWIN,
    )
    for name in ("gaps", "psi 0"):
        stored = {"gaps": [0, 0, 1]} if name == "gaps" else {}
        records = {0: SPLIT, 1: REFINE, 3: DROP} if name == "gaps" else MIXED.records
        adds = Packet(adds=numbers(4), frames=None)
        stream = replace(
            BASE,
            packets=[adds, replace(MIXED, records=records, stored=stored, codings={name: 0x44})],
        )
        yield case(
            f"delta-in-{name.replace(' ', '-')}",
            stream,
            "R-5.9-3",
            f"`delta` in the coding byte of {name}, in a step with a split and a drop",
            "sums the list, or ignores the bit",
            "E_PACKET",
            "delta-in-nothing-but-adds",
        )
    yield case(
        "delta-in-nothing-but-adds",
        replace(BASE, packets=[Packet(adds={X: [1, 2, 3]}, codings={"adds 0": 0x44}), MIXED]),
        "R-5.9-3",
        "`delta` in the coding byte of adds",
        "refuses it, or ignores it",
        runs=(FILE,),
    )
    lists = [
        ("kinds", with_mixed(records={0: REFINE, 1: REFINE}, alpha={}, coding_bytes={"kinds": 1})),
        ("alpha 4", with_mixed(records={0: REFINE, 1: DROP, 2: REFINE}, alpha={},
                               coding_bytes={"alpha 4": 8})),
        ("psi 13", with_add(coding_bytes={"psi 13": 0x10})),
        ("adds 5", with_mixed(adds={}, coding_bytes={"adds 5": 0x28})),
    ]  # fmt: skip
    lists.append(
        (
            "adds 6",
            with_mixed(
                adds={}, coding_bytes={"adds 6": 1}, entries=lambda e: [(e[0][0] + 1, e[0][1])]
            ),
        )
    )
    for name, stream in lists:
        yield case(
            f"coding-of-no-{name.replace(' ', '-')}",
            stream,
            "R-5.9-4",
            f"a coding byte for {name}, of which there are none",
            "expects planes of 0 bytes, or does not look",
            "E_PACKET",
            TWIN,
        )


def frames() -> Iterator[Case]:
    """Frame entries against planes and bytes."""
    rows = [
        ("planes-0", lambda e: [(0, e[0][1]), *e[1:]], "R-5.9-7", "an entry of no plane"),
        ("planes-0-and-2", lambda e: [(0, 0), (2, e[0][1] + e[1][1])], "R-5.9-7",
         "an entry of no plane and no byte beside one of two planes"),
        ("planes-too-many", lambda e: [e[0], (2, e[1][1])], "R-5.9-7", "a plane too many"),
        ("planes-too-few", lambda e: [(1, e[0][1] + e[1][1])], "R-5.9-7", "a plane too few"),
        ("planes-257", lambda e: [(255, e[0][1]), (3, e[1][1])], "R-5.9-7",
         "258 planes, 2 modulo 256"),
        ("no-frame", lambda _: [], "R-5.9-7", "planes and no frame"),
        ("bytes-too-many", lambda e: [e[0], (1, e[1][1] + 1)], "R-5.9-8",
         "the frames are a byte longer than the packet"),
        ("bytes-too-few", lambda e: [e[0], (1, e[1][1] - 1)], "R-5.9-8",
         "a byte of the packet is in no frame"),
        ("bytes-wrap", lambda e: [(1, 0xFFFFFFFF), (1, e[0][1] + e[1][1] + 1)],
         "R-5.9-8", "the sizes of the frames sum to 2^32 and what there is"),
        ("bytes-0", lambda e: [(1, 0), (1, e[0][1] + e[1][1])], "R-5.10-1",
         "the first frame has no byte"),
    ]  # fmt: skip
    for name, change, rule, tests in rows:
        yield case(
            f"frames-{name}",
            with_add(entries=change),
            rule,
            tests,
            "takes the frames one after the other and does not add up",
            "E_FRAME" if rule == "R-5.10-1" else "E_PACKET",
            TWIN,
        )
    yield case(
        "frames-for-no-plane",
        replace(BASE, packets=[Packet(n_adds=2, edit=lambda b: b[:1] + b"\1" + b[2:] + bytes(5))]),
        "R-5.9-7",
        "an entry of no plane and no byte in a packet without planes",
        "skips it",
        "E_PACKET",
        "core-one-splat-of-zeros",
    )
    yield case(
        "bytes-behind-the-last-frame",
        with_band(edit=lambda body: body + b"\0"),
        "R-5.9-8",
        "a byte follows the last frame of a packet",
        "reads as many frames as it needs and no further",
        "E_PACKET",
        TWIN,
    )
    yield case(
        "bytes-behind-no-frame",
        replace(BASE, packets=[Packet(n_adds=2, edit=lambda body: body + b"\0")]),
        "R-5.9-8",
        "a byte follows the header of a packet without frames",
        "skips the rest of a packet without planes",
        "E_PACKET",
        "core-one-splat-of-zeros",
    )


def low_planes() -> Iterator[Case]:
    """Bits that belong to no value."""
    for low, n, byte in ((1, 9, 0x80), (2, 3, 0x40), (4, 1, 0x10)):
        yield case(
            f"low-{low}-tail-of-{n}",
            low_plane(low, n, -1, byte),
            "R-5.9-9",
            f"{n} values of {low} bits, and a bit behind them",
            "ignores the bits behind the last value",
            "E_PACKET",
            "low-planes-full",
        )
    for low in (3, 7):
        yield case(
            f"low-{low}-above",
            low_plane(low, 2, 0, 1 << low),
            "R-5.9-9",
            f"values of {low} bits in a byte each, with the next bit set",
            "adds the bit to the bits above",
            "E_PACKET",
            "low-planes-full",
        )
    widths = (1, 2, 3, 4, 5, 6, 7, 8)
    stored = {f"adds {c}": [(1 << low) - 1] * 9 for c, low in enumerate(widths)}
    yield case(
        "low-planes-full",
        Stream([Packet(n_adds=9, stored=stored,
                       codings={f"adds {c}": low for c, low in enumerate(widths)})]),
        "R-5.9-9 7.1",
        "nine values of each width with all their bits set",
        "takes the last byte of a packed plane for padding",
        runs=(FILE,),
    )  # fmt: skip


def low_plane(low: int, n: int, at: int, bit: int) -> Stream:
    """N values of one channel, with a bit set in a byte of their low plane."""

    def style(content: bytes) -> bytes:
        changed = bytearray(content)
        changed[at] |= bit
        return runs(bytes(changed))

    packet = Packet(n_adds=n, stored={"adds 0": [1] * n}, codings={"adds 0": low}, style=style)
    return Stream([packet])


RECIPES: tuple[Recipe, ...] = (legal, headers, codings, frames, low_planes)
