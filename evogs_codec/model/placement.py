"""Metadata that holds in the coordinates of a stream, after its splats were moved (spec 8.4).

Splats that move by x -> A x + b take the cameras with them. Their place in the world stays:
`transform` becomes what it was after the move is undone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from evogs_codec.model.splats import F64
from evogs_codec.model.viewpoint import (
    CAMERA,
    CAMERAS,
    Point,
    Viewpoint,
    default_viewpoint,
    poses,
    poses_text,
)

__all__ = ["PLACES", "placed_text"]

CRS, TRANSFORM = "crs", "transform"
PLACES = (CAMERA, CAMERAS, CRS, TRANSFORM)  # keys whose values hold in the coordinates of a stream


def placed_text(text: Mapping[str, str], linear: F64, offset: F64) -> dict[str, str]:
    """The metadata of a scene whose splats moved by x -> linear @ x + offset.

    Values that are malformed, and matrices whose numbers would be infinite, are left out where they
    would no longer hold.

    Args:
        text: of the scene before.
        linear: (3, 3) a rotation or reflection, times a positive factor.
        offset: (3,) scene units.
    """
    found = dict(text)
    if np.array_equal(linear, np.eye(3)) and not np.any(offset):
        return found
    for key in (CAMERA, CAMERAS, TRANSFORM):
        found.pop(key, None)
    camera, others = default_viewpoint(text), poses(text)
    if camera is not None:
        found[CAMERA] = str(_moved(camera, linear, offset))
    if others:
        found[CAMERAS] = poses_text([_moved(one, linear, offset) for one in others])
    matrix = _matrix(text.get(TRANSFORM, ""))
    if matrix is None and CRS in text:
        matrix = np.eye(4)
    if matrix is not None:
        move = np.eye(4)
        move[:3, :3], move[:3, 3] = linear, offset
        with np.errstate(over="ignore", invalid="ignore"):
            rows = matrix @ np.linalg.inv(move)
        rows[3] = 0, 0, 0, 1
        if np.isfinite(rows).all():
            found[TRANSFORM] = " ".join(f"{number:.17g}" for number in (rows + 0.0).ravel())
    return found


def _moved(camera: Viewpoint, linear: F64, offset: F64) -> Viewpoint:
    def point(before: Point) -> Point:
        x, y, z = (linear @ before + offset).tolist()
        return x, y, z

    up = None
    if camera.up is not None:
        x, y, z = (linear @ camera.up / np.cbrt(abs(np.linalg.det(linear)))).tolist()
        up = x, y, z
    return replace(camera, position=point(camera.position), target=point(camera.target), up=up)


def _matrix(value: str) -> F64 | None:
    """(4, 4) of a value of `transform`; None if it is malformed."""
    try:
        numbers = np.array([float(word) for word in value.split(" ")], np.float64)
    except ValueError:
        return None
    if len(numbers) != 16 or not np.isfinite(numbers).all():
        return None
    found = numbers.reshape(4, 4)
    return found if np.array_equal(found[3], [0, 0, 0, 1]) else None
