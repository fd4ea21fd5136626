"""Shapes that cost much at some time: found by the search, by attackers, or by reading the code."""

from __future__ import annotations

from conformance.fuzzing.costly import Shape

__all__ = ["KNOWN"]

FULL = Shape(coded=59, bands="each")

# fmt: off
KNOWN: dict[str, Shape] = {
    "splats, all numbers 0": Shape(),
    "splats, 3 planes a number": FULL,
    "splats, differences, turned colours": Shape(
        coded=59, bands="each", delta=True, ycocg=True, value=2
    ),
    "the same, a wrong checksum at the end": Shape(
        coded=59, bands="each", delta=True, ycocg=True, value=2, fault="crc"
    ),
    "splats, a byte behind the end": Shape(adds=200_000, coded=59, bands="each", fault="trailing"),
    "all split": Shape(
        steps=("adds", "split all"), adds=100_000, coded=59, bands="each", ycocg=True, value=2
    ),
    "all split, late bands": Shape(
        steps=("adds", "split all"), adds=100_000, coded=59, bands="first", ycocg=True, value=2
    ),
    "deep chains, late bands": Shape(steps=("adds", "split new"), adds=3_000, bands="first"),
    "one chain, late bands": Shape(steps=("adds", "split last"), adds=1, bands="first"),
    "all refined": Shape(
        steps=("adds", "refine all"), adds=100_000, coded=59, bands="each", ycocg=True, value=2
    ),
    "every other refined, a frame a plane": Shape(
        steps=("adds", "refine other"), adds=100_000, coded=59, bands="each", value=2, frame=1
    ),
    "a slot dropped at each step": Shape(steps=("adds", "drop one"), adds=1_000_000, bands="each"),
    "a splat a step": Shape(adds=1, bands="each"),
    "a splat a step, core alone": Shape(adds=1),
    "splats in coarse steps, then bands": Shape(
        steps=("mixed",), adds=10, bands="end", coded=59, levels=64
    ),
    "late picks": Shape(
        steps=("adds", "refine all"), adds=800_000, entries=1000, coded=30, bands="first"
    ),
    "a large palette": Shape(
        adds=100, entries=1 << 21, coded=30, bands="each", delta=True, ycocg=True, value=2
    ),
    "tiles and levels": Shape(tiles=600, levels=64, adds=1),
    "tiles and alpha tables": Shape(tiles=250, degree=0, levels=64, alphas=20_000),
    "digests": Shape(digests=500, steps=("adds", "empty"), adds=60_000, bands="each"),
    "many small frames in ten tiles": Shape(
        degree=1, tiles=10, adds=3_000, coded=59, coding=4, delta=True, ycocg=True, alphas=1_000,
        fault="trailing",
    ),
    "refined, then split one by one": Shape(
        levels=64, steps=("adds", "refine all", "split first"), bands="each", coded=1, coding=1,
        frame=1, chunks=5_000,
    ),
    "metadata, alpha tables, small steps": Shape(
        degree=1, levels=10, steps=("adds", "split last", "empty", "adds"), adds=20, bands="first",
        coded=30, coding=32, frame=1, alphas=20_000, metadata=5_000,
    ),
    "metadata": Shape(metadata=12_000),
    "unknown chunks": Shape(chunks=8_000),
}
# fmt: on
