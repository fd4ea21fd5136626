"""Cameras of `transforms*.json`: Blender / NeRF-synthetic, instant-ngp and nerfstudio.

A frame has a camera-to-world matrix, y up and z backward. Numbers of the lens may stand in a frame
or, for all frames, at the top of the file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import read_plain
from evogs_codec.render.camera import Camera, Coefficients

__all__ = ["Json", "frames_of", "load_transforms", "placed_frame"]

Json: TypeAlias = dict[str, Any]

MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
# What other lenses need; a number here that is not 0 would be lost.
UNKNOWN = ("k3", "k4", "k5", "k6")
SIDE = 800  # pixels of a picture whose size nobody says: that of NeRF-synthetic
_FLIP = np.diag([1.0, -1.0, -1.0])


def load_transforms(path: Path) -> Json:
    """The object of a file.

    Raises:
        InputError: the file is missing, or is no object in JSON.
    """
    data = read_plain(path, "missing")
    try:
        top = json.loads(data.decode("utf-8"), parse_int=float)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {shown(error)}") from error
    if not isinstance(top, dict):
        raise InputError(f"{path}: not an object with 'frames'")
    return top


def frames_of(path: Path, top: Json) -> list[Json]:
    """Objects of the frames, at least one.

    Raises:
        InputError: there is none, or one is no object.
    """
    frames = top.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: no cameras: 'frames' is missing or empty")
    for index, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise InputError(f"{path}: frame {index} is not an object")
    return frames


def placed_frame(
    where: str, top: Json, frame: Json, size: Callable[[], tuple[int, int] | None]
) -> tuple[Camera, Coefficients]:
    """The pinhole of a frame, and the distortion of its lens.

    Args:
        where: what it is called in messages.
        top: the object of the file.
        frame: that of the frame.
        size: width and height of its photograph, pixels, if there is one.

    Raises:
        InputError: the camera is impossible, its lens is of a kind that is not supported, or its
            photograph has another size.
    """
    lens = _Numbers(where, {**top, **frame})
    distortion = _distortion(where, lens, top, frame)
    rotation, translation = _pose(where, frame)
    width, height = _size(where, lens, size())
    fx, fy = _focal(where, lens, width, height)
    try:
        camera = Camera(
            width, height, fx, fy,
            lens.number("cx", width / 2), lens.number("cy", height / 2), rotation, translation,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    return camera, distortion


class _Numbers:
    """Numbers of a frame by name; what is there must be a finite number."""

    def __init__(self, where: str, values: Json) -> None:
        self.where = where
        self.values = values

    def number(self, name: str, default: float) -> float:
        found = self.find(name)
        return default if found is None else found

    def find(self, name: str) -> float | None:
        value = self.values.get(name)
        if value is None:
            return None
        if not isinstance(value, float) or not math.isfinite(value):
            found = repr(value) if isinstance(value, str | float | bool) else "no number"
            raise InputError(f"{self.where}: {name} is {shown(found)}, expected a finite number")
        return value


def _distortion(where: str, lens: _Numbers, top: Json, frame: Json) -> Coefficients:
    model = frame.get("camera_model", top.get("camera_model", "OPENCV"))
    if model not in MODELS or lens.values.get("is_fisheye"):
        kind = shown(model) if isinstance(model, str) else "of another kind than text"
        kind = "is_fisheye" if model in MODELS else kind
        raise InputError(
            f"{where}: camera model {kind} is not supported, only {', '.join(MODELS)}: undistort "
            "the photographs first"
        )
    for name in UNKNOWN:
        if lens.number(name, 0):
            raise InputError(f"{where}: {name} is not 0; of lenses only k1, k2, p1, p2 are known")
    k1, k2, p1, p2 = (lens.number(name, 0) for name in ("k1", "k2", "p1", "p2"))
    return k1, k2, p1, p2


def _pose(where: str, frame: Json) -> tuple[Any, Any]:
    """Rotation and translation, world to camera, in our axes."""
    try:
        matrix = np.array(frame.get("transform_matrix"), np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise InputError(f"{where}: 'transform_matrix' is not 4 rows of 4 numbers")
    if not np.isfinite(matrix).all():
        raise InputError(f"{where}: 'transform_matrix' has a number that is not finite")
    if len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise InputError(f"{where}: the last row of 'transform_matrix' is not 0 0 0 1")
    rotation = _FLIP @ np.clip(matrix[:3, :3], -2, 2).T  # huge ones, no rotations, stay computable
    with np.errstate(over="ignore", invalid="ignore"):  # what is too far is not finite
        return rotation, -rotation @ matrix[:3, 3]


def _size(where: str, lens: _Numbers, found: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height of the photograph, or of the camera if there is none."""
    width, height = found or (lens.number("w", SIDE), lens.number("h", SIDE))
    w, h = lens.number("w", width), lens.number("h", height)
    if w != width or h != height:
        raise InputError(
            f"{where}: the photograph has {width} x {height} pixels, its camera {w:g} x {h:g}"
        )
    if not (w == int(w) and h == int(h)):
        raise InputError(f"{where}: {w:g} x {h:g} pixels, expected whole numbers")
    return int(width), int(height)


def _focal(where: str, lens: _Numbers, width: int, height: int) -> tuple[float, float]:
    fx = lens.find("fl_x")
    fy = lens.find("fl_y")
    if fx is None and (angle := lens.find("camera_angle_x")) is not None:
        fx = _from_angle(where, "camera_angle_x", angle, width)
    if fy is None and (angle := lens.find("camera_angle_y")) is not None:
        fy = _from_angle(where, "camera_angle_y", angle, height)
    fx, fy = fx if fx is not None else fy, fy if fy is not None else fx
    if fx is None or fy is None:
        raise InputError(f"{where}: no focal length: neither fl_x nor camera_angle_x")
    return fx, fy


def _from_angle(where: str, name: str, angle: float, side: int) -> float:
    if not 1e-300 < angle < math.pi:  # half of a smaller one may be 0
        raise InputError(f"{where}: {name} is {angle}, expected radians above 0 and below pi")
    return 0.5 * side / math.tan(0.5 * angle)
