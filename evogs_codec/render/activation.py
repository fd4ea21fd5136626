"""Rotations, sizes and opacities of splats, the same for all cameras (spec/rasterizer.md 2)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.compiled import inlined, parallel_kernel, prange

__all__ = ["ACTIVE", "LOG2_OPACITY", "OPACITY", "SCALE", "activate"]

Array = npt.NDArray[Any]

# Of an active splat: the rotation matrix row by row, the standard deviations along its axes, the
# opacity and its binary logarithm. The opacity is NaN if a parameter is not a finite number.
SCALE, OPACITY, LOG2_OPACITY, ACTIVE = 9, 12, 13, 14


@inlined
def unit_quaternion(w: float, x: float, y: float, z: float) -> tuple[float, ...]:
    """The unit quaternion, and 1 / norm; the zero quaternion is the identity."""
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if norm == 0.0:
        return 1.0, 0.0, 0.0, 0.0, 0.0
    inverse = 1.0 / norm
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@inlined
def rotation_matrix(w: float, x: float, y: float, z: float) -> tuple[float, ...]:
    """The matrix of a unit quaternion, row by row."""
    return (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip


@inlined
def opacity_of(logit: float) -> float:
    """The sigmoid, without overflow."""
    if logit >= 0:
        return 1.0 / (1.0 + math.exp(-logit))
    e = math.exp(logit)
    return e / (1.0 + e)


@parallel_kernel
def activate(
    quats: Array, log_scales: Array, opacity_logits: Array, active: Array, n_workers: int
) -> None:
    """Fill what follows from the parameters of N splats.

    Args:
        quats: (N, 4).
        log_scales: (N, 3).
        opacity_logits: (N,).
        active: (N, ACTIVE), out.
        n_workers: splats are dealt out to so many.
    """
    n = len(quats)
    for worker in prange(n_workers):
        for i in range(worker * n // n_workers, (worker + 1) * n // n_workers):
            out = active[i]
            zero = opacity_logits[i] * 0.0  # becomes NaN at the first number that is not finite
            for c in range(4):
                zero += quats[i, c] * 0.0
            for c in range(3):
                zero += log_scales[i, c] * 0.0
                out[SCALE + c] = math.exp(np.float64(log_scales[i, c]))
            qw, qx, qy, qz, _ = unit_quaternion(
                np.float64(quats[i, 0]), np.float64(quats[i, 1]),
                np.float64(quats[i, 2]), np.float64(quats[i, 3]),
            )  # fmt: skip
            r = rotation_matrix(qw, qx, qy, qz)
            for k in range(SCALE):
                out[k] = r[k]
            opacity = opacity_of(np.float64(opacity_logits[i]))
            out[OPACITY] = opacity + zero
            out[LOG2_OPACITY] = math.log2(opacity)
