"""Colour by direction: real spherical harmonics of degree 0..3 (spec/rasterizer.md 3)."""

from __future__ import annotations

import math
from typing import Any

import numpy.typing as npt

from evogs_codec.render.compiled import inlined

__all__ = ["basis", "basis_gradient", "shade"]

Array = npt.NDArray[Any]

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)
C2A, C2B, C2C = C2
C3A, C3B, C3C, C3D, C3E = C3


@inlined
def basis(x: float, y: float, z: float, out: Array, n: int) -> None:
    """The first n of the 16 functions at a unit direction."""
    out[0] = C0
    if n > 1:
        out[1], out[2], out[3] = -C1 * y, C1 * z, -C1 * x
    if n > 4:
        out[4] = C2A * x * y
        out[5] = -C2A * y * z
        out[6] = C2B * (2 * z * z - x * x - y * y)
        out[7] = -C2A * x * z
        out[8] = C2C * (x * x - y * y)
    if n > 9:
        out[9] = -C3A * y * (3 * x * x - y * y)
        out[10] = C3B * x * y * z
        out[11] = -C3C * y * (4 * z * z - x * x - y * y)
        out[12] = C3D * z * (2 * z * z - 3 * x * x - 3 * y * y)
        out[13] = -C3C * x * (4 * z * z - x * x - y * y)
        out[14] = C3E * z * (x * x - y * y)
        out[15] = -C3A * x * (x * x - 3 * y * y)


@inlined
def basis_gradient(
    x: float, y: float, z: float, weights: Array, n: int
) -> tuple[float, float, float]:
    """Gradient of sum_k weights[k] basis_k to the direction, as if it were not normalised."""
    w = weights
    gx = gy = gz = 0.0
    if n > 1:
        gx -= C1 * w[3]
        gy -= C1 * w[1]
        gz += C1 * w[2]
    if n > 4:
        gx += C2A * (y * w[4] - z * w[7]) - 2 * C2B * x * w[6] + 2 * C2C * x * w[8]
        gy += C2A * (x * w[4] - z * w[5]) - 2 * C2B * y * w[6] - 2 * C2C * y * w[8]
        gz += -C2A * (y * w[5] + x * w[7]) + 4 * C2B * z * w[6]
    if n > 9:
        xx, yy, zz = x * x, y * y, z * z
        gx += -C3A * (6 * x * y * w[9] + 3 * (xx - yy) * w[15]) + C3B * y * z * w[10]
        gx += C3C * (2 * x * y * w[11] - (4 * zz - 3 * xx - yy) * w[13])
        gx += -6 * C3D * x * z * w[12] + 2 * C3E * x * z * w[14]
        gy += -C3A * (3 * (xx - yy) * w[9] - 6 * x * y * w[15]) + C3B * x * z * w[10]
        gy += C3C * (2 * x * y * w[13] - (4 * zz - xx - 3 * yy) * w[11])
        gy += -6 * C3D * y * z * w[12] - 2 * C3E * y * z * w[14]
        gz += C3B * x * y * w[10] - 8 * C3C * z * (y * w[11] + x * w[13])
        gz += C3D * (6 * zz - 3 * xx - 3 * yy) * w[12] + C3E * (xx - yy) * w[14]
    return gx, gy, gz


@inlined
def shade(dx: float, dy: float, dz: float, sh: Array, values: Array) -> tuple[float, float, float]:
    """R G B of (K, 3) coefficients along a direction, not clamped at 0; `values` is scratch."""
    inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    n = sh.shape[0]
    basis(dx * inverse, dy * inverse, dz * inverse, values, n)
    red = green = blue = 0.5
    for k in range(n):
        red += values[k] * sh[k, 0]
        green += values[k] * sh[k, 1]
        blue += values[k] * sh[k, 2]
    return red, green, blue
