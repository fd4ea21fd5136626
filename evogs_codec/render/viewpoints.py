"""Where cameras stand when nobody names any: on circles around what a scene is about."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from evogs_codec.model.splats import SplatParams
from evogs_codec.render.camera import Camera, orbit
from evogs_codec.render.framing import Bulk, bulk_of, focus_of
from evogs_codec.render.up import Direction, direction, up_of

__all__ = [
    "N_ORBIT",
    "PICTURE_SIZE",
    "SIZE",
    "camera_rings",
    "cameras_all_around",
    "cameras_around",
    "most_different",
    "n_on_circle",
    "share_shown",
    "weighing_cameras",
]

N_ORBIT = 24
SIZE = 400  # pixels, width and height of a view that is measured
PICTURE_SIZE = 800  # of one that is looked at
ELEVATION, DISTANCE = 0.35, 2.0  # of the default cameras, as of `cameras_around`
# Number, elevation and distance of the cameras of a circle, as of `cameras_around`. No elevation
# is that of the 24 cameras which judge.
RINGS = ((9, 0.05, 1.7), (11, 0.2, 2.4), (11, 0.5, 1.9), (9, 0.8, 2.2))
# For the integers of a stream, which may not err elsewhere, from below and from far above, too.
OUTSIDE = ((16, -0.6, 1.7), (12, 1.2, 2.2))
# Of six cameras that weigh errors one stands below and one far above: elevation and distance.
ONE_OF = 6
BELOW, ABOVE = (-0.5, 2.0), (1.1, 2.0)
N_SAMPLED = 5_000  # splats of which `share_shown` tells how many are shown


def cameras_around(
    scene: SplatParams,
    up: Direction | None = None,
    size: int | None = None,
    *,
    n: int = N_ORBIT,
    elevation: float = ELEVATION,
    distance: float = DISTANCE,
) -> list[Camera]:
    """Cameras on a circle around the bulk of a scene, or the detail in it (`focus_of`).

    Args:
        scene: what the cameras look at; splats that are not finite do not count.
        up: what is up in the views: x, y or z, perhaps with a minus, or a vector; by default as
            `up_of` estimates it.
        size: width and height in pixels; `SIZE` by default.
        n: number of cameras.
        elevation: radians above the middle.
        distance: from the middle, in diagonals of what they look at, or in standard deviations of a
            splat where all splats are in one place.

    Raises:
        ValueError: the scene is empty.
    """
    return _around(focus_of(scene), scene, up, size, n, elevation, distance)


def _around(
    bulk: Bulk,
    scene: SplatParams,
    up: Direction | None,
    size: int | None,
    n: int,
    elevation: float,
    distance: float,
) -> list[Camera]:
    """`cameras_around` a part of a scene."""
    reach = bulk.size
    if reach == 0:
        reach = math.exp(float(np.clip(np.median(scene.log_scales), -30, 30)))
    above = up_of(scene).vector if up is None else direction(up)
    side = SIZE if size is None else size
    return orbit(
        n,
        bulk.middle,
        radius=distance * reach,
        elevation=elevation,
        up=above,
        width=side,
        height=side,
        fov_x=math.radians(45),
    )


def camera_rings(scene: SplatParams, up: Direction | None = None) -> list[Camera]:
    """40 cameras around the bulk of a scene, at four elevations and distances.

    They are for gradient descent: none stands where a camera of `cameras_around` does.
    """
    return _on_rings(RINGS, scene, up)


def cameras_all_around(scene: SplatParams, up: Direction | None = None) -> list[Camera]:
    """108 cameras: 80 where those of `camera_rings` are, 16 below the scene and 12 far above it.

    What descent moves may not look worse from where nobody looked.
    """
    twice = [(2 * n, elevation, distance) for n, elevation, distance in RINGS]
    return _on_rings([*twice, *OUTSIDE], scene, up)


def _on_rings(
    rings: Sequence[tuple[int, float, float]], scene: SplatParams, up: Direction | None
) -> list[Camera]:
    """So many cameras at each elevation and distance."""
    above = up_of(scene).vector if up is None else direction(up)
    return [
        camera
        for n, elevation, distance in rings
        for camera in cameras_around(scene, above, n=n, elevation=elevation, distance=distance)
    ]


def most_different(cameras: Sequence[Camera], n: int) -> list[Camera]:
    """At most n of the cameras, which stand apart and look other ways, whatever their order.

    The first is nearest to the middle of all. Each of the others is the one that differs most from
    those before it: by the angle between their axes in radians, and by their distance in that of
    most cameras from the middle.
    """
    n = min(n, len(cameras))
    if not n:
        return []
    eyes = np.array([camera.position for camera in cameras])
    axes = np.array([camera.rotation[2] for camera in cameras])
    away = np.linalg.norm(eyes - np.median(eyes, axis=0), axis=1)
    unit = max(float(np.median(away)), 1e-30)
    rows = np.lexsort((*axes.T, *eyes.T, away))
    found = [int(rows[0])]
    least = np.full(len(cameras), np.inf)
    while len(found) < n:
        angles = np.arccos(np.clip(axes @ axes[found[-1]], -1, 1))
        least = np.minimum(least, angles + np.linalg.norm(eyes - eyes[found[-1]], axis=1) / unit)
        found.append(int(rows[np.argmax(least[rows])]))
    return [cameras[k] for k in found]


def share_shown(scene: SplatParams, cameras: Sequence[Camera]) -> float:
    """What part of the splats has its centre in some of the pictures, by a sample of them."""
    points = scene.means[:: max(1, len(scene) // N_SAMPLED)].astype(np.float64)
    shown = np.zeros(len(points), bool)
    for camera in cameras:
        x, y, z = camera.rotation @ points.T + camera.translation[:, None]
        is_before = z > 0
        z = np.where(is_before, z, 1.0)
        across, down = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        is_in = (across >= 0) & (across < camera.width) & (down >= 0) & (down < camera.height)
        shown |= is_before & is_in
    return float(np.mean(shown)) if len(shown) else 1.0


def n_on_circle(n: int) -> int:
    """How many of n `weighing_cameras`, the first of them, stand on the circle."""
    return n - 2 * (n // ONE_OF)


def weighing_cameras(scene: SplatParams, up: Direction | None = None, n: int = 12) -> list[Camera]:
    """Cameras by which errors are weighed, n of them: most on the circle of `cameras_around`.

    Of six, one stands below the scene and one far above it. A splat that the circle does not show
    is seen from there, or it is worth nothing. Where the circle is around detail in a scene, these
    two stand on a circle around the whole, which is seen from there.
    """
    above = up_of(scene).vector if up is None else direction(up)
    n_each = n // ONE_OF
    circle = cameras_around(scene, above, n=n_on_circle(n))
    whole = bulk_of(scene)
    if whole is not focus_of(scene):
        return circle + _around(whole, scene, above, None, 2 * n_each, ELEVATION, DISTANCE)
    others = [
        camera
        for elevation, distance in (BELOW, ABOVE)
        for camera in cameras_around(scene, above, n=n_each, elevation=elevation, distance=distance)
    ]
    return circle + others
