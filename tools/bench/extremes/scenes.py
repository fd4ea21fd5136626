"""Splats and trees at the extremes, the same numbers for the same arguments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, Kind, SplatParams, Step
from evogs_codec.model.channels import n_channels

__all__ = ["SCENES", "chain", "plain"]

Rng = np.random.Generator


def plain(n: int, seed: int = 0, degree: int = 1) -> SplatParams:
    """Splats without extremes, in a cube around the origin."""
    rng = np.random.default_rng(seed)
    return _splats(
        means=rng.uniform(-1, 1, (n, 3)),
        quats=rng.normal(size=(n, 4)),
        log_scales=rng.uniform(-6, -2, (n, 3)),
        opacity_logits=2 * rng.normal(size=n),
        sh=0.4 * rng.normal(size=(n, (degree + 1) ** 2, 3)),
    )


def city(n: int) -> SplatParams:
    """Georeferenced: a kilometre, 1e6 from the origin."""
    around = np.array([1e6, -1e6, 100.0])
    return _with(plain(n), means=around + 500 * plain(n).means.astype(np.float64))


def insect(n: int) -> SplatParams:
    """Two micrometres, in metres."""
    return _with(plain(n), means=1e-6 * plain(n).means, log_scales=plain(n).log_scales - 14)


def city_and_insect(n: int) -> SplatParams:
    """Half of each."""
    a, b = city(n - n // 2), insect(n // 2)
    names = ("means", "quats", "log_scales", "opacity_logits", "sh")
    return _splats(**{k: np.concatenate([getattr(a, k), getattr(b, k)]) for k in names})


def log_scales(n: int) -> SplatParams:
    """Standard deviations of e**-30 to e**20."""
    values = np.random.default_rng(1).uniform(-30, 20, (n, 3))
    values[:2] = [[-30, -30, 20], [20, 20, -30]]
    return _with(plain(n), log_scales=values)


def opacities(n: int) -> SplatParams:
    """Logits of -40 to 40."""
    return _with(plain(n), opacity_logits=np.linspace(-40, 40, n))


def quaternions(n: int) -> SplatParams:
    """Of every length up to 100: zero, denormal and tiny ones among them."""
    quats = plain(n).quats.astype(np.float64)
    quats *= np.resize([0.0, 1e-40, 1e-20, 1e-3, 1.0, 100.0], n)[:, None]
    return _with(plain(n), quats=quats)


def sh(n: int) -> SplatParams:
    """Coefficients of -100 to 100, and denormals."""
    values = np.random.default_rng(2).uniform(-100, 100, (n, 16, 3))
    values[0], values[1], values[2] = 100, -100, 1e-40
    return _with(plain(n), sh=values)


SCENES = {  # and the group that the extreme is in
    "city: a kilometre, 1e6 away": (city, "position"),
    "insect: 2e-6 across": (insect, "position"),
    "city and insect in one scene": (city_and_insect, "position"),
    "log-scales of -30 to 20": (log_scales, "scale"),
    "opacity logits of -40 to 40": (opacities, "opacity"),
    "quaternions: zero, denormal, 1e-20 to 100 long": (quaternions, "rotation"),
    "SH of -100 to 100, and denormal": (sh, "sh"),
}


def chain(n: int, *, size: float, alphas: npt.ArrayLike, degree: int = 0) -> EvolutionTree:
    """Three roots, and n generations of a split of slot 0, a refine of slot 1, a split of slot 2.

    Args:
        n: generations.
        size: of the roots and of psi, scene units.
        alphas: taken in turn.
        degree: of SH.
    """
    d = n_channels(degree)
    rng = np.random.default_rng(3)
    roots = size * rng.uniform(-1, 1, (d, 3)).astype(np.float32)
    alpha = np.resize(np.asarray(alphas, np.float32), n)
    steps = [Step.of_adds(0, roots)]
    for k in range(n):
        psi = (size * rng.uniform(-1, 1, (d, 3)) / n).astype(np.float32)
        kinds = np.array([Kind.SPLIT, Kind.REFINE, Kind.SPLIT], np.uint8)
        slots, of_splits = np.arange(3, dtype=np.int32), np.full((5, 2), alpha[k])
        steps.append(Step(1, slots, kinds, psi, of_splits, np.zeros((d, 0), np.float32)))
    return EvolutionTree(degree, tuple(steps))


def _with(splats: SplatParams, **arrays: npt.NDArray[Any]) -> SplatParams:
    return replace(splats, **{k: np.asarray(v, np.float32) for k, v in arrays.items()})


def _splats(**arrays: npt.NDArray[Any]) -> SplatParams:
    return SplatParams(**{k: np.asarray(v, np.float32) for k, v in arrays.items()})
