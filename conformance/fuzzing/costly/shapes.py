"""What a costly stream is like, and random ones."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

__all__ = ["STEPS", "Shape", "random_shape"]

STEPS = (
    "adds", "split all", "split new", "split last", "split first", "refine all", "refine other",
    "refine one", "drop one", "drop all", "mixed", "empty",
)  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """What a stream is like.

    Attributes:
        degree: of SH.
        tiles, levels: how many.
        steps: what the steps of a tile do: the first ones, and the last over and over.
        adds: splats that a step adds, or as many as its share of the bytes allows.
        bands: when packets of SH bands, or picks, come: "never", with "each" step, only "first",
            or at the "end" after all of core.
        coded: how many of the lists of psi and adds are stored, from the first on.
        coding: their coding byte, but for delta.
        delta: adds are differences, and psi of steps that only refine are sibling differences.
        ycocg: SH are turned.
        value: stored integers, where they may have any.
        frame: planes of a frame.
        entries: of a palette; 0: there is none.
        digests: rows; all are wrong, which costs as much and makes no difference without --verify.
        alphas: entries of tables.
        metadata: entries.
        chunks: unknown ancillary chunks.
        fault: "" for a legal stream; "trailing", or the last packet has a wrong "crc" or "bit".
        by_step: packets are in order of their steps, tiles in turns; else tile by tile.
    """

    degree: int = 3
    tiles: int = 1
    levels: int = 1
    steps: tuple[str, ...] = ("adds",)
    adds: int = 1 << 21
    bands: str = "never"
    coded: int = 0
    coding: int = 0x28
    delta: bool = False
    ycocg: bool = False
    value: int = 0
    frame: int = 255
    entries: int = 0
    digests: int = 0
    alphas: int = 0
    metadata: int = 0
    chunks: int = 0
    fault: str = ""
    by_step: bool = True


def random_shape(rng: Random) -> Shape:
    """A shape of which every part is drawn by itself."""
    degree = rng.choice((0, 1, 3, 3, 3))
    many = rng.choice((0, 0, 0, 1))
    return Shape(
        degree=degree,
        tiles=rng.choice((1, 1, 1, 1, 2, 20, 200, 1000)),
        levels=rng.choice((1, 1, 3, 64)),
        steps=("adds", *rng.choices(STEPS, k=rng.choice((0, 1, 1, 2, 3)))),
        adds=rng.choice((1, 3, 100, 3000, 1 << 21, 1 << 21)),
        bands=rng.choice(("never", "each", "first", "end")),
        coded=rng.choice((0, 0, 1, 14, 200)),
        coding=rng.choice((0x28, 0x08, 0x01, 0x10, 0x15)),
        delta=rng.random() < 0.3,
        ycocg=rng.random() < 0.3,
        value=rng.choice((0, 0, 1)),
        frame=rng.choice((255, 255, 1, 3)),
        entries=rng.choice((0, 0, 0, 1, 500, 300_000)) if degree else 0,
        digests=many * rng.choice((0, 5, 500)),
        alphas=many * rng.choice((0, 1, 256, 5000)),
        metadata=many * rng.choice((0, 1000, 5000)),
        chunks=many * rng.choice((0, 1000, 5000)),
        fault=rng.choice(("", "", "", "", "trailing", "crc")),
        by_step=rng.random() < 0.7,
    )
