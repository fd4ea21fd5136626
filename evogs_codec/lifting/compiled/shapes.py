"""The loops of `orientations` and of `parents` that turn Gaussians.

Letters: n Gaussians; numbers of float32 stay what they are, so constants are float32 as well.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import F32, F64, I64, U8

__all__ = ["nearest_turns", "turned", "variances"]

_jit = jit(error_model="numpy")


@_jit
def nearest_turns(
    g: F32, quats: F32, apart: F32, turns: F32, permute: I64, unit: float, most: float, out: U8
) -> None:
    """`orientations.nearest_turns`, out.

    Arguments, several to a line:
        g: (3, n) rotations of the others.
        quats: (4, n) of the Gaussians to turn.
        apart: (3, 3, n) what a pair of axes costs.
        turns, permute: (24, 4) and (24, 3) of the cube's group.
        unit: of a difference of g.
        most: a squared norm of g that is too large.
    """
    one, per_step, bound = np.float32(1), np.float32(unit), np.float32(most)
    for i in range(g.shape[1]):
        w, x, y, z = quats[0, i], quats[1, i], quats[2, i], quats[3, i]
        gx, gy, gz = g[0, i], g[1, i], g[2, i]
        best, which = np.float32(np.inf), 0
        for k in range(len(turns)):
            a, b, c, d = turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3]
            r = one / (a * w - b * x - c * y - d * z)
            hx = (a * x + b * w + d * y - c * z) * r
            hy = (a * y + c * w + b * z - d * x) * r
            hz = (a * z + d * w + c * x - b * y) * r
            norm = hx * hx + hy * hy + hz * hz
            if not norm < bound:
                continue
            far = one + norm
            cost = (one + abs(hx - gx) * per_step) * (one + abs(hy - gy) * per_step)
            cost *= (one + abs(hz - gz) * per_step) * (far * far * far)
            for axis in range(3):
                cost *= apart[axis, permute[k, axis], i]
            if cost < best:
                best, which = cost, k
        out[i] = which


@_jit
def turned(
    quats: F64,
    log_scales: F64,
    turns: F64,
    permute: I64,
    turn: U8,
    begin: int,
    end: int,
    w: F64,
    g: F64,
    scales: F64,
) -> None:
    """`orientations.turned` of the Gaussians from `begin` to `end`, out.

    Arguments, several to a line:
        turns, permute: (24, 4) and (24, 3) of the cube's group.
        w, g, scales: (n,), (3, n) and (3, n), out.
    """
    for i in range(begin, end):
        a, b, c, d = quats[0, i], quats[1, i], quats[2, i], quats[3, i]
        k = turn[i]
        p, x, y, z = turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3]
        w[i] = a * p - b * x - c * y - d * z
        g[0, i] = (a * x + b * p + c * z - d * y) / w[i]
        g[1, i] = (a * y - b * z + c * p + d * x) / w[i]
        g[2, i] = (a * z + b * y - c * x + d * p) / w[i]
        for axis in range(3):
            scales[axis, i] = log_scales[permute[k, axis], i]


@_jit
def variances(g: F64, cov: F64, out: F64) -> None:
    """`parents._variances` along the axes of the rotations g (3, n): (3, n), out."""
    r = np.empty((3, 3))
    for row in range(g.shape[1]):
        x, y, z = g[0, row], g[1, row], g[2, row]
        norm = 1 + x * x + y * y + z * z
        r[0, 0] = (1 + x * x - y * y - z * z) / norm
        r[0, 1], r[0, 2] = 2 * (x * y - z) / norm, 2 * (x * z + y) / norm
        r[1, 0], r[1, 2] = 2 * (x * y + z) / norm, 2 * (y * z - x) / norm
        r[1, 1] = (1 - x * x + y * y - z * z) / norm
        r[2, 0], r[2, 1] = 2 * (x * z - y) / norm, 2 * (y * z + x) / norm
        r[2, 2] = (1 - x * x - y * y + z * z) / norm
        for k in range(3):
            total = 0.0
            for i in range(3):
                along = cov[i, 0, row] * r[0, k] + cov[i, 1, row] * r[1, k]
                total += r[i, k] * (along + cov[i, 2, row] * r[2, k])
            out[k, row] = total
