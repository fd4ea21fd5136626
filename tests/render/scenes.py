"""Scenes and cameras that several tests look at."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from evogs_codec import SplatParams
from evogs_codec.render import Camera, orbit

BACKGROUND = (0.2, 0.5, 1.0)


def ball(n, seed=0, *, size=0.05, degree=3):
    """Random splats in a shell of radius 0.6 to 1, of every shape and opacity."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    k = (degree + 1) ** 2
    return SplatParams(
        means=f32(directions * (0.6 + 0.4 * rng.random((n, 1)))),
        quats=f32(rng.normal(size=(n, 4))),
        log_scales=f32(np.log(size) + 0.7 * rng.normal(size=(n, 3))),
        opacity_logits=f32(2 * rng.normal(size=n)),
        sh=f32(0.4 * rng.normal(size=(n, k, 3))),
    )


def camera(size=64, height=None):
    """One that sees the ball from outside, not in the middle."""
    view = orbit(7, radius=2.5, width=size, height=height or size, fov_x=0.8)[2]
    return dataclasses.replace(view, cx=view.cx + 0.07 * size, cy=view.cy - 0.03 * size)


def facing(width=48, height=32):
    """A camera at the origin that looks along z, one unit of focal length per pixel of width."""
    return Camera(width, height, width, width, width / 2, height / 2, np.eye(3), np.zeros(3))


def row(n=1, *, mean=(0, 0, 3), quat=(1, 0, 0, 0), log_scale=(-3, -3, -3), logit=2.0, colour=1.0):
    """n equal splats."""
    return SplatParams(
        means=np.tile(f32(mean), (n, 1)),
        quats=np.tile(f32(quat), (n, 1)),
        log_scales=np.tile(f32(log_scale), (n, 1)),
        opacity_logits=np.full(n, logit, np.float32),
        sh=np.full((n, 1, 3), colour, np.float32),
    )


def joined(*parts):
    """The splats of all parts, their SH coefficients padded with zeros."""
    most = max(part.sh.shape[1] for part in parts)
    padded = [
        changed(part, sh=np.pad(part.sh, ((0, 0), (0, most - part.sh.shape[1]), (0, 0))))
        for part in parts
    ]
    return SplatParams(
        *(np.concatenate([getattr(part, name) for part in padded]) for name in FIELDS)
    )


def changed(splats, **fields):
    return dataclasses.replace(splats, **fields)


def as_float64(splats):
    """The same numbers in float64, which SplatParams does not hold."""
    return SimpleNamespace(**{name: getattr(splats, name).astype(np.float64) for name in FIELDS})


def f32(values):
    return np.asarray(values, np.float32)


FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
EMPTY = ball(0)
