"""Where cameras stand when nobody names any: on circles around the bulk of a scene."""

from __future__ import annotations

import math

import numpy as np

from evogs_codec.model.splats import SplatParams
from evogs_codec.render.camera import Camera, orbit

__all__ = ["N_ORBIT", "SIZE", "camera_rings", "cameras_around"]

N_ORBIT = 24
SIZE = 400  # pixels, width and height of a view
# Number, elevation and distance of the cameras of a circle, as of `cameras_around`. No elevation
# is that of the 24 cameras which judge.
RINGS = ((9, 0.05, 1.7), (11, 0.2, 2.4), (11, 0.5, 1.9), (9, 0.8, 2.2))
BULK = (20, 80)  # percentiles of the positions: what is far away does not decide the distance


def cameras_around(
    scene: SplatParams,
    up: str = "z",
    size: int | None = None,
    *,
    n: int = N_ORBIT,
    elevation: float = 0.35,
    distance: float = 2.0,
) -> list[Camera]:
    """Cameras on a circle around the bulk of a scene.

    Args:
        scene: what the cameras look at; splats that are not finite do not count.
        up: axis that is up in the views: x, y or z, perhaps with a minus.
        size: width and height in pixels; `SIZE` by default.
        n: number of cameras.
        elevation: radians above the middle.
        distance: from the middle, in diagonals of the bulk, or in standard deviations of a splat
            where all splats are in one place.

    Raises:
        ValueError: the scene is empty.
    """
    means = scene.means[np.isfinite(scene.means).all(axis=1)].astype(np.float64)
    if not len(means):
        raise ValueError("the scene is empty: name the cameras")
    low, high = np.percentile(means, BULK, axis=0)
    bulk = float(np.linalg.norm(high - low))
    if bulk == 0:
        bulk = math.exp(float(np.clip(np.median(scene.log_scales), -30, 30)))
    sign = -1.0 if up.startswith("-") else 1.0
    side = SIZE if size is None else size
    return orbit(
        n,
        (low + high) / 2,
        radius=distance * bulk,
        elevation=elevation,
        up=tuple(sign * np.eye(3)["xyz".index(up[-1])]),
        width=side,
        height=side,
        fov_x=math.radians(45),
    )


def camera_rings(scene: SplatParams, up: str = "z", times: int = 1) -> list[Camera]:
    """`times` 40 cameras around the bulk of a scene, at four elevations and distances.

    They are for gradient descent: none stands where a camera of `cameras_around` does.
    """
    return [
        camera
        for n, elevation, distance in RINGS
        for camera in cameras_around(scene, up, n=times * n, elevation=elevation, distance=distance)
    ]
