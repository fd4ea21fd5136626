"""Lens distortion (k1, k2, p1, p2) and pictures without it.

A point at (x, y) = (X/Z, Y/Z) before an ideal lens appears, with r^2 = x^2 + y^2, at

    x' = x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y

and then at pixel (fx x' + cx, fy y' + cy): the model of OpenCV, and OPENCV of COLMAP.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from conformance.rasterizer.camera import MAX_SIDE, Camera
from reference_trainer.views.view import F32

__all__ = ["Coefficients", "distort", "undistort", "undistorted_camera", "undistorted_image"]

F64: TypeAlias = npt.NDArray[np.float64]
Coefficients: TypeAlias = tuple[float, float, float, float]

MAX_STEPS = 50  # of Newton's method; lenses that can be undone take about 5
MAX_ERROR = 1e-10  # of an undone point, in units of the focal length
MAX_GROWTH = 2  # sides of an undistorted picture over those of the photograph


def undistorted_image(image: F32, camera: Camera, distortion: Coefficients) -> F32:
    """What `undistorted_camera(camera, distortion)` sees, bilinear between pixels of `image`.

    Args:
        image: (H, W, C) photograph.
        camera: the pinhole behind the lens, of the photograph's size.
        distortion: of the lens.

    Raises:
        ValueError: as `undistorted_camera`.
    """
    ideal = undistorted_camera(camera, distortion)
    columns, rows = np.meshgrid(np.arange(ideal.width) + 0.5, np.arange(ideal.height) + 0.5)
    x, y = distort((columns - ideal.cx) / ideal.fx, (rows - ideal.cy) / ideal.fy, distortion)
    # Pixel centres are at halves, array indices are whole.
    at = np.stack([camera.fy * y + camera.cy, camera.fx * x + camera.cx]) - 0.5
    channels = [map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(3)]
    return np.stack(channels, axis=-1)


def undistorted_camera(camera: Camera, distortion: Coefficients) -> Camera:
    """The pinhole with the same focal lengths and the largest picture without empty borders.

    Raises:
        ValueError: the lens bends rays beyond what its four numbers describe.
    """
    # The photograph's border, in ideal pixels relative to the principal point. Its innermost
    # points bound a rectangle whose every pixel the photograph has.
    u, v = np.linspace(0, camera.width, 257), np.linspace(0, camera.height, 257)
    left = camera.fx * _border(camera, distortion, 0 * v, v)[0].max()
    right = camera.fx * _border(camera, distortion, 0 * v + camera.width, v)[0].min()
    top = camera.fy * _border(camera, distortion, u, 0 * u)[1].max()
    bottom = camera.fy * _border(camera, distortion, u, 0 * u + camera.height)[1].min()
    # A border that no distortion moves must not lose a pixel to rounding.
    width, height = math.floor(right - left + 1e-6), math.floor(bottom - top + 1e-6)
    longest = min(MAX_SIDE, MAX_GROWTH * max(camera.width, camera.height))
    if not (1 <= width <= longest and 1 <= height <= longest):
        raise ValueError(
            f"lens distortion {list(distortion)} makes a picture of {width} x {height} pixels "
            f"out of {camera.width} x {camera.height}"
        )
    spare_x, spare_y = right - left - width, bottom - top - height
    return Camera(
        width, height, camera.fx, camera.fy, -left - spare_x / 2, -top - spare_y / 2,
        camera.rotation, camera.translation,
    )  # fmt: skip


def distort(x: F64, y: F64, distortion: Coefficients) -> tuple[F64, F64]:
    """Where ideal points appear; coordinates in units of the focal length, of any shape."""
    k1, k2, p1, p2 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def undistort(x: F64, y: F64, distortion: Coefficients) -> tuple[F64, F64]:
    """Ideal points that appear at (x, y): the inverse of `distort`, by Newton's method.

    Raises:
        ValueError: no ideal point near the axis appears at one of them.
    """
    k1, k2, p1, p2 = distortion
    ideal_x, ideal_y = x, y
    for _ in range(MAX_STEPS):
        there_x, there_y = distort(ideal_x, ideal_y, distortion)
        error_x, error_y = there_x - x, there_y - y
        r2 = ideal_x * ideal_x + ideal_y * ideal_y
        radial, slope = 1 + r2 * (k1 + r2 * k2), 2 * (k1 + 2 * k2 * r2)
        cross = slope * ideal_x * ideal_y + 2 * (p1 * ideal_x + p2 * ideal_y)
        along_x = radial + slope * ideal_x * ideal_x + 2 * p1 * ideal_y + 6 * p2 * ideal_x
        along_y = radial + slope * ideal_y * ideal_y + 6 * p1 * ideal_y + 2 * p2 * ideal_x
        determinant = along_x * along_y - cross * cross
        # Where it is not positive the lens has folded the picture over.
        if not (np.isfinite(determinant).all() and (determinant > 0).all()):
            break
        if max(np.abs(error_x).max(), np.abs(error_y).max()) < MAX_ERROR:
            return ideal_x, ideal_y
        ideal_x = ideal_x - (along_y * error_x - cross * error_y) / determinant
        ideal_y = ideal_y - (along_x * error_y - cross * error_x) / determinant
    raise ValueError(f"lens distortion {list(distortion)} folds the picture over itself")


def _border(camera: Camera, distortion: Coefficients, u: F64, v: F64) -> tuple[F64, F64]:
    """Ideal points of pixels (u, v) of the photograph."""
    return undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, distortion)
