"""From the world to the screen: what a view does to a splat (spec/rasterizer.md 2-4).

A view is an array or a tuple, as of `Camera.view`. The same functions serve loops over splats and
vector code over lanes.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy.typing as npt

from evogs_codec.render.activation import SCALE
from evogs_codec.render.compiled import inlined

__all__ = [
    "BOTTOM",
    "CX",
    "CY",
    "DILATION",
    "EYE",
    "FX",
    "FY",
    "LEFT",
    "LOG2E",
    "NEAR",
    "RIGHT",
    "TOP",
    "VIEW",
    "covariance",
    "half_axes",
    "jacobian",
    "to_camera",
    "world_to_screen",
]

Vector: TypeAlias = "npt.NDArray[Any] | tuple[float, ...]"

# Entries of the view: rotation 0..8, translation 9..11, then
FX, FY, CX, CY, EYE = 12, 13, 14, 15, 16
LEFT, RIGHT, TOP, BOTTOM, NEAR, DILATION = 19, 20, 21, 22, 23, 24
VIEW = 25  # of them

LOG2E = math.log2(math.e)


@inlined
def to_camera(view: Vector, x: float, y: float, z: float) -> tuple[float, ...]:
    """World to camera."""
    return (
        view[0] * x + view[1] * y + view[2] * z + view[9],
        view[3] * x + view[4] * y + view[5] * z + view[10],
        view[6] * x + view[7] * y + view[8] * z + view[11],
    )


@inlined
def jacobian(view: Vector, x: float, y: float, z: float) -> tuple[float, ...]:
    """The four entries of J that are not zero: J00, J02, J11, J12."""
    inverse = 1.0 / z
    slope_x = min(max(x * inverse, view[LEFT]), view[RIGHT])
    slope_y = min(max(y * inverse, view[TOP]), view[BOTTOM])
    j00, j11 = view[FX] * inverse, view[FY] * inverse
    return j00, -j00 * slope_x, j11, -j11 * slope_y


@inlined
def world_to_screen(view: Vector, x: float, y: float, z: float) -> tuple[float, ...]:
    """W = J R, (2, 3) row by row."""
    j00, j02, j11, j12 = jacobian(view, x, y, z)
    return (
        j00 * view[0] + j02 * view[6],
        j00 * view[1] + j02 * view[7],
        j00 * view[2] + j02 * view[8],
        j11 * view[3] + j12 * view[6],
        j11 * view[4] + j12 * view[7],
        j11 * view[5] + j12 * view[8],
    )


@inlined
def half_axes(w: tuple[float, ...], active: Vector) -> tuple[float, ...]:
    """U = W R(q) S, (2, 3) row by row; the covariance on the screen is U U^T."""
    r, s0, s1, s2 = active, active[SCALE], active[SCALE + 1], active[SCALE + 2]
    return (
        (w[0] * r[0] + w[1] * r[3] + w[2] * r[6]) * s0,
        (w[0] * r[1] + w[1] * r[4] + w[2] * r[7]) * s1,
        (w[0] * r[2] + w[1] * r[5] + w[2] * r[8]) * s2,
        (w[3] * r[0] + w[4] * r[3] + w[5] * r[6]) * s0,
        (w[3] * r[1] + w[4] * r[4] + w[5] * r[7]) * s1,
        (w[3] * r[2] + w[4] * r[5] + w[5] * r[8]) * s2,
    )


@inlined
def covariance(u: tuple[float, ...], e: float) -> tuple[float, ...]:
    """xx, xy, yy of U U^T + e I, its determinant, and that of U U^T (Lagrange's identity)."""
    uu = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
    uv = u[0] * u[3] + u[1] * u[4] + u[2] * u[5]
    vv = u[3] * u[3] + u[4] * u[4] + u[5] * u[5]
    c0 = u[1] * u[5] - u[2] * u[4]
    c1 = u[2] * u[3] - u[0] * u[5]
    c2 = u[0] * u[4] - u[1] * u[3]
    flat = c0 * c0 + c1 * c1 + c2 * c2
    return uu + e, uv, vv + e, flat + e * (uu + vv) + e * e, flat
