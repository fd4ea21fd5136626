"""Squared changes of the picture with the parameters of a splat, from its moments.

A parameter changes the logarithm of alpha by a polynomial of the terms 1, d, down, d^2, d down,
down^2 (`blending_moments`). With its coefficients f, (6,), the squared change of the picture is
f^T M f. M[i, j] is the moment of the product of terms i and j.

A moved splat also changes its colour, which depends on the direction. The two changes are squared
apart and added; twice their product is left out. All else is exact.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render import screen as s
from evogs_codec.render.activation import SCALE, opacity_of, unit_quaternion
from evogs_codec.render.blending_moments import COLOUR
from evogs_codec.render.compiled import inlined, parallel_kernel, prange
from evogs_codec.render.harmonics import basis, basis_gradient

__all__ = ["project_squares"]

Array = npt.NDArray[Any]
Numbers: TypeAlias = "tuple[float, ...]"

_LN2 = math.log(2.0)
_MAX_SQUARE = 1e36  # float32 still adds some of these up


@inlined
def _bounded(value: float) -> float:
    """`value` within 0.._MAX_SQUARE; NaN gives 0."""
    return min(value, _MAX_SQUARE) if value > 0.0 else 0.0


@inlined
def _square(m: Array, f: Numbers) -> float:
    """f^T M f, of the coefficients (6,) of a polynomial; m (WIDTH,) are the moments."""
    return _bounded(
        f[0] * (m[0] * f[0] + 2 * (m[5] * f[1] + m[1] * f[2]))
        + f[1] * (m[9] * f[1] + 2 * m[6] * f[2])
        + f[2] * m[2] * f[2]
        + 2 * f[3] * (m[9] * f[0] + m[12] * f[1] + m[10] * f[2] + m[13] * f[4] + m[11] * f[5])
        + 2 * f[4] * (m[6] * f[0] + m[10] * f[1] + m[7] * f[2] + m[8] * f[5])
        + 2 * f[5] * (m[2] * f[0] + m[7] * f[1] + m[3] * f[2])
        + m[14] * f[3] * f[3] + m[11] * f[4] * f[4] + m[4] * f[5] * f[5]
    )  # fmt: skip


@inlined
def _even_square(m: Array, f: Numbers) -> float:
    """`_square` of an even polynomial, which has the terms 1, d^2, d down, down^2 alone: (4,)."""
    return _bounded(
        f[0] * (m[0] * f[0] + 2 * (m[9] * f[1] + m[6] * f[2] + m[2] * f[3]))
        + f[1] * (m[14] * f[1] + 2 * (m[13] * f[2] + m[11] * f[3]))
        + f[2] * (m[11] * f[2] + 2 * m[8] * f[3])
        + m[4] * f[3] * f[3]
    )


@inlined
def _sum(x: float, f: Numbers, y: float, g: Numbers, z: float, h: Numbers) -> Numbers:
    """The sum x f + y g + z h of even polynomials."""
    return (
        x * f[0] + y * g[0] + z * h[0],
        x * f[1] + y * g[1] + z * h[1],
        x * f[2] + y * g[2] + z * h[2],
        x * f[3] + y * g[3] + z * h[3],
    )


@inlined
def _of_covariance(xx: float, xy: float, yy: float, shape: Numbers) -> Numbers:
    """The even polynomial of a change of the covariance on the screen.

    `shape`: WEIGHT^2 and CURVE without the factor of the binary logarithm, SLOPE,
    WEIGHT / sqrt(CURVE), and the derivatives of the logarithm of the opacity to xx, xy and yy.

    Returns:
        (4,) coefficients of 1, d^2, d down and down^2.
    """
    a, c, slope, ratio, by_xx, by_xy, by_yy = shape
    log_a = a * (2 * slope * xy - xx - slope * slope * yy)
    log_c = -c * yy
    d_slope = c * (xy - slope * yy)
    opacity = by_xx * xx + by_xy * xy + by_yy * yy
    return opacity, -_LN2 * log_a, 2 * _LN2 * ratio * d_slope, -_LN2 * log_c


@inlined
def _turn(size_i: float, size_j: float, i: Numbers, j: Numbers, shape: Numbers) -> Numbers:
    """The even polynomial of a turn about the third axis; i and j: columns of J R R(q), (2,)."""
    by = size_i * size_i - size_j * size_j
    return _of_covariance(
        2 * by * i[0] * j[0], by * (i[0] * j[1] + j[0] * i[1]), 2 * by * i[1] * j[1], shape
    )


@inlined
def _place_and_shape(
    mean: Array, quat: Array, active: Array, view: Array, antialiased: bool, record: Array,
    m: Array, out: Array,
) -> None:  # fmt: skip
    """Fill (10,): squares of the position 0..2, the quaternion 3..6, the log sizes 7..9."""
    x, y, z = s.to_camera(view, mean[0], mean[1], mean[2])
    w, r = s.world_to_screen(view, x, y, z), active
    u = s.half_axes(w, active)
    xx, xy, yy, det, flat = s.covariance(u, view[s.DILATION])
    a, c, slope = yy / det, 1.0 / yy, xy / yy
    weight, curve = record[p.WEIGHT], math.sqrt(record[p.CURVE])
    own_xx, own_yy = xx - view[s.DILATION], yy - view[s.DILATION]
    by_xx, by_xy, by_yy = 0.0, 0.0, 0.0
    if antialiased:  # opacity has the factor sqrt(flat / det)
        by_xx = 0.5 * (own_yy / flat - yy / det)
        by_xy = xy / det - xy / flat
        by_yy = 0.5 * (own_xx / flat - xx / det)
    shape = (a, c, slope, weight / curve, by_xx, by_xy, by_yy)

    # A size k changes U U^T by 2 u_k u_k^T.
    for k in range(3):
        size = _of_covariance(2 * u[k] * u[k], 2 * u[k] * u[3 + k], 2 * u[3 + k] * u[3 + k], shape)
        out[7 + k] = _even_square(m, size)

    # Each number of the quaternion turns about all three axes.
    s0, s1, s2 = active[SCALE], active[SCALE + 1], active[SCALE + 2]
    column_0 = (w[0] * r[0] + w[1] * r[3] + w[2] * r[6], w[3] * r[0] + w[4] * r[3] + w[5] * r[6])
    column_1 = (w[0] * r[1] + w[1] * r[4] + w[2] * r[7], w[3] * r[1] + w[4] * r[4] + w[5] * r[7])
    column_2 = (w[0] * r[2] + w[1] * r[5] + w[2] * r[8], w[3] * r[2] + w[4] * r[5] + w[5] * r[8])
    turn_0 = _turn(s1, s2, column_1, column_2, shape)
    turn_1 = _turn(s2, s0, column_2, column_0, shape)
    turn_2 = _turn(s0, s1, column_0, column_1, shape)
    qw, qx, qy, qz, inverse = unit_quaternion(
        np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    )
    qw, qx, qy, qz = 2 * inverse * qw, 2 * inverse * qx, 2 * inverse * qy, 2 * inverse * qz
    out[3] = _even_square(m, _sum(-qx, turn_0, -qy, turn_1, -qz, turn_2))
    out[4] = _even_square(m, _sum(qw, turn_0, -qz, turn_1, qy, turn_2))
    out[5] = _even_square(m, _sum(qz, turn_0, qw, turn_1, -qx, turn_2))
    out[6] = _even_square(m, _sum(-qy, turn_0, qx, turn_1, qw, turn_2))

    # One unit across, one down, one away along the ray. The centre moves by the slopes as they are,
    # J by the clamped ones: a clamped slope adds nothing to J.
    slope_x, slope_y = x / z, y / z
    to_x, to_y = view[s.FX] / z, view[s.FY] / z
    in_x = to_x / z if view[s.LEFT] < slope_x < view[s.RIGHT] else 0.0
    in_y = to_y / z if view[s.TOP] < slope_y < view[s.BOTTOM] else 0.0
    z0 = s0 * (view[6] * r[0] + view[7] * r[3] + view[8] * r[6])
    z1 = s1 * (view[6] * r[1] + view[7] * r[4] + view[8] * r[7])
    z2 = s2 * (view[6] * r[2] + view[7] * r[5] + view[8] * r[8])
    along_x = u[0] * z0 + u[1] * z1 + u[2] * z2
    along_y = u[3] * z0 + u[4] * z1 + u[5] * z2
    across = _of_covariance(-2 * in_x * along_x, -in_x * along_y, 0.0, shape)
    down = _of_covariance(0.0, -in_y * along_x, -2 * in_y * along_y, shape)
    away = _of_covariance(-2 * own_xx / z, -2 * xy / z, -2 * own_yy / z, shape)
    for k in range(3):
        depth = view[6 + k]
        to_right, to_bottom = view[k] - slope_x * depth, view[3 + k] - slope_y * depth
        even = _sum(to_right, across, to_bottom, down, depth, away)
        to_d = 2 * _LN2 * weight * (to_right * to_x - slope * to_bottom * to_y)
        to_down = 2 * _LN2 * curve * to_bottom * to_y
        out[k] = _square(m, (even[0], to_d, to_down, even[1], even[2], even[3]))


@inlined
def _colour(
    mean: Array, sh: Array, view: Array, record: Array, m: Array,
    out: Array, values: Array, weights: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Fill the squares of the coefficients, (K, 3); returns those of the position."""
    dx, dy, dz = mean[0] - view[s.EYE], mean[1] - view[s.EYE + 1], mean[2] - view[s.EYE + 2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    x, y, z = dx / length, dy / length, dz / length
    n = sh.shape[0]
    basis(x, y, z, values, np.uint64(0), np.uint64(1), n)
    by_x, by_y, by_z = 0.0, 0.0, 0.0
    for c in range(3):
        worth = m[COLOUR] if record[p.RED + c] > 0 else 0.0
        for k in range(n):
            out[k, c] = values[k] * values[k] * worth
            weights[k] = sh[k, c]
        gx, gy, gz = basis_gradient(x, y, z, weights, n)
        along = gx * x + gy * y + gz * z
        per_length = worth / (length * length)
        by_x += per_length * (gx - along * x) ** 2
        by_y += per_length * (gy - along * y) ** 2
        by_z += per_length * (gz - along * z) ** 2
    return by_x, by_y, by_z


@parallel_kernel
def project_squares(
    means: Array, quats: Array, opacity_logits: Array, sh: Array, active: Array,
    view: Array, antialiased: bool, records: Array, status: Array, moments: Array, by: float,
    s_means: Array, s_quats: Array, s_log_scales: Array, s_opacity_logits: Array, s_sh: Array,
    n_workers: int,
) -> None:  # fmt: skip
    """Add the squared changes of a picture with the parameters of N splats, divided by a number.

    Arguments, several to a line:
        means, quats, opacity_logits, sh: parameters before activation.
        active: `Activated.active`.
        view, antialiased, records, status: as `projection.project` has them.
        moments: (N, WIDTH) of the splats.
        by: what squares are divided by.
        s_means, s_quats, s_log_scales, s_opacity_logits, s_sh: added to.
        n_workers: splats are dealt out to so many.
    """
    n, each = len(means), 1.0 / by
    for worker in prange(n_workers):
        values, weights, own = np.empty(16), np.empty(16), np.empty(10)
        of_sh = np.empty(sh.shape[1:])
        for i in range(worker * n // n_workers, (worker + 1) * n // n_workers):
            m = moments[i]
            if status[i] != p.DRAWN or not m[COLOUR] > 0.0:
                continue
            _place_and_shape(means[i], quats[i], active[i], view, antialiased, records[i], m, own)
            colour = _colour(means[i], sh[i], view, records[i], m, of_sh, values, weights)
            slope = opacity_of(-np.float64(opacity_logits[i]))
            s_opacity_logits[i] += _bounded(m[0] * slope * slope) * each
            for c in range(3):
                s_means[i, c] += _bounded(own[c] + colour[c]) * each
                s_log_scales[i, c] += own[7 + c] * each
            for c in range(4):
                s_quats[i, c] += own[3 + c] * each
            for k in range(sh.shape[1]):
                for c in range(3):
                    s_sh[i, k, c] += of_sh[k, c] * each
