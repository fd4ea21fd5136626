"""Cameras: pinholes, world to camera, x right, y down, z forward; and the conventions of others.

COLMAP uses ours. Blender, NeRF and OpenGL give camera to world with y up and z backward.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.io.files import write_atomic
from evogs_codec.render.options import Options

__all__ = ["Camera", "Coefficients", "Vector", "as_json", "orbit", "save_cameras"]

F64 = npt.NDArray[np.float64]
Vector = Sequence[float] | npt.NDArray[np.floating]
Coefficients: TypeAlias = tuple[float, float, float, float]  # k1, k2, p1, p2 of a lens (OpenCV)

MAX_SIDE = 1 << 15
_ROTATION_TOLERANCE = 1e-4  # what published cameras, rounded to a few digits, stay within
_FLIP = np.diag([1.0, -1.0, -1.0])  # y up and z backward to ours


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: pixel = (fx x/z + cx, fy y/z + cy) of (x, y, z) = rotation p + translation.

    Attributes:
        width, height: pixels; the centre of the top left one is at (0.5, 0.5).
        fx, fy, cx, cy: focal lengths and principal point, pixels.
        rotation: (3, 3) world to camera.
        translation: (3,) the world's origin, seen from the camera.

    Raises:
        TypeError: on construction, a focal length or the principal point is no number.
        ValueError: on construction, a number is out of range, or the rotation is none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: F64
    translation: F64

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, _float(name, getattr(self, name)))
        for name, shape in (("rotation", (3, 3)), ("translation", (3,))):
            array = np.array(getattr(self, name), np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(f"{name} is not {shape} finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not all(type(side) is int for side in (self.width, self.height)):
            raise ValueError(f"{self.width} x {self.height} pixels, expected whole numbers")
        if not (1 <= self.width <= MAX_SIDE and 1 <= self.height <= MAX_SIDE):
            raise ValueError(f"{self.width} x {self.height} pixels, expected 1..{MAX_SIDE} a side")
        if not (0 < self.fx < math.inf and 0 < self.fy < math.inf):
            raise ValueError(f"focal lengths {self.fx}, {self.fy} are not positive")
        if not (math.isfinite(self.cx) and math.isfinite(self.cy)):
            raise ValueError(f"principal point {self.cx}, {self.cy} is not finite")
        with np.errstate(over="ignore", invalid="ignore"):  # of huge numbers, which are none
            error = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if not error <= _ROTATION_TOLERANCE or np.linalg.det(self.rotation) < 0:
            raise ValueError("rotation is not a rotation matrix")

    @property
    def position(self) -> F64:
        """(3,) centre of projection in the world."""
        return -self.rotation.T @ self.translation

    def view(self, options: Options) -> F64:
        """(25,) what the kernels need to know, as one array; `projection` names the entries."""
        limits_x = self.cx / self.fx, (self.width - self.cx) / self.fx
        limits_y = self.cy / self.fy, (self.height - self.cy) / self.fy
        margin_x, margin_y = 0.15 * self.width / self.fx, 0.15 * self.height / self.fy
        return np.array(
            [
                *self.rotation.ravel(),
                *self.translation,
                *(self.fx, self.fy, self.cx, self.cy),
                *self.position,
                *(-limits_x[0] - margin_x, limits_x[1] + margin_x),
                *(-limits_y[0] - margin_y, limits_y[1] + margin_y),
                *(options.near, options.dilation),
            ]
        )

    def resized(self, width: int, height: int) -> Camera:
        """The same view in other pixels."""
        x, y = width / self.width, height / self.height
        return Camera(
            width, height, self.fx * x, self.fy * y, self.cx * x, self.cy * y,
            self.rotation, self.translation,
        )  # fmt: skip

    def within(self, pixels: int) -> Camera:
        """The same view whose longer side has at most this many pixels."""
        part = pixels / max(self.width, self.height)
        if part >= 1:
            return self
        return self.resized(*(max(1, round(part * side)) for side in (self.width, self.height)))

    @staticmethod
    def look_at(
        eye: Vector,
        target: Vector,
        up: Vector = (0.0, 0.0, 1.0),
        *,
        width: int,
        height: int,
        fov_x: float,
    ) -> Camera:
        """A camera at `eye`, `target` in the middle and `up` upwards; `fov_x` in radians.

        Raises:
            ValueError: these make no frame, or `fov_x` is not between 0 and pi.
        """
        forward = np.asarray(target, np.float64) - np.asarray(eye, np.float64)
        right = np.cross(forward, np.asarray(up, np.float64))
        if not (np.linalg.norm(forward) > 0 and np.linalg.norm(right) > 0):
            raise ValueError("eye, target and up do not make a frame")
        down = np.cross(forward, right)
        rotation = np.stack([axis / np.linalg.norm(axis) for axis in (right, down, forward)])
        return _centred(width, height, fov_x, rotation, -rotation @ np.asarray(eye, np.float64))

    @staticmethod
    def from_blender(
        camera_to_world: npt.ArrayLike, fov_x: float, *, width: int, height: int
    ) -> Camera:
        """From `transform_matrix` (3 or 4, 4) and `camera_angle_x` of a NeRF-synthetic file."""
        matrix = np.asarray(camera_to_world, np.float64)
        rotation = _FLIP @ matrix[:3, :3].T
        return _centred(width, height, fov_x, rotation, -rotation @ matrix[:3, 3])

    @staticmethod
    def from_colmap(
        quaternion: Vector, translation: Vector, intrinsics: Vector, *, width: int, height: int
    ) -> Camera:
        """From qw qx qy qz, tx ty tz of an image, and fx fy cx cy or f cx cy of its camera.

        Raises:
            ValueError: there are neither 3 nor 4 intrinsics, or as of `Camera`.
        """
        w, x, y, z = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
        rotation = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        if len(intrinsics) not in (3, 4):
            raise ValueError(f"{len(intrinsics)} intrinsics: SIMPLE_PINHOLE has 3, PINHOLE 4")
        fx, fy = (float(intrinsics[i]) for i in ((0, 0) if len(intrinsics) == 3 else (0, 1)))
        cx, cy = float(intrinsics[-2]), float(intrinsics[-1])
        return Camera(
            width, height, fx, fy, cx, cy, np.array(rotation), np.asarray(translation, np.float64)
        )


def _centred(width: int, height: int, fov_x: float, rotation: F64, translation: F64) -> Camera:
    slope = math.tan(0.5 * fov_x) if 0 < fov_x < math.pi else 0.0
    if slope <= 0:
        raise ValueError(f"fov_x is {fov_x:g} radians, expected above 0 and below pi")
    focal = 0.5 * width / slope
    return Camera(width, height, focal, focal, width / 2, height / 2, rotation, translation)


def orbit(
    n: int,
    target: Vector = (0.0, 0.0, 0.0),
    *,
    radius: float,
    elevation: float = 0.5,
    up: Vector = (0.0, 0.0, 1.0),
    width: int,
    height: int,
    fov_x: float,
) -> list[Camera]:
    """`n` cameras on a circle around `target`, `elevation` radians above its plane.

    Raises:
        ValueError: `up` is 0, or as of `Camera.look_at`.
    """
    length = np.linalg.norm(up)
    if not length > 0:
        raise ValueError(f"up is {list(up)}, expected a vector that is not 0")
    pole = np.asarray(up, np.float64) / length
    east = np.cross(pole, np.eye(3)[int(np.argmin(np.abs(pole)))])
    east /= np.linalg.norm(east)
    north = np.cross(pole, east)
    cameras = []
    for turn in 2 * math.pi * np.arange(n) / max(n, 1):
        level = math.cos(elevation) * (math.cos(turn) * east + math.sin(turn) * north)
        eye = np.asarray(target, np.float64) + radius * (level + math.sin(elevation) * pole)
        cameras.append(Camera.look_at(eye, target, pole, width=width, height=height, fov_x=fov_x))
    return cameras


def save_cameras(path: Path, cameras: Sequence[Camera]) -> None:
    """Write a list of cameras as JSON, every number exactly.

    Raises:
        OSError: the file cannot be written; what was there stays.
    """
    write_atomic(path, as_json(cameras).encode())


def as_json(cameras: Sequence[Camera]) -> str:
    """What `save_cameras` writes."""
    rows = [
        {
            **{name: int(getattr(c, name)) for name in ("width", "height")},
            **{name: float(getattr(c, name)) for name in ("fx", "fy", "cx", "cy")},
            "rotation": c.rotation.tolist(),
            "translation": c.translation.tolist(),
        }
        for c in cameras
    ]
    return json.dumps({"cameras": rows}, indent=1) + "\n"


def _float(name: str, value: object) -> float:
    """A number, also one of numpy; a whole number may be too large for a float."""
    if not isinstance(value, Real):
        raise TypeError(f"{name} is no number")
    try:
        return float(value)
    except OverflowError:
        return math.inf
