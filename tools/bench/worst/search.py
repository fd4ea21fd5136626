"""The search: random shapes, then steps uphill from the worst, for each command alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

from conformance.fuzzing.costly import STEPS, Shape

__all__ = ["changed", "random_shape", "uphill"]

CHOICES: dict[str, tuple[object, ...]] = {
    "degree": (0, 1, 2, 3, 3, 3),
    "tiles": (1, 1, 1, 2, 10, 100, 300, 1000, 1900),
    "levels": (1, 2, 10, 64),
    "adds": (1, 10, 300, 3_000, 30_000, 300_000, 1 << 21),
    "bands": ("never", "each", "each", "first", "end"),
    "coded": (0, 1, 14, 30, 59),
    "coding": (0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x21, 0x24, 0x28),
    "delta": (False, True),
    "ycocg": (False, True),
    "value": (0, 2),
    "frame": (1, 3, 255),
    "entries": (0, 0, 0, 1, 1_000, 1 << 21),
    "digests": (0, 0, 0, 10, 300, 2_000),
    "alphas": (0, 0, 0, 1_000, 20_000),
    "metadata": (0, 0, 0, 5_000),
    "chunks": (0, 0, 0, 5_000),
    "fault": ("", "", "", "crc", "trailing"),
    "by_step": (True, False),
}


def random_shape(rng: Random) -> Shape:
    """Any shape that a stream can have."""
    fields = {name: rng.choice(options) for name, options in CHOICES.items()}
    return _possible(Shape(steps=_steps(rng), **fields))  # type: ignore[arg-type]


def changed(shape: Shape, rng: Random) -> Shape:
    """The shape with one or two other fields, or with counts a little larger or smaller."""
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice((*CHOICES, "steps", "adds", "adds"))
        if name == "steps":
            shape = replace(shape, steps=_steps(rng))
        elif name in ("adds", "tiles", "alphas", "digests", "entries") and rng.random() < 0.6:
            now = int(getattr(shape, name) * rng.choice((0.5, 0.8, 1.25, 2)))
            shape = replace(shape, **{name: min(now, 1 << 21)})  # type: ignore[arg-type]
        else:
            shape = replace(shape, **{name: rng.choice(CHOICES[name])})  # type: ignore[arg-type]
    return _possible(shape)


def uphill(
    cost: Callable[[Shape], float], start: Shape, rng: Random, n_random: int, n_steps: int
) -> tuple[float, Shape]:
    """The costliest of `start`, some random shapes, and steps from the costliest of them."""
    tried = [start, *(random_shape(rng) for _ in range(n_random))]
    best = max(((cost(shape), shape) for shape in tried), key=lambda pair: pair[0])
    for _ in range(n_steps):
        shape = changed(best[1], rng)
        found = cost(shape)
        if found > best[0]:
            best = found, shape
    return best


def _steps(rng: Random) -> tuple[str, ...]:
    return ("adds", *rng.choices(STEPS, k=rng.choice((1, 1, 2, 3))))


def _possible(shape: Shape) -> Shape:
    """The nearest shape whose chunks leave room and whose fields go together."""
    return replace(
        shape,
        degree=max(shape.degree, 1) if shape.entries else shape.degree,
        tiles=max(1, min(shape.tiles, 1_900)),
        adds=max(1, shape.adds),
        digests=min(shape.digests, 2_000),
        alphas=min(shape.alphas, 40_000),
    )
