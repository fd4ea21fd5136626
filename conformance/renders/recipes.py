"""The splats of the scenes, made from seeds.

All numbers are multiples of a power of two, so that near-lossless coding keeps them exactly and no
machine rounds them differently. Letters: n splats.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, Kind, SplatParams, Step, lift
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import F32, F64
from evogs_codec.render.demo_scene import make_scene

__all__ = [
    "antialiased",
    "colors",
    "far",
    "harmonics",
    "huge",
    "kinds",
    "lifted",
    "near",
    "needles",
    "off_screen",
    "opacity",
    "overlap",
    "pancakes",
    "procedural",
    "rotations",
    "ties",
    "trained",
]

SH_C0 = 0.28209479177387814  # colour = 0.5 + SH_C0 * coefficient 0
N_KINDS = 24
TREES = Path(__file__).resolve().parents[1] / "generator" / "cases" / "streams"


def ties() -> EvolutionTree:
    """Pairs of splats at one place, the places on three planes; level 1 splits all in place."""
    rng = _rng(1)
    places = np.column_stack([rng.uniform(-1, 1, (50, 2)), 0.5 * rng.integers(-1, 2, 50)])
    roots = _splats(
        np.repeat(places, 2, 0),
        log_scales=rng.uniform(-2.5, -1.2, (100, 3)),
        logits=rng.uniform(0, 3, 100),
        colors=rng.random((100, 3)),
    )
    psi = np.zeros((n_channels(0), 100))
    psi[7:10] = -0.25
    psi[11:] = rng.uniform(-1.5, 1.5, (3, 100))
    alpha = np.array([1.0, 1.0, -1.0, 1.0, 1.0])
    return EvolutionTree(
        0, (Step.of_adds(0, roots.channels()), _splits(1, np.arange(100), psi, alpha))
    )


def kinds() -> EvolutionTree:
    """A level of adds, one of splits, one of refines, drops and adds, and one that drops all."""
    rng = _rng(2)

    def some(n: int) -> SplatParams:
        return _splats(
            rng.uniform(-1, 1, (n, 3)),
            quats=rng.normal(size=(n, 4)),
            log_scales=rng.uniform(-2.5, -0.8, (n, 3)),
            logits=rng.uniform(0, 3, n),
            colors=rng.random((n, 3)),
        )

    d, n = n_channels(0), N_KINDS
    psi = _exact(rng.uniform(-0.5, 0.5, (d, n)))
    mixed = np.where(np.arange(2 * n) % 3 == 0, Kind.DROP, Kind.REFINE).astype(np.uint8)
    refine = _exact(rng.uniform(-0.5, 0.5, (d, int(np.count_nonzero(mixed == Kind.REFINE)))))
    left = np.concatenate([np.flatnonzero(mixed == Kind.REFINE), 2 * n + np.arange(n)])
    none = np.empty((5, 0), np.float32)
    return EvolutionTree(
        0,
        (
            Step.of_adds(0, some(n).channels()),
            _splits(1, np.arange(n), psi, np.array([1.0, -0.5, -1.0, 0.25, 0.75])),
            Step(2, np.arange(2 * n, dtype=np.int32), mixed, refine, none, some(n).channels()),
            Step(
                3,
                left.astype(np.int32),
                np.full(len(left), Kind.DROP, np.uint8),
                np.empty((d, 0), np.float32),
                none,
                np.empty((d, 0), np.float32),
            ),
        ),
    )


def off_screen() -> SplatParams:
    """In all directions in front, most of them outside the picture; some large."""
    rng = _rng(3)
    z = rng.uniform(1, 4, 260)
    slopes = rng.uniform(-2.5, 2.5, (260, 2))
    return _splats(
        np.column_stack([slopes * z[:, None], z]),
        quats=rng.normal(size=(260, 4)),
        log_scales=rng.uniform(-3, 0.3, (260, 3)),
        logits=rng.uniform(-2, 2, 260),
        colors=rng.random((260, 3)),
    )


def near() -> SplatParams:
    """Small splats on planes along z: at 0, a thousandth before and behind 0 and -1, and others.

    None is at -1: -1 + 1.2 > 0.2 in float32, and not in float64.
    """
    rng = _rng(4)
    step = 2.0**-10
    planes = np.array([-3, -1 - step, -1 + step, -0.5, -step, 0, step, 0.25, 1, 3])
    z = np.repeat(planes, 14)
    n = len(z)
    return _splats(
        np.column_stack([rng.uniform(-0.15, 0.15, (n, 2)), z]),
        quats=rng.normal(size=(n, 4)),
        log_scales=rng.uniform(-5, -3, (n, 3)),
        logits=rng.uniform(-1, 2, n),
        colors=rng.random((n, 3)),
    )


def opacity() -> SplatParams:
    """Rows of splats from transparent to opaque, before a wall of the same.

    Before the rows are a few opaque ones that each hide one ten times as bright as white.
    """
    rng = _rng(5)
    logits = np.array([-1000, -100, -20, -5.75, -5.5, -4, -2, 0, 2, 4, 5, 20, 100, 1000])
    x, y = np.meshgrid(np.linspace(-1.3, 1.3, len(logits)), np.linspace(-0.9, 0.9, 6))
    front = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    back = np.column_stack([y.ravel() * 1.4, x.ravel() * 0.7, np.ones(x.size)])
    few = np.column_stack([rng.uniform(-1, 1, (8, 2)), np.full(8, -0.5)])
    hidden = few + np.array([0, 0, 0.25])
    return _splats(
        np.concatenate([front, back, few, hidden]),
        log_scales=np.concatenate(
            [rng.uniform(-2.7, -1.7, (2 * x.size, 3)), np.full((8, 3), -1.5), np.full((8, 3), -2.5)]
        ),
        logits=np.concatenate([np.tile(logits, 2 * len(x)), np.full(16, 20.0)]),
        colors=np.concatenate([rng.random((2 * x.size + 8, 3)), np.full((8, 3), 10.0)]),
    )


def needles() -> SplatParams:
    """Long and far thinner than a pixel, in all directions, one axis at a time."""
    rng = _rng(6)
    log_scales = np.full((90, 3), -9.0)
    log_scales[np.arange(90), rng.integers(0, 3, 90)] = rng.uniform(-1.5, 0.5, 90)
    return _splats(
        rng.uniform(-1, 1, (90, 3)),
        quats=rng.normal(size=(90, 4)),
        log_scales=log_scales,
        logits=rng.uniform(0, 4, 90),
        colors=rng.random((90, 3)),
    )


def pancakes() -> SplatParams:
    """Flat discs, parallel to the plane z = 0 or nearly so."""
    rng = _rng(7)
    quats = np.column_stack([np.ones(60), 0.05 * rng.normal(size=(60, 3))])
    quats[::2] = [1, 0, 0, 0]
    return _splats(
        np.column_stack([rng.uniform(-1, 1, (60, 2)), rng.uniform(-0.5, 0.5, 60)]),
        quats=quats,
        log_scales=np.column_stack([rng.uniform(-2, -0.8, (60, 2)), np.full(60, -12.0)]),
        logits=rng.uniform(0, 4, 60),
        colors=rng.random((60, 3)),
    )


def huge() -> SplatParams:
    """Splats many times larger than the view, with centres in and out of it, and small ones."""
    rng = _rng(8)
    large = rng.random(80) < 0.4
    return _splats(
        rng.uniform(-1, 1, (80, 3)) * np.where(large, 12, 2)[:, None],
        quats=rng.normal(size=(80, 4)),
        log_scales=np.where(
            large[:, None], rng.uniform(0, 5, (80, 3)), rng.uniform(-2, -1, (80, 3))
        ),
        logits=np.where(large, rng.uniform(-4, -1, 80), rng.uniform(0, 3, 80)),
        colors=rng.random((80, 3)),
    )


def far() -> SplatParams:
    """A million units from the origin, at multiples of 1/16: float32 holds them, but no more."""
    rng = _rng(9)
    base = np.array([1_000_000, -800_000, 600_000])
    return _splats(
        base + np.round(rng.uniform(-20, 20, (220, 3)) * 16) / 16,
        quats=rng.normal(size=(220, 4)),
        log_scales=rng.uniform(-2, 1, (220, 3)),
        logits=rng.uniform(-1, 3, 220),
        colors=rng.random((220, 3)),
    )


def overlap() -> SplatParams:
    """Three hundred layers, each over a part of the picture; the last ones 200 times as bright."""
    rng = _rng(10)
    n = 300
    bright = np.arange(n) >= n - 40
    return _splats(
        np.column_stack([rng.uniform(-1, 1, (n, 2)), np.arange(n) / 128]),
        quats=rng.normal(size=(n, 4)),
        log_scales=rng.uniform(-1.4, -0.4, (n, 3)),
        logits=np.where(bright, 0.0, rng.uniform(-2.0, 0.5, n)),
        colors=np.where(bright[:, None], 200.0, rng.random((n, 3))),
    )


def harmonics(degree: int) -> SplatParams:
    """A shell of splats whose colour depends on the direction, with every coefficient in use."""
    rng = _rng(20 + degree)
    n = 110
    return _splats(
        0.9 * _unit(rng.normal(size=(n, 3))),
        quats=rng.normal(size=(n, 4)),
        log_scales=rng.uniform(-2.8, -1.6, (n, 3)),
        logits=rng.uniform(0, 4, n),
        sh=rng.normal(size=(n, (degree + 1) ** 2, 3)) * 0.4,
    )


def antialiased() -> SplatParams:
    """Dots and needles below the size of a pixel, whose opacity the dilation would increase."""
    rng = _rng(11)
    return _splats(
        rng.uniform(-1, 1, (200, 3)),
        quats=rng.normal(size=(200, 4)),
        log_scales=rng.uniform(-7, -2, (200, 3)),
        logits=rng.uniform(0, 6, 200),
        colors=rng.random((200, 3)),
    )


def rotations() -> SplatParams:
    """Elongated splats whose quaternions are zero, negative, tiny, or hundreds long."""
    rng = _rng(12)
    n = 80
    quats = _unit(rng.normal(size=(n, 4))) * 2.0 ** rng.integers(-8, 9, (n, 1))
    quats[::4] = 0
    return _splats(
        rng.uniform(-1, 1, (n, 3)),
        quats=quats,
        log_scales=np.array([-1.0, -2.5, -4.0]) + rng.uniform(-0.3, 0.3, (n, 3)),
        logits=rng.uniform(0, 4, n),
        colors=rng.random((n, 3)),
    )


def colors() -> SplatParams:
    """Colours far below 0 and far above 1 under translucent ones."""
    rng = _rng(13)
    n = 120
    return _splats(
        rng.uniform(-1, 1, (n, 3)),
        quats=rng.normal(size=(n, 4)),
        log_scales=rng.uniform(-2.2, -1.0, (n, 3)),
        logits=rng.uniform(-2.5, 0.5, n),
        colors=rng.choice([-20.0, -1.0, 0.0, 0.5, 1.0, 4.0], (n, 3)),
    )


def procedural() -> EvolutionTree:
    """The balls and what is around them of the procedural scene, four levels."""
    scene = make_scene(9000)
    x, y, z = scene.means.astype(np.float64).T
    inside = (np.abs(x + 1.5) < 1.1) & (np.abs(y - 0.5) < 1.1) & (z > 0) & (z < 1.9)
    return lift(scene.take(inside), 4)


def lifted() -> EvolutionTree:
    """A lifted shell, five levels, degree 1, for several tiles."""
    rng = _rng(14)
    n = 400
    shell = _splats(
        _unit(rng.normal(size=(n, 3))) * rng.uniform(0.6, 1, (n, 1)),
        quats=rng.normal(size=(n, 4)),
        log_scales=rng.uniform(-3.2, -2, (n, 3)),
        logits=rng.uniform(-1, 4, n),
        sh=rng.normal(size=(n, 4, 3)) * 0.4,
    )
    return lift(shell, 5)


def trained(name: str) -> bytes:
    """The stream of a tree that the trainer made; a vector of the suite has the same bytes."""
    return (TREES / f"trained-{name}.evogs").read_bytes()


def _splats(
    means: F64,
    *,
    quats: F64 | None = None,
    log_scales: F64,
    logits: F64,
    colors: F64 | None = None,
    sh: F64 | None = None,
) -> SplatParams:
    """Splats of rounded numbers; `colors` (n, 3) are those of degree 0."""
    if sh is None:
        assert colors is not None
        sh = ((colors - 0.5) / SH_C0)[:, None]
    if quats is None:
        quats = np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1))
    return SplatParams(
        _exact(means), _exact(quats), _exact(log_scales, 6), _exact(logits, 6), _exact(sh, 7)
    )


def _splits(level: int, slots: npt.NDArray[np.int64], psi: F64 | F32, alpha: F64) -> Step:
    """All of these slots split, with one alpha per group."""
    n = len(slots)
    return Step(
        level,
        slots.astype(np.int32),
        np.full(n, Kind.SPLIT, np.uint8),
        _exact(psi),
        np.tile(alpha[:, None], n).astype(np.float32),
        np.empty((len(psi), 0), np.float32),
    )


def _exact(values: F64 | F32, bits: int = 10) -> F32:
    """The nearest multiples of 2**-bits."""
    return np.asarray(np.round(values * 2.0**bits) / 2**bits, np.float32)


def _unit(vectors: F64) -> F64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float64)


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))
