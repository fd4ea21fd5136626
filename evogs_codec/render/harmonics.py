"""Colour by direction: real spherical harmonics of degree 0..3 (spec/rasterizer.md 3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.compiled import Scalar, inlined

__all__ = ["basis", "basis_gradient"]

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
# Numbers of functions, unsigned, as indexes of vector code are.
K2, K3, K4, K5, K6, K7, K8, K9, K10, K11, K12, K13, K14, K15 = (np.uint64(k) for k in range(2, 16))


@inlined
def basis(x: float, y: float, z: float, out: Array, at: Scalar, step: Scalar, n: int) -> None:
    """The first n of the 16 functions at a unit direction, into out[at], out[at + step] ..."""
    out[at] = C0
    if n > 1:
        out[at + step] = -C1 * y
        out[at + K2 * step] = C1 * z
        out[at + K3 * step] = -C1 * x
    if n > 4:
        out[at + K4 * step] = C2A * x * y
        out[at + K5 * step] = -C2A * y * z
        out[at + K6 * step] = C2B * (2 * z * z - x * x - y * y)
        out[at + K7 * step] = -C2A * x * z
        out[at + K8 * step] = C2C * (x * x - y * y)
    if n > 9:
        out[at + K9 * step] = -C3A * y * (3 * x * x - y * y)
        out[at + K10 * step] = C3B * x * y * z
        out[at + K11 * step] = -C3C * y * (4 * z * z - x * x - y * y)
        out[at + K12 * step] = C3D * z * (2 * z * z - 3 * x * x - 3 * y * y)
        out[at + K13 * step] = -C3C * x * (4 * z * z - x * x - y * y)
        out[at + K14 * step] = C3E * z * (x * x - y * y)
        out[at + K15 * step] = -C3A * x * (x * x - 3 * y * y)


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
