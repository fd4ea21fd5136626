"""Default cameras of streams, and cameras of files as default cameras."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.viewpoint import Viewpoint, default_viewpoint
from evogs_codec.render.camera import Camera
from evogs_codec.render.up import Direction, direction

__all__ = ["default_camera", "viewpoint_of"]


def default_camera(info: SceneInfo, up: Direction, size: int) -> Camera | None:
    """The camera that a scene says it is to be looked at from; None if it says none.

    Args:
        info: what the file says of the scene.
        up: what is up where the camera does not say.
        size: width and height in pixels.
    """
    found = default_viewpoint(info.text)
    if found is None:
        return None
    above = direction(up) if found.up is None else found.up
    try:
        return Camera.look_at(
            found.position,
            found.target,
            above,
            width=size,
            height=size,
            fov_x=math.radians(found.fov_y),
        )
    except ValueError:  # it looks straight up or down, and does not say what is up
        return None


def viewpoint_of(camera: Camera, middle: npt.ArrayLike) -> Viewpoint:
    """What is stored of a camera: its target is the point of its axis nearest to `middle`."""
    _, down, forward = camera.rotation
    eye = camera.position
    offset = np.asarray(middle, np.float64) - eye
    distance = float(offset @ forward)
    if not distance > 0:  # the middle is behind it
        distance = float(np.linalg.norm(offset)) or 1.0
    x, y, z = (eye + distance * forward).tolist()
    a, b, c = eye.tolist()
    u, v, w = (-down).tolist()
    fov_y = 2 * math.degrees(math.atan(camera.height / (2 * camera.fy)))
    return Viewpoint((a, b, c), (x, y, z), fov_y, (u, v, w))
