"""Two faults each in the packet table or in packets: the first is reported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from conformance.decoders.outcomes import Run
from conformance.generator.builder import (
    DELTA,
    DROP,
    REFINE,
    RESERVED,
    RLE,
    SPLIT,
    Packet,
    Tile,
    X,
    Y,
    build,
    frame,
    raw,
)
from conformance.generator.cases.case import VERIFY, Case, Recipe
from conformance.generator.cases.order import ADD, BASE, MIXED, Row, cases_of, with_packets
from conformance.generator.cases.scenes import numbers

FAMILY = "order"


def bad_frame(content: bytes) -> bytes:
    """A frame with a block of the reserved type."""
    return frame(len(content), [(RESERVED, 0, b"")])


def short(content: bytes) -> bytes:
    """A frame that gives a byte too little."""
    return frame(len(content), [(RLE, len(content) - 1, b"\0")])


def rows_of_pack() -> Iterator[Case]:
    """Step 3, PACK."""
    band = Packet(component=1, adds=numbers(3, 9))
    empty = [Packet()] * 1024
    rows: list[Row] = [
        (
            "row-0-count-row-1-chain",
            with_packets(Packet(records={0: DROP}), replace(ADD, tile=9)),
            "E_COUNT",
            "a drop of nothing, then a tile that is none",
        ),
        (
            "row-0-chain-row-1-reserved",
            with_packets(replace(ADD, level=7), replace(ADD, row={"reserved": 1})),
            "E_CHAIN",
            "a level that is none, then a reserved bit",
        ),
        (
            "reserved-and-chain",
            with_packets(replace(ADD, tile=9, row={"reserved": 1})),
            "E_RESERVED",
            "a reserved bit and a tile that is none",
        ),
        (
            "chain-and-count",
            with_packets(replace(ADD, level=7, edit=lambda _: b"")),
            "E_CHAIN",
            "a level that is none, and adds without bytes",
        ),
        (
            "band-chain-and-count",
            replace(with_packets(replace(band, row={"n_adds": 1})), degree=1),
            "E_CHAIN",
            "a band before core, and its row counts adds",
        ),
        (
            "count-and-amplification",
            with_packets(Packet(records={0: DROP}, n_adds=9999)),
            "E_COUNT",
            "a drop of nothing, and more adds than bytes allow",
        ),
        (
            "count-and-crc",
            with_packets(replace(ADD, edit=lambda _: b"", row={"crc": 1})),
            "E_COUNT",
            "adds without bytes, and a crc of no bytes that is not 0",
        ),
        (
            "amplification-and-slots",
            with_packets(replace(ADD, row={"n_adds": 0xFFFFFFFF})),
            "E_AMPLIFICATION",
            "4294967295 adds: more than bytes, and more than the tier allows",
        ),
        (
            "crc-and-steps",
            with_packets(*empty, Packet(row={"crc": 1})),
            "E_CRC",
            "the crc of an empty step is not 0, and it is one step too many",
        ),
        (
            "steps-and-chain",
            with_packets(*empty, Packet(), replace(ADD, tile=9)),
            "E_TIER",
            "a step too many, then a tile that is none",
        ),
    ]
    yield from cases_of(rows, "5.6 6.1")
    yield from cases_of(
        [
            (
                "own-steps-and-chain",
                with_packets(ADD, MIXED, replace(ADD, tile=9)),
                "E_LIMIT",
                "steps over the decoder's own limit, then a tile that is none",
            ),
            (
                "chain-and-own-steps",
                with_packets(ADD, replace(MIXED, level=7)),
                "E_CHAIN",
                "a level that is none, and steps over the decoder's own limit",
            ),
            (
                "own-steps-and-packet",
                with_packets(replace(ADD, row={"crc": 1}), MIXED),
                "E_LIMIT",
                "steps over the decoder's own limit, and a packet with a wrong crc",
            ),
        ],
        "R-8.3-1 5.6",
        Run(limits={"tile_steps": 1}),
    )


def packets() -> Iterator[Case]:
    """Steps 4 to 6."""
    far = replace(MIXED, records={0: SPLIT, 1: REFINE, 7: DROP})
    rows: list[Row] = [
        (
            "crc-and-header",
            with_packets(replace(ADD, flags=0xFF, row={"crc": 1})),
            "E_CRC",
            "the crc and the flags of a packet are wrong",
        ),
        (
            "codings-cut-and-reserved",
            with_packets(replace(ADD, flags=0xFF, edit=lambda b: b[:30])),
            "E_PACKET",
            "coding bytes are missing, and reserved flags set",
        ),
        (
            "reserved-and-coding",
            with_packets(replace(ADD, flags=4, coding_bytes={"adds 0": 9})),
            "E_RESERVED",
            "a reserved flag, and a coding byte that is none",
        ),
        (
            "reserved-in-last-coding",
            with_packets(replace(ADD, coding_bytes={"gaps": 9, "adds 13": 0x81})),
            "E_RESERVED",
            "the first coding byte is none, the last has its reserved bit set",
        ),
        (
            "coding-and-frame",
            with_packets(replace(ADD, coding_bytes={"kinds": 1}, style=bad_frame)),
            "E_PACKET",
            "a coding byte of an empty list, and a faulty frame",
        ),
        (
            "planes-and-frame",
            with_packets(replace(ADD, entries=lambda e: [(9, e[0][1])], style=bad_frame)),
            "E_PACKET",
            "too few planes, and a faulty frame",
        ),
        (
            "zstd-and-later-frame",
            with_packets(
                Packet(
                    adds={X: [1, 2], Y: [300, 2]},
                    frames=(1, 2),
                    codings={"adds 0": 8, "adds 1": 0x18},
                    style=lambda c: short(c) if len(c) == 2 else bad_frame(c),
                )
            ),
            "E_ZSTD",
            "the first frame gives too little, the second has a reserved block",
        ),
        (
            "zstd-and-later-magic",
            with_packets(
                Packet(
                    adds={X: [1, 2], Y: [300, 2]},
                    frames=(1, 2),
                    codings={"adds 0": 8, "adds 1": 0x18},
                    style=lambda c: short(c) if len(c) == 2 else b"?" + raw(c)[1:],
                )
            ),
            "E_ZSTD",
            "the first frame gives too little, the second has no magic number",
        ),
        (
            "magic-and-block",
            with_packets(replace(ADD, style=lambda c: b"\0" + bad_frame(c)[1:])),
            "E_FRAME",
            "magic number and block are wrong",
        ),
        (
            "frame-and-low-plane",
            with_packets(
                Packet(
                    n_adds=3,
                    stored={"adds 0": [1] * 3, "adds 1": [300] * 3},
                    codings={"adds 0": 1, "adds 1": 0x18},
                    frames=(1, 2),
                    style=lambda c: raw(b"\xff") if len(c) == 1 else bad_frame(c),
                )
            ),
            "E_FRAME",
            "a bit of no value in the first frame, and a faulty second frame",
        ),
        (
            "low-plane-and-slot",
            with_packets(
                ADD,
                Packet(
                    records={7: REFINE},
                    psi={X: [-1]},
                    stored={"gaps": [1]},
                    codings={"gaps": 1, "psi 0": 1},
                    style=lambda c: raw(b"\xff" * len(c)),
                ),
            ),
            "E_PACKET",
            "a bit of no value, and a slot that is none",
        ),
        (
            "slot-and-kind",
            with_packets(ADD, replace(far, stored={"kinds": [3, 3, 3]})),
            "E_SLOT",
            "a slot that is none, and kinds that are none",
        ),
        (
            "kind-and-index",
            with_packets(ADD, replace(MIXED, stored={"kinds": [0, 0, 2], "alpha 1": [200]})),
            "E_KIND",
            "kinds that contradict the row, and an index past its table",
        ),
        (
            "index-and-range",
            replace(
                with_packets(ADD, replace(MIXED, alpha={3: [1]}, psi={X: [9, 9]})),
                quantisers={(2, 0): (65535, 24)},
            ),
            "E_INDEX",
            "an index past its table, and a Delta above 2^28",
        ),
        (
            "slot-and-sum",
            with_packets(
                ADD,
                replace(
                    far,
                    adds={X: [8388607 * k for k in range(1, 34)]},
                    codings={"adds 0": 0x28 | DELTA},
                ),
            ),
            "E_SLOT",
            "a slot that is none, and a running sum above 2^28",
        ),
        (
            "range-and-next-packet",
            replace(
                with_packets(ADD, replace(MIXED, row={"crc": 1})),
                tiles=[Tile(high=(0, 0, 0), low=(0, 0, 0))],
            ),
            "E_RANGE",
            "a packet leaves the box, the next has a wrong crc",
        ),
        (
            "tile-1-before-tile-0",
            replace(
                with_packets(replace(ADD, tile=1, row={"crc": 1}), replace(ADD, flags=4)),
                tiles=[Tile(), Tile()],
            ),
            "E_CRC",
            "the first packet, of tile 1, has a wrong crc, the second, of tile 0, a reserved flag",
        ),
        (
            "crc-and-truncated",
            build(with_packets(replace(ADD, row={"crc": 1}), MIXED))[:-1],
            "E_CRC",
            "a wrong crc, and the next packet is cut",
        ),
        (
            "truncated-and-crc",
            build(with_packets(ADD, replace(MIXED, row={"crc": 1})))[:-1],
            "E_TRUNCATED",
            "a packet is cut, and its crc is wrong",
        ),
        (
            "packet-and-trailing",
            replace(with_packets(ADD, replace(MIXED, flags=4)), tail=b"\0"),
            "E_RESERVED",
            "a reserved flag, and a byte behind the last packet",
        ),
    ]
    yield from cases_of(rows, "5.9 6.1")
    wrong = replace(BASE, digests={(0, 0, 0): b"\0" * 32})
    verified: list[Row] = [
        (
            "trailing-and-digest",
            replace(wrong, tail=b"\0"),
            "E_TRAILING",
            "a byte behind the last packet, and a wrong digest",
        ),
        (
            "truncated-and-digest",
            build(wrong)[:-1],
            "E_TRUNCATED",
            "the last packet is cut, and the digest of the first is wrong",
        ),
        (
            "packet-and-digest",
            replace(wrong, packets=[ADD, replace(MIXED, flags=4)]),
            "E_RESERVED",
            "a digest of packet 0 is wrong, and packet 1 has a reserved flag",
        ),
    ]
    yield from cases_of(verified, "R-5.7-4 6.1", VERIFY)


RECIPES: tuple[Recipe, ...] = (
    rows_of_pack,
    packets,
)
