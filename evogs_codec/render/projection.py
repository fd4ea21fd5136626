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
from numba.np.unsafe.ndarray import to_fixed_tuple

from evogs_codec.render import lanes as v
from evogs_codec.render.activation import OPACITY
from evogs_codec.render.compiled import Scalar, inlined, parallel_kernel, prange
from evogs_codec.render.options import ALPHA_MIN
from evogs_codec.render.screen import NEAR, VIEW
from evogs_codec.render.spans import MARGIN, fill_span

__all__ = ["DRAWN", "FIELDS", "INVISIBLE", "NON_FINITE", "project"]

Array = npt.NDArray[Any]

# Fields of a record.
X, Y, WEIGHT, SLOPE, CURVE, LOG_OPACITY, RED, GREEN, BLUE, WIDEST = range(10)
FIELDS = 10

DRAWN, INVISIBLE, NON_FINITE = 0, 1, 2


@inlined
def _is_finite(means: Array, sh: Array, i: int) -> bool:
    zero = 0.0  # becomes NaN at the first number that is not finite
    for c in range(3):
        zero += means[i, c] * 0.0
    for k in range(sh.shape[1]):
        zero += sh[i, k, 0] * 0.0 + sh[i, k, 1] * 0.0 + sh[i, k, 2] * 0.0
    return zero == 0.0


@inlined
def _clip(value: float, size: int) -> int:
    """int(value) within 0..size, whatever value is; NaN gives 0."""
    if not value > 0.0:
        return 0
    return size if value > size else int(value)


@inlined
def _splat(
    i: int, means: Array, active: Array, sh: Array,
    near: float, antialiased: bool, width: int, height: int, state: Array, lane: Scalar,
    records: Array, rows: Array, spans: Array,
) -> tuple[int, float]:  # fmt: skip
    """Fill the record, the pixel rows and the span of the splat in a lane; its status and depth."""
    opacity = active[i, OPACITY]
    if opacity != opacity:
        return NON_FINITE, 0.0
    z = state[lane + v.Z]
    if not z > near:
        return (INVISIBLE if _is_finite(means, sh, i) else NON_FINITE), 0.0
    det, log_opacity = state[lane + v.DETERMINANT], state[lane + v.LOG_OPACITY]
    part, half_x, half_y = state[lane + v.PART], state[lane + v.HALF_X], state[lane + v.HALF_Y]
    if antialiased:
        opacity *= math.sqrt(max(0.0, state[lane + v.FLAT] / det))
        log_opacity = math.log2(opacity)
        part, half_x, half_y = v.reach_of(state[lane + v.XX], state[lane + v.YY], log_opacity)
    red = green = blue = 0.5
    for k in range(sh.shape[1]):
        value = state[lane + v.BASIS + np.uint64(k * v.LANES)]
        red += value * sh[i, k, 0]
        green += value * sh[i, k, 1]
        blue += value * sh[i, k, 2]
    finite = det + red + green + blue + opacity + state[lane + v.SLOPE_X] + state[lane + v.SLOPE_Y]
    if not math.isfinite(finite):
        return NON_FINITE, 0.0
    if not opacity >= ALPHA_MIN:
        return INVISIBLE, 0.0
    x, y = state[lane + v.X], state[lane + v.Y]
    records[i, X], records[i, Y] = x, y
    records[i, WEIGHT], records[i, SLOPE] = state[lane + v.WEIGHT], state[lane + v.SLOPE]
    records[i, CURVE], records[i, LOG_OPACITY] = state[lane + v.CURVE], log_opacity
    records[i, RED], records[i, GREEN] = max(0.0, red), max(0.0, green)
    records[i, BLUE] = max(0.0, blue)
    records[i, WIDEST] = state[lane + v.XY] * part  # dy of the rightmost point
    if not (x + half_x + MARGIN >= 0.5 and x - half_x - MARGIN <= width - 0.5):
        return INVISIBLE, 0.0
    first = _clip(math.ceil(y - half_y - MARGIN - 0.5), height)
    last = _clip(math.floor(y + half_y + MARGIN - 0.5) + 1.0, height)
    rows[i, 0], rows[i, 1] = first, last
    if first >= last:
        return INVISIBLE, 0.0
    fill_span(
        x, y, state[lane + v.WEIGHT], state[lane + v.SLOPE], state[lane + v.CURVE], log_opacity,
        state[lane + v.XY] * part, first, last, width, spans, i,
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
    n, n_functions = len(means), sh.shape[1]
    entries = to_fixed_tuple(view, VIEW)
    for worker in prange(n_workers):
        state = np.zeros(v.STATE)
        end = (worker + 1) * n // n_workers
        for first in range(worker * n // n_workers, end, v.LANES):
            n_lanes = min(v.LANES, end - first)
            v.fill(state, means, active, first, n_lanes)
            v.footprints(state, entries)
            v.basis_of_all(state, n_functions)
            for lane in range(n_lanes):
                i = first + lane
                status[i], depths[i] = _splat(
                    i, means, active, sh, entries[NEAR], antialiased, width, height,
                    state, np.uint64(lane), records, rows, spans,
                )  # fmt: skip
