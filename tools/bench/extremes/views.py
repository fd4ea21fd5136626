"""Splats in front of cameras, at the extremes; the same numbers for the same arguments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams
from evogs_codec.render import Camera
from tools.bench.extremes.scenes import plain

__all__ = ["VIEWS", "ball", "facing", "row"]

Scene = tuple[SplatParams, Camera]
NEAR_PLANE = 0.2  # of the rasterizer


def facing(width: int = 48, height: int = 32) -> Camera:
    """A camera at the origin that looks along z, a unit of focal length per pixel of width."""
    return Camera(width, height, width, width, width / 2, height / 2, np.eye(3), np.zeros(3))


def row(
    means: npt.ArrayLike,
    *,
    quats: npt.ArrayLike = (1, 0, 0, 0),
    log_scales: npt.ArrayLike = (-3, -3, -3),
    logit: float = 2.0,
    color: npt.ArrayLike = 1.0,
) -> SplatParams:
    """A splat for each of (n, 3) places, alike in what is given once."""
    places = np.asarray(means, np.float32).reshape(-1, 3)
    n = len(places)
    return SplatParams(
        places,
        np.broadcast_to(np.asarray(quats, np.float32), (n, 4)).copy(),
        np.broadcast_to(np.asarray(log_scales, np.float32), (n, 3)).copy(),
        np.full(n, logit, np.float32),
        np.broadcast_to(np.asarray(color, np.float32), (n, 1, 3)).copy(),
    )


def ball(n: int, degree: int = 1) -> SplatParams:
    """Splats without extremes around a point that `facing` looks at."""
    splats = plain(n, seed=5, degree=degree)
    means = splats.means + np.array([0, 0, 3], np.float32)
    scales = splats.log_scales + 1.5
    return replace(splats, means=means, log_scales=scales)


def needles(n: int) -> Scene:
    """e**20 long and e**-9 thick, at angles of 0 to 0.3 to the line of sight."""
    angles = np.append(np.geomspace(1e-9, 0.3, n - 1), 0.0)
    return _turned(n, angles, (-9, -9, 20)), facing()


def pancakes(n: int) -> Scene:
    """e**20 wide and e**-30 thick, edge on but for 0 to 0.3."""
    angles = np.pi / 2 - np.append(np.geomspace(1e-9, 0.3, n - 1), 0.0)
    return _turned(n, angles, (20, 20, -30)), facing()


def log_scales(n: int) -> Scene:
    """Standard deviations of e**-30 to e**20, in every direction."""
    values = np.random.default_rng(1).uniform(-30, 20, (n, 3))
    return replace(ball(n), log_scales=values.astype(np.float32)), facing()


def at_the_near_plane(n: int) -> Scene:
    """Depths just past the near plane, in the picture and far to its sides, some of them large."""
    rng = np.random.default_rng(2)
    z = np.nextafter(np.float32(NEAR_PLANE), np.float32(1)) * np.geomspace(1, 2, n)
    means = np.stack([rng.normal(0, 0.1, n), rng.normal(0, 0.1, n), z], axis=1)
    means[::5, :2] *= 1e3
    scales = rng.uniform(-6, 2, (n, 3)).astype(np.float32)
    return replace(ball(n), means=means.astype(np.float32), log_scales=scales), facing()


def at_the_camera(n: int) -> Scene:
    """At the camera, behind it, on the near plane; and others in front."""
    splats, camera = at_the_near_plane(n)
    means = splats.means.copy()
    means[::4] = 0
    means[1::4, 2] *= -1
    means[2::4, 2] = np.float32(NEAR_PLANE)
    return replace(splats, means=means), camera


def opacities(n: int) -> Scene:
    """Logits of -40 to 40."""
    logits = np.random.default_rng(3).permutation(np.linspace(-40, 40, n))
    return replace(ball(n), opacity_logits=logits.astype(np.float32)), facing()


def quaternions(n: int) -> Scene:
    """Zero, denormal, tiny and huge ones."""
    splats = ball(n)
    lengths = np.resize([0.0, 1e-40, 1e-20, 1.0, 1e20, 1e37], n)
    quats = splats.quats.astype(np.float64) * lengths[:, None]
    return replace(splats, quats=quats.astype(np.float32)), facing()


def sh(n: int) -> Scene:
    """Coefficients of -100 to 100, degree 3."""
    values = np.random.default_rng(4).uniform(-100, 100, (n, 16, 3))
    return replace(ball(n), sh=values.astype(np.float32)), facing()


def one_pixel(n: int) -> Scene:
    """A picture of 1 x 1."""
    return ball(min(n, 8)), facing(1, 1)


def far_from_the_origin(n: int) -> Scene:
    """Camera and splats 1e6 from the origin."""
    splats, camera = ball(n), facing()
    place = np.array([1e6, -1e6, 1e6])
    # binary32 has steps of 1/16 there: the splats spread over more than that.
    means = (place + 8 * splats.means.astype(np.float64)).astype(np.float32)
    scales = splats.log_scales + 2
    rotation = _rotation(0.3) @ camera.rotation
    back = place + 24 * np.array([0, 0, 1]) - rotation.T @ np.array([0, 0, 24.0])
    turned = replace(camera, rotation=rotation, translation=-rotation @ back)
    return replace(splats, means=means, log_scales=scales), turned


def far_from_the_camera(n: int) -> Scene:
    """A scene 1e6 away, through a lens of 3e5 times the focal length; deep, since depths tell."""
    splats, camera = ball(n), facing()
    means = splats.means.astype(np.float64) * [1, 1, 1e5]
    means[:, 2] += 7e5
    lens = replace(camera, fx=camera.fx * 3e5, fy=camera.fy * 3e5)
    return replace(splats, means=means.astype(np.float32)), lens


def small(n: int) -> Scene:
    """A scene 2e-6 across through a lens of 1e6 times the focal length; deep, as above."""
    splats, camera = ball(n), facing()
    means = splats.means.astype(np.float64) * [1e-6, 1e-6, 0.25]
    lens = replace(camera, fx=camera.fx * 3e5, fy=camera.fy * 3e5)
    scales = splats.log_scales - 14
    return replace(splats, means=means.astype(np.float32), log_scales=scales), lens


VIEWS: dict[str, Callable[[int], Scene]] = {
    "needles of e^20 along the line of sight": needles,
    "pancakes of e^20, edge on": pancakes,
    "log-scales of -30 to 20": log_scales,
    "just past the near plane, also far aside": at_the_near_plane,
    "at the camera, behind it, on the near plane": at_the_camera,
    "opacity logits of -40 to 40": opacities,
    "quaternions: zero, 1e-40 to 1e37 long": quaternions,
    "SH of -100 to 100": sh,
    "a picture of 1 x 1": one_pixel,
    "camera and scene 1e6 from the origin": far_from_the_origin,
    "scene 1e6 from the camera": far_from_the_camera,
    "scene 2e-6 across": small,
}


def _turned(n: int, angles: npt.NDArray[np.float64], log_scales: npt.ArrayLike) -> SplatParams:
    """Splats near the middle of the picture, their last axis at these angles to z."""
    rng = np.random.default_rng(6)
    across = rng.uniform(0, 2 * np.pi, n)
    half = angles / 2
    axis = np.sin(half) * np.stack([np.cos(across), np.sin(across)])
    quats = np.stack([np.cos(half), *axis, np.zeros(n)], axis=1)
    means = rng.uniform([-1, -1, 2], [1, 1, 4], (n, 3))
    color = rng.uniform(-1, 1, (n, 1, 3))
    return row(means, quats=quats, log_scales=log_scales, logit=-1.0, color=color)


def _rotation(angle: float) -> npt.NDArray[np.float64]:
    """About the y axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
