"""Files of cameras: ours, and those that trainers and tools write.

Cameras are taken in the world of the splats; no lens bends what is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.json_files import read_json
from evogs_codec.io.pictures import picture_size
from evogs_codec.io.plain_files import is_there
from evogs_codec.render.camera import Camera
from evogs_codec.render.colmap import colmap_cameras, find_model
from evogs_codec.render.transforms import frames_of, load_transforms, placed_frame

__all__ = ["load_cameras"]

_FIELDS = {"width", "height", "fx", "fy", "cx", "cy", "rotation", "translation"}
ENDINGS = ("", ".png", ".jpg", ".jpeg")  # that `file_path` of a frame may lack
IN_FOLDER = ("transforms.json", "transforms_train.json", "cameras.json")
COLMAP_STEMS = ("cameras", "images", "points3D")


def load_cameras(path: Path) -> list[Camera]:
    """The cameras of a file or folder, at least one; what they are is told by the content.

    A JSON file has what `save_cameras` wrote, the `frames` of a `transforms.json` (NeRF-synthetic,
    instant-ngp, nerfstudio), the `camera_path` of the viewer of nerfstudio, or the `cameras.json`
    that trainers write beside their splats. A folder, or a file in it, may be a COLMAP model.

    Args:
        path: of a file, or of a folder that has one of them.

    Raises:
        InputError: the file is something else, has no camera, or an impossible one.
    """
    if path.is_dir():
        return _of_folder(path)
    if path.stem in COLMAP_STEMS and path.suffix in (".bin", ".txt"):
        return colmap_cameras(path.parent)
    found = read_json(path)
    if isinstance(found, dict):
        for key, read in READERS.items():
            if key in found:
                return read(path, found)
    elif found == []:
        raise InputError(f"{path}: no camera in it")
    elif isinstance(found, list) and any(isinstance(row, dict) for row in found):
        return [_of_trainer(path, number, row) for number, row in enumerate(found)]
    raise InputError(f'{path}: is no list of cameras, {{"cameras": [...]}}')


def _of_folder(path: Path) -> list[Camera]:
    model = find_model(path)
    if model is not None:
        return colmap_cameras(model)
    for name in IN_FOLDER:
        if is_there(path / name):
            return load_cameras(path / name)
    expected = ", ".join(IN_FOLDER)
    raise InputError(f"{path}: no cameras: expected {expected} or a COLMAP model (sparse/0)")


# --- ours -----------------------------------------------------------------------------------------


def _ours(path: Path, found: dict[str, Any]) -> list[Camera]:
    rows = found["cameras"]
    if not isinstance(rows, list):
        raise InputError(f'{path}: is no list of cameras, {{"cameras": [...]}}')
    if not rows:
        raise InputError(f"{path}: no camera in it")
    return [_camera(path, number, row) for number, row in enumerate(rows)]


def _camera(path: Path, number: int, row: object) -> Camera:
    if not isinstance(row, dict) or set(row) != _FIELDS:
        names = ", ".join(sorted(_FIELDS))
        raise InputError(f"{path}: camera {number} is no object of {names}")
    return _made(path, number, lambda: Camera(**row))


def _made(path: Path, number: int, make: Callable[[], Camera]) -> Camera:
    try:
        return make()
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        said = f"{error.args[0]} is missing" if isinstance(error, KeyError) else error
        raise InputError(f"{path}: camera {number}: {shown(said)}") from error


# --- of others ------------------------------------------------------------------------------------


def _of_transforms(path: Path, _found: dict[str, Any]) -> list[Camera]:
    """Frames; where neither file nor photograph says a size, that of NeRF-synthetic."""
    top = load_transforms(path)
    cameras = []
    for index, frame in enumerate(frames_of(path, top)):
        name = frame.get("file_path")
        where = f"{path}: frame {index}" + (f" ({shown(name)})" if isinstance(name, str) else "")
        size = partial(_size_of_frame, path, {**top, **frame})
        cameras.append(placed_frame(where, top, frame, size)[0])
    return cameras


def _size_of_frame(path: Path, known: dict[str, Any]) -> tuple[int, int] | None:
    """Of the photograph of a frame, if it is there and the file says no size."""
    name = known.get("file_path")
    if {"w", "h"} <= set(known) or not isinstance(name, str):
        return None
    sizes = (picture_size(path.parent / f"{name}{ending}") for ending in ENDINGS)
    return next((one for one in sizes if one), None)


def _of_path(path: Path, found: dict[str, Any]) -> list[Camera]:
    """A path through a scene, as the viewer of nerfstudio exports it."""
    rows, kind = found["camera_path"], found.get("camera_type", "perspective")
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: no cameras: 'camera_path' is no list, or is empty")
    if kind != "perspective":
        raise InputError(f"{path}: cameras are of type {shown(kind)}, only perspective is known")

    def camera(row: dict[str, Any]) -> Camera:
        width, height = found["render_width"], found["render_height"]
        if not (width > 0 and height > 0):
            raise ValueError(f"{width} x {height} pixels, expected 1 or more a side")
        matrix = np.array(row["camera_to_world"], np.float64)
        if matrix.size != 16 or not np.isfinite(matrix).all():
            raise ValueError("camera_to_world is not 16 finite numbers")
        angle = math.radians(row["fov"])  # from the top to the bottom
        if not 0 < angle < math.pi:
            raise ValueError(f"fov is {row['fov']}, expected degrees above 0 and below 180")
        fov_x = 2 * math.atan(math.tan(angle / 2) * width / height)
        return Camera.from_blender(matrix.reshape(4, 4), fov_x, width=width, height=height)

    return [_each(path, number, row, camera) for number, row in enumerate(rows)]


def _of_trainer(path: Path, number: int, row: object) -> Camera:
    """A row of the `cameras.json` that INRIA's trainer writes: camera to world, our axes."""

    def camera(row: dict[str, Any]) -> Camera:
        width, height = row["width"], row["height"]
        rotation = np.array(row["rotation"], np.float64).T
        position = np.array(row["position"], np.float64)
        if rotation.shape != (3, 3) or position.shape != (3,):
            raise ValueError("rotation and position are not 3 x 3 and 3 numbers")
        middle = row.get("cx", width / 2), row.get("cy", height / 2)
        return Camera(width, height, row["fx"], row["fy"], *middle, rotation, -rotation @ position)

    return _each(path, number, row, camera)


def _each(path: Path, number: int, row: object, make: Callable[[dict[str, Any]], Camera]) -> Camera:
    if not isinstance(row, dict):
        raise InputError(f"{path}: camera {number} is no object")
    with np.errstate(over="ignore", invalid="ignore"):  # of huge numbers, which are refused
        return _made(path, number, lambda: make(row))


READERS: dict[str, Callable[[Path, dict[str, Any]], list[Camera]]] = {
    "cameras": _ours,
    "frames": _of_transforms,
    "camera_path": _of_path,
}
