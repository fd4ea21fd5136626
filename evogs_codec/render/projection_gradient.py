"""From the gradient to the record of a splat to that of its parameters: `projection`, backwards."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render import screen as s
from evogs_codec.render.activation import SCALE, opacity_of, unit_quaternion
from evogs_codec.render.compiled import inlined, parallel_kernel, prange
from evogs_codec.render.harmonics import basis, basis_gradient

__all__ = ["project_gradient"]

Array = npt.NDArray[Any]

_LARGEST = 1e18  # what float32 still squares, as an optimiser does


@inlined
def _bounded(value: float) -> float:
    """`value`, or the nearest number an optimiser survives."""
    if value != value:
        return 0.0
    return min(max(value, -_LARGEST), _LARGEST)


@inlined
def _covariance_gradient(
    u: tuple[float, ...], e: float, g: Array, antialiased: bool
) -> tuple[float, ...]:
    """Gradient to U, (2, 3) row by row, from that to log a, log c, slope and log opacity."""
    xx, xy, yy, det, flat = s.covariance(u, e)
    a, c, slope = yy / det, 1.0 / yy, xy / yy
    g_xx = -a * g[2]
    g_xy = 2 * a * slope * g[2] + c * g[4]
    g_yy = -a * slope * slope * g[2] - c * g[3] - slope * c * g[4]
    area = 0.0
    if antialiased:  # opacity has the factor sqrt(flat / det)
        g_xx -= 0.5 * g[5] * a
        g_xy += g[5] * xy / det
        g_yy -= 0.5 * g[5] * xx / det
        area = g[5] / flat
    n0 = u[1] * u[5] - u[2] * u[4]
    n1 = u[2] * u[3] - u[0] * u[5]
    n2 = u[0] * u[4] - u[1] * u[3]
    return (
        2 * g_xx * u[0] + g_xy * u[3] + area * (u[4] * n2 - u[5] * n1),
        2 * g_xx * u[1] + g_xy * u[4] + area * (u[5] * n0 - u[3] * n2),
        2 * g_xx * u[2] + g_xy * u[5] + area * (u[3] * n1 - u[4] * n0),
        g_xy * u[0] + 2 * g_yy * u[3] + area * (n1 * u[2] - n2 * u[1]),
        g_xy * u[1] + 2 * g_yy * u[4] + area * (n2 * u[0] - n0 * u[2]),
        g_xy * u[2] + 2 * g_yy * u[5] + area * (n0 * u[1] - n1 * u[0]),
    )


@inlined
def _quaternion_gradient(
    w: float, x: float, y: float, z: float, scale: float, r: tuple[float, ...], out: Array
) -> None:
    """Gradient to a quaternion of norm 1/scale, from that to its rotation matrix."""
    gw = 2 * (z * (r[3] - r[1]) + y * (r[2] - r[6]) + x * (r[7] - r[5]))
    gx = 2 * (y * (r[1] + r[3]) + z * (r[2] + r[6]) + w * (r[7] - r[5]) - 2 * x * (r[4] + r[8]))
    gy = 2 * (x * (r[1] + r[3]) + z * (r[5] + r[7]) + w * (r[2] - r[6]) - 2 * y * (r[0] + r[8]))
    gz = 2 * (x * (r[2] + r[6]) + y * (r[5] + r[7]) + w * (r[3] - r[1]) - 2 * z * (r[0] + r[4]))
    along = gw * w + gx * x + gy * y + gz * z
    out[0] = _bounded((gw - along * w) * scale)
    out[1] = _bounded((gx - along * x) * scale)
    out[2] = _bounded((gy - along * y) * scale)
    out[3] = _bounded((gz - along * z) * scale)


@inlined
def _colour_gradient(
    dx: float, dy: float, dz: float, sh: Array, record: Array, g: Array, out: Array, scratch: Array
) -> tuple[float, float, float]:
    """Fill the gradient to the coefficients; returns that to the position."""
    values, weights = scratch[0], scratch[1]
    n = sh.shape[0]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    x, y, z = dx / length, dy / length, dz / length
    basis(x, y, z, values, np.uint64(0), np.uint64(1), n)
    red = g[6] if record[p.RED] > 0 else 0.0
    green = g[7] if record[p.GREEN] > 0 else 0.0
    blue = g[8] if record[p.BLUE] > 0 else 0.0
    for k in range(n):
        out[k, 0] = _bounded(values[k] * red)
        out[k, 1] = _bounded(values[k] * green)
        out[k, 2] = _bounded(values[k] * blue)
        weights[k] = sh[k, 0] * red + sh[k, 1] * green + sh[k, 2] * blue
    gx, gy, gz = basis_gradient(x, y, z, weights, n)
    along = gx * x + gy * y + gz * z
    return (gx - along * x) / length, (gy - along * y) / length, (gz - along * z) / length


@inlined
def _splat(
    mean: Array, quat: Array, logit: float, sh: Array, active: Array, view: Array,
    antialiased: bool, record: Array, g: Array,
    g_mean: Array, g_quat: Array, g_scale: Array, g_sh: Array,
    scratch: Array,
) -> float:  # fmt: skip
    """Gradients to the parameters of one splat; returns that to the opacity logit."""
    x, y, z = s.to_camera(view, mean[0], mean[1], mean[2])
    qw, qx, qy, qz, inverse = unit_quaternion(
        np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    )
    r = active
    w = s.world_to_screen(view, x, y, z)
    u = s.half_axes(w, active)
    gu = _covariance_gradient(u, view[s.DILATION], g, antialiased)

    # U = W R S
    g_scale[0] = _bounded(gu[0] * u[0] + gu[3] * u[3])
    g_scale[1] = _bounded(gu[1] * u[1] + gu[4] * u[4])
    g_scale[2] = _bounded(gu[2] * u[2] + gu[5] * u[5])
    s0, s1, s2 = active[SCALE], active[SCALE + 1], active[SCALE + 2]
    a0, a1, a2 = gu[0] * s0, gu[1] * s1, gu[2] * s2
    b0, b1, b2 = gu[3] * s0, gu[4] * s1, gu[5] * s2
    g_r = (
        w[0] * a0 + w[3] * b0, w[0] * a1 + w[3] * b1, w[0] * a2 + w[3] * b2,
        w[1] * a0 + w[4] * b0, w[1] * a1 + w[4] * b1, w[1] * a2 + w[4] * b2,
        w[2] * a0 + w[5] * b0, w[2] * a1 + w[5] * b1, w[2] * a2 + w[5] * b2,
    )  # fmt: skip
    _quaternion_gradient(qw, qx, qy, qz, inverse, g_r, g_quat)
    w0 = a0 * r[0] + a1 * r[1] + a2 * r[2]
    w1 = a0 * r[3] + a1 * r[4] + a2 * r[5]
    w2 = a0 * r[6] + a1 * r[7] + a2 * r[8]
    w3 = b0 * r[0] + b1 * r[1] + b2 * r[2]
    w4 = b0 * r[3] + b1 * r[4] + b2 * r[5]
    w5 = b0 * r[6] + b1 * r[7] + b2 * r[8]

    # W = J R, J of the clamped slopes
    j00, j02, j11, j12 = s.jacobian(view, x, y, z)
    g00 = w0 * view[0] + w1 * view[1] + w2 * view[2]
    g02 = w0 * view[6] + w1 * view[7] + w2 * view[8]
    g11 = w3 * view[3] + w4 * view[4] + w5 * view[5]
    g12 = w3 * view[6] + w4 * view[7] + w5 * view[8]
    gz = -(g00 * j00 + g02 * j02 + g11 * j11 + g12 * j12) / z
    # The centre sees the slopes as they are, J only where they are not clamped.
    slope_x, slope_y = g[0] * view[s.FX], g[1] * view[s.FY]
    if view[s.LEFT] < x / z < view[s.RIGHT]:
        slope_x -= g02 * view[s.FX] / z
    if view[s.TOP] < y / z < view[s.BOTTOM]:
        slope_y -= g12 * view[s.FY] / z
    gx, gy = slope_x / z, slope_y / z
    gz -= (gx * x + gy * y) / z

    cx, cy, cz = _colour_gradient(
        mean[0] - view[s.EYE], mean[1] - view[s.EYE + 1], mean[2] - view[s.EYE + 2],
        sh, record, g, g_sh, scratch,
    )  # fmt: skip
    g_mean[0] = _bounded(view[0] * gx + view[3] * gy + view[6] * gz + cx)
    g_mean[1] = _bounded(view[1] * gx + view[4] * gy + view[7] * gz + cy)
    g_mean[2] = _bounded(view[2] * gx + view[5] * gy + view[8] * gz + cz)
    return _bounded(g[5] * opacity_of(-np.float64(logit)))


@parallel_kernel
def project_gradient(
    means: Array, quats: Array, opacity_logits: Array, sh: Array, active: Array,
    view: Array, antialiased: bool, records: Array, status: Array, gradients: Array,
    g_means: Array, g_quats: Array, g_log_scales: Array, g_opacity_logits: Array, g_sh: Array,
    n_workers: int,
) -> None:  # fmt: skip
    """Fill the gradients to the parameters of N splats; zeros where a splat was not drawn.

    Arguments, several to a line:
        means, quats, opacity_logits, sh: parameters before activation.
        active: `Activated.active`.
        view, antialiased, records, status: as `projection.project` has them.
        gradients: (N, WIDTH) to the records.
        g_means, g_quats, g_log_scales, g_opacity_logits, g_sh: out.
        n_workers: splats are dealt out to so many.
    """
    n = len(means)
    for worker in prange(n_workers):
        scratch = np.empty((2, 16))
        for i in range(worker * n // n_workers, (worker + 1) * n // n_workers):
            if status[i] == p.DRAWN:
                g_opacity_logits[i] = _splat(
                    means[i], quats[i], opacity_logits[i], sh[i], active[i], view, antialiased,
                    records[i], gradients[i], g_means[i], g_quats[i], g_log_scales[i], g_sh[i],
                    scratch,
                )  # fmt: skip
            else:
                g_means[i] = 0.0
                g_quats[i] = 0.0
                g_log_scales[i] = 0.0
                g_opacity_logits[i] = 0.0
                g_sh[i] = 0.0
