"""Splats on the screen: from parameters to what one pixel needs to know (spec/rasterizer.md 2-4).

N splats. Everything here is float64, whatever the parameters are: it is a small part of the time,
and keeps centres, needles and the depth order exact. With (dx, dy) = pixel centre - centre,

    log2 alpha = LOG_OPACITY - (WEIGHT (dx - SLOPE dy))^2 - CURVE dy^2

which is the usual exp(-sigma) with the inverse covariance as a sum of squares: nothing cancels.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.activation import LOG2_OPACITY, OPACITY, SCALE
from evogs_codec.render.compiled import inlined, parallel_kernel, prange
from evogs_codec.render.harmonics import shade
from evogs_codec.render.options import ALPHA_MIN
from evogs_codec.render.spans import LOG_MIN, MARGIN, fill_span

__all__ = ["DRAWN", "FIELDS", "INVISIBLE", "NON_FINITE", "project"]

Array = npt.NDArray[Any]

# Entries of the view (Camera.view): rotation 0..8, translation 9..11, then
FX, FY, CX, CY, EYE, LEFT, RIGHT, TOP, BOTTOM, NEAR, DILATION = (
    12,
    13,
    14,
    15,
    16,
    19,
    20,
    21,
    22,
    23,
    24,
)

# Fields of a record.
X, Y, WEIGHT, SLOPE, CURVE, LOG_OPACITY, RED, GREEN, BLUE, WIDEST = range(10)
FIELDS = 10

DRAWN, INVISIBLE, NON_FINITE = 0, 1, 2
LOG2E = math.log2(math.e)


@inlined
def to_camera(view: Array, x: float, y: float, z: float) -> tuple[float, ...]:
    """World to camera."""
    return (
        view[0] * x + view[1] * y + view[2] * z + view[9],
        view[3] * x + view[4] * y + view[5] * z + view[10],
        view[6] * x + view[7] * y + view[8] * z + view[11],
    )


@inlined
def jacobian(view: Array, x: float, y: float, z: float) -> tuple[float, ...]:
    """The four entries of J that are not zero: J00, J02, J11, J12."""
    inverse = 1.0 / z
    slope_x = min(max(x * inverse, view[LEFT]), view[RIGHT])
    slope_y = min(max(y * inverse, view[TOP]), view[BOTTOM])
    j00, j11 = view[FX] * inverse, view[FY] * inverse
    return j00, -j00 * slope_x, j11, -j11 * slope_y


@inlined
def world_to_screen(view: Array, x: float, y: float, z: float) -> tuple[float, ...]:
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
def half_axes(w: tuple[float, ...], active: Array) -> tuple[float, ...]:
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


@inlined
def _is_finite(means: Array, sh: Array) -> bool:
    zero = 0.0  # becomes NaN at the first number that is not finite
    for c in range(3):
        zero += means[c] * 0.0
    for k in range(sh.shape[0]):
        zero += sh[k, 0] * 0.0 + sh[k, 1] * 0.0 + sh[k, 2] * 0.0
    return zero == 0.0


@inlined
def _clip(value: float, size: int) -> int:
    """int(value) within 0..size, whatever value is; NaN gives 0."""
    if not value > 0.0:
        return 0
    return size if value > size else int(value)


@inlined
def _splat(
    mean: Array, active: Array, sh: Array,
    view: Array, antialiased: bool, width: int, height: int,
    out: Array, rows: Array, span: Array, scratch: Array,
) -> tuple[int, float]:  # fmt: skip
    """Fill one record, its pixel rows and its span; returns its status and depth."""
    opacity = active[OPACITY]
    if opacity != opacity:
        return NON_FINITE, 0.0
    x, y, z = to_camera(view, mean[0], mean[1], mean[2])
    if not z > view[NEAR]:
        return (INVISIBLE if _is_finite(mean, sh) else NON_FINITE), 0.0
    u = half_axes(world_to_screen(view, x, y, z), active)
    xx, xy, yy, det, flat = covariance(u, view[DILATION])
    if antialiased:
        opacity *= math.sqrt(max(0.0, flat / det))
    red, green, blue = shade(
        mean[0] - view[EYE], mean[1] - view[EYE + 1], mean[2] - view[EYE + 2], sh, scratch
    )
    slope_x, slope_y = x / z, y / z
    if not math.isfinite(det + red + green + blue + opacity + slope_x + slope_y):
        return NON_FINITE, 0.0
    if not opacity >= ALPHA_MIN:
        return INVISIBLE, 0.0
    log_opacity = math.log2(opacity) if antialiased else active[LOG2_OPACITY]
    room = log_opacity - LOG_MIN
    reach = 2.0 * room / LOG2E  # the squared distance, in standard deviations, of alpha = 1/255
    out[X] = view[FX] * slope_x + view[CX]
    out[Y] = view[FY] * slope_y + view[CY]
    inverse = 1.0 / yy
    out[WEIGHT] = math.sqrt(0.5 * LOG2E * (yy / det))
    out[SLOPE] = xy * inverse
    out[CURVE] = 0.5 * LOG2E * inverse
    out[LOG_OPACITY] = log_opacity
    out[RED] = max(0.0, red)
    out[GREEN] = max(0.0, green)
    out[BLUE] = max(0.0, blue)
    part = math.sqrt(reach / xx)
    out[WIDEST] = xy * part  # dy of the rightmost point
    half = xx * part
    if not (out[X] + half + MARGIN >= 0.5 and out[X] - half - MARGIN <= width - 0.5):
        return INVISIBLE, 0.0
    half = math.sqrt(reach * yy)
    rows[0] = _clip(math.ceil(out[Y] - half - MARGIN - 0.5), height)
    rows[1] = _clip(math.floor(out[Y] + half + MARGIN - 0.5) + 1.0, height)
    if rows[0] >= rows[1]:
        return INVISIBLE, 0.0
    fill_span(
        out[X], out[Y], out[WEIGHT], out[SLOPE], out[CURVE], out[LOG_OPACITY], out[WIDEST],
        rows[0], rows[1], width, span,
    )  # fmt: skip
    return DRAWN, z


@parallel_kernel
def project(
    means: Array, active: Array, sh: Array,
    view: Array, antialiased: bool, width: int, height: int,
    records: Array, rows: Array, spans: Array, depths: Array, status: Array, n_workers: int,
) -> None:  # fmt: skip
    """Fill, for each of N splats, its record, pixel rows, span, camera z and status.

    Arguments, several to a line:
        means, sh: parameters.
        active: `Activated.active`.
        view: `Camera.view`.
        antialiased: whether opacity is compensated.
        width, height: pixels.
        records: (N, FIELDS) float64, out.
        rows: (N, 2) int32, [first, last), out.
        spans: (N, SPAN) int16, out; only where drawn.
        depths: (N,) float64, out; only where drawn.
        status: (N,) uint8, out.
        n_workers: splats are dealt out to so many.
    """
    n = len(means)
    for worker in prange(n_workers):
        scratch = np.empty(16)
        for i in range(worker * n // n_workers, (worker + 1) * n // n_workers):
            status[i], depths[i] = _splat(
                means[i], active[i], sh[i],
                view, antialiased, width, height, records[i], rows[i], spans[i],
                scratch,
            )  # fmt: skip
