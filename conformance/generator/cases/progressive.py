"""Pieces of a file in any order, packets that are missing, SH that is late."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from random import Random

from conformance.decoders.outcomes import Run
from conformance.generator.builder import (
    DROP,
    REFINE,
    SPLIT,
    Packet,
    Stream,
    Tile,
    build,
    patched,
    places,
    repaired,
)
from conformance.generator.cases.case import FILE, PROGRESSIVE, Case, Recipe, case
from conformance.generator.cases.scenes import banded, numbers

FAMILY = "progressive"
Pieces = list[tuple[int, int]]  # (offset, size)
ADD = Packet(adds=numbers(3))
GROW = Packet(
    records={0: SPLIT, 2: REFINE}, psi=numbers(2, seed=1), adds=numbers(1, seed=2), level=1
)
SHRINK = Packet(records={1: DROP, 3: SPLIT}, psi=numbers(1, seed=3), level=2)
CORES = (ADD, GROW, SHRINK)
SCENE = Stream(
    [*banded(CORES, 1), *banded([replace(core, tile=1) for core in CORES], 1, seed=4)],
    degree=1,
    n_levels=3,
    tiles=(Tile(), Tile((5, 5, 5))),
)


def came(*pieces: tuple[int, int]) -> Run:
    """A run in which these pieces came."""
    return Run("progressive", arrival=pieces)


def cuts() -> Iterator[Case]:
    """Prefixes around every packet boundary."""
    data = build(SCENE)
    for number, (start, end) in enumerate(places(data).packets):
        if number % 3:
            continue
        yield case(
            f"boundary-of-packet-{number}",
            data,
            "R-6.4-1 R-6.4-3 6.4",
            f"the file up to packet {number}, within it, and around its end",
            "shows a packet that lacks a byte, or waits for one more",
            runs=tuple(came((0, size)) for size in (start, start + 1, end - 1, end, end + 1)),
        )
    head = places(data).packets[0][0]
    yield case(
        "boundary-of-chunks",
        data,
        "R-6.4-1 R-6.4-3 6.4",
        "nothing, parts of the header, the header, chunks without their last byte, all chunks",
        "gives an empty scene before header and chunks are there, or none when they are",
        runs=tuple(came((0, size)) for size in (0, 1, 63, 64, 65, head - 1, head)),
    )


def orders_of_arrival() -> Iterator[Case]:
    """All bytes, in other orders."""
    data = build(SCENE)
    packets, size = places(data).packets, len(data)
    head = packets[0][0]
    rng = Random(6)
    ends = sorted(rng.sample(range(1, size), 40))
    random_pieces = [(a, b - a) for a, b in zip([0, *ends], [*ends, size], strict=True)]
    rng.shuffle(random_pieces)
    overlapping = [(max(0, at - 9), n + 30) for at, n in random_pieces]
    rows: list[tuple[str, Pieces, str]] = [
        (
            "packets-backwards",
            [(0, head), *((a, b - a) for a, b in packets[::-1])],
            "header and chunks, then the packets, the last first",
        ),
        (
            "head-last",
            [*((a, b - a) for a, b in packets), (0, head)],
            "the packets, then header and chunks",
        ),
        ("bytes-one-by-one", [(at, 1) for at in range(size)], "each byte for itself"),
        (
            "odd-bytes-first",
            [(at, 1) for at in [*range(1, size, 2), *range(0, size, 2)]],
            "the bytes of odd offset, then those of even offset",
        ),
        ("random-pieces", random_pieces, "41 pieces in a random order"),
        (
            "overlapping-pieces",
            [(at, min(n, size - at)) for at, n in overlapping],
            "41 pieces that overlap, in a random order",
        ),
        ("all-of-it-twice", [(0, size), (0, size)], "the whole file, twice"),
        (
            "pieces-across-packets",
            [(at, min(17, size - at)) for at in range(0, size, 17)][::-1],
            "pieces of 17 bytes across all boundaries, the last first",
        ),
    ]
    for name, pieces, tests in rows:
        yield case(
            f"arrival-{name}",
            data,
            "R-6.4-2 6.4",
            tests,
            "applies packets in the order in which they come, or counts bytes twice",
            runs=(came(*pieces),),
        )
    start, end = packets[4]
    middle = (start + end) // 2
    yield case(
        "arrival-pieces-within-pieces",
        data,
        "R-6.4-2 6.4",
        "the whole file, and then pieces of it once more",
        "shortens what it has to the last piece",
        runs=(came((0, size), (9, 30), (start, 5)), came((9, 30), (0, size), (start, 5))),
    )
    yield case(
        "arrival-half-a-packet-twice",
        data,
        "R-6.4-1 R-6.4-2 6.4",
        "all but the second half of a packet, and its first half twice",
        "counts bytes instead of noting which came",
        runs=(
            came((0, middle), (start, middle - start), (start, middle - start), (end, size - end)),
        ),
    )


def missing() -> Iterator[Case]:
    """Packets that never come."""
    data = build(SCENE)
    packets, size = places(data).packets, len(data)
    names = [
        f"{kind}-{step}-of-tile-{t}"
        for t in (0, 1)
        for step in range(3)
        for kind in ("core", "band")
    ]
    for (start, end), name in zip(packets, names, strict=True):
        if name in ("band-0-of-tile-1", "band-1-of-tile-1"):
            continue  # as of tile 0
        yield case(
            f"without-{name}",
            data,
            "R-6.4-1 3.6 6.4" + (" R-7.5-1 7.5" if "band" in name else ""),
            f"{name.replace('-', ' ')} lacks its first byte, its last byte, all bytes",
            "applies a packet whose chain it does not have, or stops at the first gap",
            runs=tuple(
                came(*[piece for piece in pieces if piece[1]])
                for pieces in (
                    [(0, start), (start + 1, size - start - 1)],
                    [(0, end - 1), (end, size - end)],
                    [(0, start), (end, size - end)],
                )
            ),
        )
    yield case(
        "without-a-byte-of-the-head",
        data,
        "R-6.4-1 R-6.4-3 6.4",
        "all but the first byte; all but a byte of the chunks",
        "guesses what it lacks, or fails",
        runs=(came((1, size - 1)), came((0, 99), (100, size - 100))),
    )
    yield case(
        "tile-1-only",
        data,
        "R-6.4-1 3.6 6.4",
        "no packet of tile 0, all of tile 1",
        "waits for tile 0, or puts tile 1 in its place",
        runs=(came((0, packets[0][0]), (packets[6][0], size - packets[6][0])),),
    )


def faults() -> Iterator[Case]:
    """Faults of packets that come, beside packets that do not."""
    data = build(SCENE)
    packets, size = places(data).packets, len(data)

    def damaged(*numbers_: int) -> bytes:
        out = data
        for k in numbers_:
            out = patched(out, packets[k][1] - 1, bytes([out[packets[k][1] - 1] ^ 1]))
        return out

    def without(k: int) -> Run:
        return came(
            *[p for p in [(0, packets[k][0]), (packets[k][1], size - packets[k][1])] if p[1]]
        )

    rows: list[tuple[str, bytes, Run, str | None, str]] = [
        ("last-packet", damaged(11), PROGRESSIVE, "E_CRC", "all bytes came, the last is wrong"),
        (
            "behind-a-missing-packet",
            damaged(8),
            without(2),
            "E_CRC",
            "packet 2 is missing, and packet 8, of another tile, is wrong: no more bytes come",
        ),
        (
            "that-must-wait",
            damaged(4),
            without(2),
            None,
            "packet 2 is missing, and packet 4, which requires it, is wrong and not examined",
        ),
        (
            "in-a-packet-that-lacks-a-byte",
            damaged(11),
            came((0, size - 1)),
            None,
            "the wrong byte did not come",
        ),
        (
            "two-faults-last-first",
            damaged(2, 8),
            came(
                (0, packets[0][0]),
                (packets[6][0], size - packets[6][0]),
                (packets[0][0], packets[6][0] - packets[0][0]),
            ),
            "E_CRC",
            "two wrong packets, of which the later came first: the report names the earlier",
        ),
    ]
    for name, bytes_, run, code, tests in rows:
        yield case(
            f"fault-{name}",
            bytes_,
            "R-6.4-4 R-6.3-1 6.4",
            tests,
            "reports what came first, what it did not examine, or nothing",
            code,
            None if code is None else "arrival-head-last",
            runs=(run,),
        )
    yield case(
        "fault-of-range-in-a-late-band",
        replace(
            SCENE,
            packets=[ADD, GROW, Packet(component=1, adds=dict.fromkeys(range(9), 1 << 22))],
            quantisers={(0, 5): (255, 0)},
        ),
        "R-6.4-4 R-7.3-1",
        "a band of step 0 that comes after step 1 of core leaves its range",
        "does not check bands that come late",
        "E_RANGE",
        "arrival-head-last",
        runs=(FILE, PROGRESSIVE),
    )
    trailing = data + b"?"
    yield case(
        "trailing-byte",
        trailing,
        "R-6.2-1 R-6.4-4 6.4",
        "a byte behind the last packet came",
        "does not look behind the last packet",
        "E_TRAILING",
        "arrival-head-last",
        runs=(PROGRESSIVE, came((0, size + 1)), came((size, 1), (0, size))),
    )
    yield case(
        "trailing-byte-that-did-not-come",
        trailing,
        "R-6.2-1 R-6.4-1 6.4",
        "a byte behind the last packet is there and did not come",
        "looks at the size of the file",
        runs=(came((0, size)), came((0, size - 1))),
    )
    yield case(
        "trailing-byte-and-missing-packet",
        trailing,
        "R-6.2-1 R-6.4-3 R-6.4-4 6.4",
        "the last packet is missing, a byte behind it came",
        "says that it is not complete, and not that it is no legal file",
        "E_TRAILING",
        "arrival-head-last",
        runs=(came((0, packets[11][0]), (size, 1)),),
    )
    header = repaired(patched(data, 10, b"\7"))
    yield case(
        "fault-of-header-alone",
        header,
        "R-6.4-3 R-5.1-4 6.4",
        "a header with a fault came; chunks did not",
        "waits for chunks before it looks at the header",
        "E_HEADER",
        "arrival-head-last",
        runs=(came((0, 64)), came((0, 70)), FILE),
    )


RECIPES: tuple[Recipe, ...] = (
    cuts,
    orders_of_arrival,
    missing,
    faults,
)
