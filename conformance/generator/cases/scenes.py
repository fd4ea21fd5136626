"""Small scenes that many cases start from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from conformance.generator.builder import DROP, REFINE, SPLIT, Packet, Stream

__all__ = ["SMALL", "banded", "class_of", "n_channels", "numbers", "ramp", "same"]


def n_channels(component: int) -> int:
    """Channels of a component (spec 3.5)."""
    return 14 if component == 0 else 3 * (2 * component + 1)


def class_of(channel: int) -> int:
    """Quantiser class of a channel of core (spec 3.2)."""
    return (0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4)[channel]


def numbers(n: int, channels: int = 14, spread: int = 20, seed: int = 0) -> dict[int, list[int]]:
    """Integers within -spread..spread for each channel, of no pattern."""
    size = 2 * spread + 1
    return {
        c: [
            ((c + 1) * 7919 + (i + 1) * 104729 + seed * 1299709) // 7 % size - spread
            for i in range(n)
        ]
        for c in range(channels)
    }


def ramp(n: int, channels: int = 14, first: int = 1) -> dict[int, list[int]]:
    """Integers that are all different: first, first + 1 ..."""
    return {c: [first + c * n + i for i in range(n)] for c in range(channels)}


def same(q: Iterable[int], channels: Iterable[int] = range(14)) -> dict[int, list[int]]:
    """The same integers for each channel."""
    return {c: list(q) for c in channels}


def banded(cores: Iterable[Packet], degree: int, seed: int = 0) -> Iterator[Packet]:
    """Each core packet, and behind it those of all bands."""
    for core in cores:
        yield core
        n_new, n_psi = core.counts["n_adds"], core.counts["n_splits"] + core.counts["n_refines"]
        for band in range(1, degree + 1):
            c = n_channels(band)
            yield Packet(
                component=band,
                tile=core.tile,
                adds=numbers(n_new, c, seed=seed + band) if n_new else {},
                psi=numbers(n_psi, c, seed=seed + band + 5) if n_psi else {},
            )
            seed += 11


# Three splats; then one splits, one is refined, one is dropped.
SMALL = Stream(
    [
        Packet(adds=numbers(3)),
        Packet(
            records={0: SPLIT, 1: REFINE, 2: DROP},
            psi=numbers(2, seed=1),
            alpha={0: [1]},
            level=1,
        ),
    ],
    n_levels=2,
    alphas={(1, 0): (2, [3, -5])},
)
