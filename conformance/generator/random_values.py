"""Random values of streams: numbers, codings, quantisers, tables, metadata, names of states."""

from __future__ import annotations

from random import Random

from conformance.generator.builder import (
    FrameStyle,
    Packet,
    compressed,
    raw,
    runs,
)

__all__ = [
    "ANCILLARY",
    "random_alphas",
    "random_coding",
    "random_metadata",
    "random_names",
    "random_numbers",
    "random_origin",
    "random_quantiser",
    "random_style",
]

QUANTISERS = ((1, 0), (3, 1), (255, 8), (65535, 0), (1, 24), (65535, 24), (40000, 12), (7, 20))
ENTRIES = (1, 1, -1, 0, 2, -3, 64, 4096, 32767, -32768)
SPREADS = (0, 0, 1, 3, 7, 100, 3000, 1 << 15, (1 << 23) - 1)  # of q; values have 24 bits
ANCILLARY = (b"teSt", b"abCD", b"zZZz", b"aaAa")


def random_numbers(rng: Random, n: int, most: int) -> list[int]:
    """N integers of at most `most`, all of one spread."""
    spread = min(rng.choice(SPREADS), max(0, most))
    if rng.random() < 0.1:
        return [rng.choice((-spread, spread, 0)) for _ in range(n)]
    return [rng.randint(-spread, spread) for _ in range(n)]


def random_coding(rng: Random, largest: int) -> int:
    """Any coding byte that holds integers up to `largest`."""
    wide = [
        low | high << 4
        for low in range(9)
        for high in range(3)
        if low + 8 * high >= largest.bit_length() and low + high
    ]
    return rng.choice(wide)


def random_style(rng: Random) -> FrameStyle:
    """A way of making frames."""
    block, width = rng.choice((1, 3, 7, 1 << 17)), rng.choice((None, 4, 8))
    styles: tuple[FrameStyle, ...] = (
        raw,
        runs,
        compressed(rng.choice((-5, 1, 3, 19))),
        lambda content: raw(content, block, width),
    )
    return rng.choice(styles)


def random_quantiser(rng: Random) -> tuple[int, int]:
    """(M, E), often at a limit."""
    if rng.random() < 0.6:
        return rng.choice(QUANTISERS)
    return rng.randint(1, 65535), rng.randint(0, 24)


def random_alphas(
    rng: Random, n_levels: int
) -> dict[tuple[int, int], tuple[int, list[int]]] | None:
    """Tables of some levels and groups; None: no ALFA."""
    if rng.random() < 0.2:
        return None
    keys = [(level, g) for level in range(min(n_levels, 5)) for g in range(5) if rng.random() < 0.5]
    return {
        key: (
            rng.randint(0, 12),
            rng.choices(ENTRIES, k=256 if rng.random() < 0.02 else rng.randint(1, 4)),
        )
        for key in keys
    }


def random_origin(rng: Random) -> tuple[int, int, int]:
    """Of a tile: zero, small or at a limit, along each axis."""
    x, y, z = (rng.choice((0, 1, -1, 1 << 52, -(1 << 52), 123456789)) for _ in range(3))
    return x, y, z


def random_metadata(rng: Random) -> dict[str | bytes, str | bytes] | None:
    """Entries of mETa; None for no such chunk."""
    if rng.random() < 0.6:
        return None
    keys = sorted({rng.choice(("a", "title", "z.-_9", "0", "comment")) for _ in range(2)})
    return {key: rng.choice(("", "x", "\0\n", "é𝄞")) for key in keys}


def random_names(rng: Random, packets: list[Packet]) -> list[tuple[int, int, int]]:
    """Some packets by tile, component and step, in the order of dGST."""
    seen, names = dict[tuple[int, int], int](), list[tuple[int, int, int]]()
    for packet in packets:
        chain = (packet.tile, packet.component)
        names.append((*chain, seen.get(chain, 0)))
        seen[chain] = seen.get(chain, 0) + 1
    return sorted(name for name in names if rng.random() < 0.7)
