"""Back to front over the pixels of tiles: how much each splat changes the pixels that it is in.

log2 alpha of a splat at a pixel is LOG_OPACITY - d^2 - down^2 (`projection`), with
d = WEIGHT (dx - SLOPE dy) and down = sqrt(CURVE) dy. h is the squared change of the pixel, summed
over R G B, with the natural logarithm of alpha. A parameter changes that logarithm by a polynomial
f(d, down) of degree 2. So the squared change of the picture with the parameter is the sum of h f^2
over pixels. It needs the moments of h up to degree 4: the sums of h d^i down^j.

As in `blending_gradient`, every entry of a list gets a row of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.np.unsafe.ndarray import to_fixed_tuple

from evogs_codec.render import projection as p
from evogs_codec.render.blending import (
    AHEAD,
    ALPHA_LEAST,
    ALPHA_MOST,
    EXPONENT_LEAST,
    LOG_NOTHING,
    N_CONSTANTS,
    clip_halves,
)
from evogs_codec.render.blending_gradient import begin_tile
from evogs_codec.render.compiled import (
    Scalar,
    exp2,
    inlined,
    parallel_kernel,
    prange,
    prefetch,
    row_kernel,
)
from evogs_codec.render.spans import SIDE

__all__ = ["COLOUR", "MOMENTS", "WIDTH", "blend_moments"]

Array = npt.NDArray[Any]

# Exponents (i, j) of each moment. `_unblend_tile` fills them in this order.
MOMENTS = (
    (0, 0), (0, 1), (0, 2), (0, 3), (0, 4),
    (1, 0), (1, 1), (1, 2), (1, 3),
    (2, 0), (2, 1), (2, 2),
    (3, 0), (3, 1),
    (4, 0),
)  # fmt: skip
COLOUR = len(MOMENTS)  # sum over pixels of the squared change with one of R, G, B
WIDTH = COLOUR + 1
DEGREE = 4
_MAX_CHANGE = 1e24  # of a pixel, squared: sums of its moments are finite in float32

_LANES = np.uint64(SIDE)
# Groups of a row: transmittance behind the splat; position of the last splat the pixel took; number
# of the pixel (`begin_tile`); the colour that lies behind the splat; the square of how much of the
# pixel is shown.
_T, _LAST, _LANE, _RED, _GREEN, _BLUE, _SHOWN = (np.uint64(SIDE * slot) for slot in range(7))
_ROW = np.uint64(SIDE * 7)
_STATE = SIDE * SIDE * 7


@row_kernel
def _unblend_row(
    state: Array, at: Scalar,
    base: Scalar, weight: Scalar, log_opacity: Scalar,
    red: Scalar, green: Scalar, blue: Scalar, index: Scalar, constants: Sequence[Scalar],
) -> tuple[float, ...]:  # fmt: skip
    """Take one splat off one row of pixels.

    Returns:
        The sums of h, h d, .. h d^4, and of the squared change with one colour.
    """
    real = state.dtype.type
    alpha_max = constants[ALPHA_MOST]
    sum_0, sum_1, sum_2, sum_3, sum_4 = real(0), real(0), real(0), real(0), real(0)
    of_colour = real(0)
    for lane in range(_LANES):
        i = at + lane
        d = base + weight * state[i + _LANE]
        exponent = log_opacity - d * d
        reached = exp2(max(exponent, constants[EXPONENT_LEAST]), constants)
        alpha = min(reached, alpha_max)
        alpha = alpha if alpha >= constants[ALPHA_LEAST] else real(0)
        alpha = alpha if index <= state[i + _LAST] else real(0)
        scale = real(1) / (real(1) - alpha)
        before = state[i + _T] * scale
        part, hidden = alpha * before, alpha * scale
        behind_red, behind_green = state[i + _RED], state[i + _GREEN]
        behind_blue = state[i + _BLUE]
        by_red = part * red - hidden * behind_red
        by_green = part * green - hidden * behind_green
        by_blue = part * blue - hidden * behind_blue
        state[i + _T] = before
        state[i + _RED] = behind_red + part * red
        state[i + _GREEN] = behind_green + part * green
        state[i + _BLUE] = behind_blue + part * blue
        shown = state[i + _SHOWN]
        h = min(by_red * by_red + by_green * by_green + by_blue * by_blue, real(_MAX_CHANGE))
        h = shown * h if reached < alpha_max else real(0)
        h_d = h * d
        h_dd = h_d * d
        sum_0 += h
        sum_1 += h_d
        sum_2 += h_dd
        sum_3 += h_dd * d
        sum_4 += h_dd * d * d
        of_colour += shown * part * part
    return sum_0, sum_1, sum_2, sum_3, sum_4, of_colour


@inlined
def _unblend_tile(
    state: Array, row_last: Array, entries: Array, begin: int, end: int,
    records: Array, rows: Array, x: int, y: int, constants: Array, out: Array,
) -> None:  # fmt: skip
    """Fill the rows of the entries of one tile, whose first pixel is (x, y)."""
    real = state.dtype.type
    lines = np.empty(3 * SIDE, state.dtype)
    values = to_fixed_tuple(constants, N_CONSTANTS)
    last = -1
    for row in range(SIDE):
        last = max(last, row_last[row])
    out[begin:end] = real(0)
    for j in range(begin + last, begin - 1, -1):
        splat = entries[j]
        if j - AHEAD >= begin:
            prefetch(records, entries[j - AHEAD])
            prefetch(records, entries[j - AHEAD] + 1)
            prefetch(rows, entries[j - AHEAD])
        record = records[splat]
        red, green, blue = real(record[p.RED]), real(record[p.GREEN]), real(record[p.BLUE])
        clip_halves(lines, record, x, y)
        weight, curve = real(record[p.WEIGHT]), math.sqrt(record[p.CURVE])
        for row in range(max(rows[splat, 0] - y, 0), min(rows[splat, 1] - y, SIDE)):
            if j - begin > row_last[row]:
                continue
            log_opacity = max(lines[row + SIDE], lines[row + 2 * SIDE])
            if log_opacity > LOG_NOTHING:
                sums = _unblend_row(
                    state, np.uint64(row) * _ROW, lines[row], weight, log_opacity,
                    red, green, blue, real(j - begin), values,
                )  # fmt: skip
                down = real(curve * (y + row + 0.5 - record[p.Y]))
                k = 0
                for power in range(DEGREE + 1):
                    moment = sums[power]
                    for _ in range(DEGREE + 1 - power):
                        out[j, k] += moment
                        moment *= down
                        k += 1
                out[j, COLOUR] += sums[DEGREE + 1]


@parallel_kernel
def blend_moments(
    first: int, n_columns: int, offsets: Array, entries: Array, order: Array,
    records: Array, rows: Array, background: Array, constants: Array,
    shown: Array, transmittance: Array, last: Array, out: Array, n_workers: int,
) -> None:  # fmt: skip
    """Moments of the entries of a chunk.

    Arguments, several to a line:
        first, n_columns, offsets, entries, order: `tiles.Chunk`, and tiles in a row.
        records, rows, constants, transmittance, last: as `blending.blend` has them.
        background: (H, W, 3).
        shown: (H, W) how much of the picture is seen at a pixel, of the type of the picture.
        out: (entries, WIDTH), out.
        n_workers: tiles are dealt out to so many, longest lists first.
    """
    height, width = shown.shape
    states = np.empty((n_workers, _STATE), shown.dtype)
    row_lasts = np.empty((n_workers, SIDE), np.int64)
    for worker in prange(n_workers):
        state, row_last = states[worker], row_lasts[worker]
        for i in range(worker, len(order), n_workers):
            tile = first + order[i]
            x, y = tile % n_columns * SIDE, tile // n_columns * SIDE
            pixels = state.reshape(SIDE, 7, SIDE)
            begin_tile(pixels, row_last, x, y, transmittance, last)
            for row in range(min(SIDE, height - y)):
                for lane in range(min(SIDE, width - x)):
                    for c in range(3):
                        pixels[row, 3 + c, lane] = (
                            pixels[row, 0, lane] * background[y + row, x + lane, c]
                        )
                    pixels[row, 6, lane] = shown[y + row, x + lane] ** 2
            _unblend_tile(
                state, row_last, entries, offsets[order[i]], offsets[order[i] + 1],
                records, rows, x, y, constants, out,
            )  # fmt: skip
