"""Back to front over the pixels of tiles: from the gradient of a picture to that of its records.

Every entry of a list gets a row of its own, filled by the tile that owns it; the rows of a splat
are then added in the order of the lists. So no number is added to by two threads, and the sums do
not depend on their number. A row holds the gradients to ENTRY: the centre, the logarithms of
WEIGHT^2 and CURVE, the SLOPE, the logarithm of the opacity, and R G B.
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

__all__ = ["ENTRY", "add_up", "begin_tile", "blend_gradient"]

Array = npt.NDArray[Any]

ENTRY = ("x", "y", "log_a", "log_c", "slope", "log_opacity", "red", "green", "blue")
WIDTH = len(ENTRY)
_LN2 = math.log(2.0)
_2LN2 = 2 * _LN2

_LANES = np.uint64(SIDE)
# Groups of a row: transmittance behind the splat; position of the last splat the pixel took; number
# of the pixel (`begin_tile`); what lies behind the splat, in the direction of the gradient; the
# gradient.
_T, _LAST, _LANE, _BEHIND, _GR, _GG, _GB = (np.uint64(SIDE * slot) for slot in range(7))
_ROW = np.uint64(SIDE * 7)
# Groups of the sums over rows, for each of the 16 columns of pixels.
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8 = (np.uint64(SIDE * k) for k in range(1, WIDTH))
_STATE = SIDE * SIDE * 7
_SUM_AHEAD = 32  # entries of a list from one whose sums are asked for to the one that is added
_SUMS = SIDE * WIDTH


@inlined
def begin_tile(
    state: Array, row_last: Array, x: int, y: int, transmittance: Array, last: Array
) -> None:
    """Begin behind all splats of a tile, whose first pixel is (x, y); its other groups are 0.

    Arguments, several to a line:
        state: (rows, groups, columns), out: groups 0 to 2 are transmittance, last splat and column.
        row_last: (rows,), out: the last of the last splats of each row, -1 of none.
        transmittance, last: (H, W) of the picture.
    """
    real = state.dtype.type
    height, width = last.shape
    state[:] = real(0)
    row_last[:] = -1
    for row in range(SIDE):
        for lane in range(SIDE):
            state[row, 1, lane], state[row, 2, lane] = real(-1), real(lane)
            if y + row < height and x + lane < width:
                state[row, 0, lane] = transmittance[y + row, x + lane]
                state[row, 1, lane] = real(last[y + row, x + lane])
                row_last[row] = max(row_last[row], last[y + row, x + lane])


@row_kernel
def _unblend_row(
    state: Array, sums: Array, at: Scalar,
    base: Scalar, weight: Scalar, log_opacity: Scalar, down: Scalar,
    red: Scalar, green: Scalar, blue: Scalar, index: Scalar, constants: Sequence[Scalar],
) -> None:  # fmt: skip
    """Take one splat off one row of pixels.

    With g the gradient to log alpha (natural), d as in `projection` and `down` = sqrt(CURVE) dy:
    adds g times 1, d, d d, down, down down, d down to the sums, and the gradient to R G B.
    """
    real = state.dtype.type
    alpha_max = constants[ALPHA_MOST]
    for lane in range(_LANES):
        i = at + lane
        d = base + weight * state[i + _LANE]
        exponent = log_opacity - d * d
        reached = exp2(max(exponent, constants[EXPONENT_LEAST]), constants)
        alpha = min(reached, alpha_max)
        alpha = alpha if alpha >= constants[ALPHA_LEAST] else real(0)
        alpha = alpha if index <= state[i + _LAST] else real(0)
        behind = state[i + _BEHIND]
        scale = real(1) / (real(1) - alpha)
        t = state[i + _T]
        before = t * scale
        part = alpha * before
        colour = red * state[i + _GR] + green * state[i + _GG] + blue * state[i + _GB]
        g = alpha * scale * (t * colour - behind)
        g = g if reached < alpha_max else real(0)
        state[i + _T] = before
        state[i + _BEHIND] = behind + part * colour
        gd, gy = g * d, g * down
        sums[lane] += g
        sums[lane + _S1] += gd
        sums[lane + _S2] += gd * d
        sums[lane + _S3] += gy
        sums[lane + _S4] += gy * down
        sums[lane + _S5] += gd * down
        sums[lane + _S6] += part * state[i + _GR]
        sums[lane + _S7] += part * state[i + _GG]
        sums[lane + _S8] += part * state[i + _GB]


@row_kernel
def _sum_of(sums: Array, k: Scalar) -> float:
    """One of the sums over all pixels; it begins at zero again."""
    total = sums.dtype.type(0)
    for lane in range(_LANES):
        total += sums[k * _LANES + lane]
        sums[k * _LANES + lane] = sums.dtype.type(0)
    return np.float64(total)


@inlined
def _unblend_tile(
    state: Array, sums: Array, row_last: Array, entries: Array, begin: int, end: int,
    records: Array, rows: Array, x: int, y: int, constants: Array, out: Array,
) -> None:  # fmt: skip
    """Fill the rows of the entries of one tile, whose first pixel is (x, y)."""
    real = state.dtype.type
    lines = np.empty(3 * SIDE, state.dtype)
    values = to_fixed_tuple(constants, N_CONSTANTS)
    last = -1
    for row in range(SIDE):
        last = max(last, row_last[row])
    out[begin + last + 1 : end] = real(0)
    for j in range(begin + last, begin - 1, -1):
        splat = entries[j]
        if j - AHEAD >= begin:
            prefetch(records, entries[j - AHEAD])
            prefetch(records, entries[j - AHEAD] + 1)
            prefetch(rows, entries[j - AHEAD])
        record = records[splat]
        red, green, blue = real(record[p.RED]), real(record[p.GREEN]), real(record[p.BLUE])
        clip_halves(lines, record, x, y)
        weight, slope, curve = record[p.WEIGHT], record[p.SLOPE], math.sqrt(record[p.CURVE])
        for row in range(max(rows[splat, 0] - y, 0), min(rows[splat, 1] - y, SIDE)):
            if j - begin > row_last[row]:
                continue
            log_opacity = max(lines[row + SIDE], lines[row + 2 * SIDE])
            if log_opacity > LOG_NOTHING:
                down = curve * (y + row + 0.5 - record[p.Y])
                _unblend_row(
                    state, sums, np.uint64(row) * _ROW, lines[row], real(weight), log_opacity,
                    real(down), red, green, blue, real(j - begin), values,
                )  # fmt: skip
        sum_1 = _sum_of(sums, np.uint64(1))
        sum_y = _sum_of(sums, np.uint64(3))
        sum_1y = _sum_of(sums, np.uint64(5))
        # g is to the natural logarithm, d^2 and down^2 are in units of the binary one.
        out[j, 0] = real(_2LN2 * weight * sum_1)
        out[j, 1] = real(_2LN2 * (curve * sum_y - weight * slope * sum_1))
        out[j, 2] = real(-_LN2 * _sum_of(sums, np.uint64(2)))
        out[j, 3] = real(-_LN2 * _sum_of(sums, np.uint64(4)))
        out[j, 4] = real(_2LN2 * (weight / curve) * sum_1y)
        out[j, 5] = real(_sum_of(sums, np.uint64(0)))
        out[j, 6] = real(_sum_of(sums, np.uint64(6)))
        out[j, 7] = real(_sum_of(sums, np.uint64(7)))
        out[j, 8] = real(_sum_of(sums, np.uint64(8)))


@parallel_kernel
def blend_gradient(
    first: int, n_columns: int, offsets: Array, entries: Array, order: Array,
    records: Array, rows: Array, background: Array, constants: Array,
    gradient: Array, transmittance: Array, last: Array, out: Array, n_workers: int,
) -> None:  # fmt: skip
    """Gradients to the entries of a chunk.

    Arguments, several to a line:
        first, n_columns, offsets, entries, order: `tiles.Chunk`, and tiles in a row.
        records, rows, constants, transmittance, last: as `blending.blend` has them.
        background: (H, W, 3).
        gradient: (H, W, 3) of the loss to the picture, of the type of the picture.
        out: (entries, WIDTH), out.
        n_workers: tiles are dealt out to so many, longest lists first.
    """
    height, width = gradient.shape[:2]
    states = np.empty((n_workers, _STATE), gradient.dtype)
    sums = np.zeros((n_workers, _SUMS), gradient.dtype)
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
                        g = gradient[y + row, x + lane, c]
                        pixels[row, 4 + c, lane] = g
                        pixels[row, 3, lane] += (
                            pixels[row, 0, lane] * background[y + row, x + lane, c] * g
                        )
            _unblend_tile(
                state, sums[worker], row_last, entries, offsets[order[i]], offsets[order[i] + 1],
                records, rows, x, y, constants, out,
            )  # fmt: skip


@parallel_kernel
def add_up(offsets: Array, block_ends: Array, entries: Array, rows: Array, out: Array) -> None:
    """Add the row of every entry to that of its splat, tile after tile.

    A splat is in one block: each worker adds the entries of its own.
    """
    for block in prange(len(block_ends)):
        for tile in range(len(offsets) - 1):
            begin = block_ends[block - 1, tile] if block else 0
            for j in range(offsets[tile] + begin, offsets[tile] + block_ends[block, tile]):
                splat = entries[j]
                if j + _SUM_AHEAD < len(entries):
                    prefetch(out, entries[j + _SUM_AHEAD])
                    prefetch(out, entries[j + _SUM_AHEAD] + 1)
                for c in range(rows.shape[1]):
                    out[splat, c] += rows[j, c]
