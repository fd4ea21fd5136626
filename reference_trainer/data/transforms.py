"""Cameras of `transforms*.json`: Blender / NeRF-synthetic, instant-ngp and nerfstudio.

A frame has a camera-to-world matrix, y up and z backward. Numbers of the lens may stand in a frame
or, for all frames, at the top of the file.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.render.camera import Camera
from reference_trainer.data.distortion import Coefficients
from reference_trainer.data.photograph import ENDINGS, Photograph, image_size, name_of
from reference_trainer.data.plain_files import first_there, read_plain

__all__ = ["Transforms", "read_transforms"]

Json: TypeAlias = dict[str, Any]

MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
# What other lenses need; a number here that is not 0 would be lost.
UNKNOWN = ("k3", "k4", "k5", "k6")
_FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Transforms:
    """One file.

    Attributes:
        photographs: in the order of the file.
        missing: paths of those of which there is no file, by name.
        test: names of those that the file itself holds out.
        points: the `.ply` file that it names, if any.
    """

    photographs: list[Photograph]
    missing: dict[str, Path]
    test: frozenset[str]
    points: Path | None


def read_transforms(path: Path) -> Transforms:
    """All cameras of a file; photographs are looked at, not yet decoded.

    Raises:
        InputError: the file is no list of cameras, a camera is impossible, its lens is of a kind
            that is not supported, or its photograph is no picture or of another size.
    """
    top = _load(path)
    frames = top.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: no cameras: 'frames' is missing or empty")
    photographs, missing = [], {}
    for index, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise InputError(f"{path}: frame {index} is not an object")
        file_path = frame.get("file_path")
        if not isinstance(file_path, str):
            raise InputError(f"{path}: frame {index} has no 'file_path'")
        image = _image(path.parent / file_path)
        if image is None:
            missing[name_of(file_path)] = path.parent / file_path
            continue
        where = f"{path}: frame {index} ({shown(file_path)})"
        photographs.append(_photograph(where, top, frame, image))
    return Transforms(photographs, missing, _test_names(path, top), _points(path, top))


def _load(path: Path) -> Json:
    data = read_plain(path, "missing")
    try:
        top = json.loads(data.decode("utf-8"), parse_int=float)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {shown(error)}") from error
    if not isinstance(top, dict):
        raise InputError(f"{path}: not an object with 'frames'")
    return top


def _photograph(where: str, top: Json, frame: Json, image: Path) -> Photograph:
    lens = _Numbers(where, {**top, **frame})
    distortion = _distortion(where, lens, top, frame)
    rotation, translation = _pose(where, frame)
    width, height = _size(where, lens, image)
    fx, fy = _focal(where, lens, width, height)
    try:
        camera = Camera(
            width, height, fx, fy,
            lens.number("cx", width / 2), lens.number("cy", height / 2), rotation, translation,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    return Photograph(name_of(frame["file_path"]), image, camera, distortion)


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


def _image(path: Path) -> Path | None:
    """The file, if there is one; Blender leaves its ending out.

    Raises:
        InputError: what is there is no file.
    """
    return first_there([path, *(Path(f"{path}{ending}") for ending in ENDINGS)], "picture")


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


def _size(where: str, lens: _Numbers, image: Path) -> tuple[int, int]:
    width, height = image_size(image)
    w, h = lens.number("w", width), lens.number("h", height)
    if w != width or h != height:
        raise InputError(
            f"{where}: the photograph has {width} x {height} pixels, its camera {w:g} x {h:g}"
        )
    return width, height


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


def _test_names(path: Path, top: Json) -> frozenset[str]:
    """Photographs that nerfstudio's split holds out."""
    for key in ("test_filenames", "val_filenames"):
        names = top.get(key)
        if names is not None and not (
            isinstance(names, list) and all(isinstance(name, str) for name in names)
        ):
            raise InputError(f"{path}: '{key}' is not a list of names")
        if names:
            return frozenset(name_of(name) for name in names)
    return frozenset()


def _points(path: Path, top: Json) -> Path | None:
    name = top.get("ply_file_path")
    return path.parent / name if isinstance(name, str) else None
