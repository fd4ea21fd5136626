"""Front to back over the pixels of tiles (spec/rasterizer.md 5).

The state of a tile is one flat array: for each pixel row, SLOTS groups of SIDE numbers. The loop
over the pixels of a row has a fixed length, no branch, unsigned indexes and one array, which is
what it takes to become vector code. `real` is the type of that array: float32 or float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render.compiled import (
    Scalar,
    exp2,
    inlined,
    parallel_kernel,
    prange,
    prefetch,
    row_kernel,
)
from evogs_codec.render.options import ALPHA_MIN, T_MIN
from evogs_codec.render.spans import LOG_MIN, SIDE

__all__ = ["AHEAD", "FAR", "blend", "clip_rows"]

Array = npt.NDArray[Any]

_LANES = np.uint64(SIDE)
# Groups of a row: transmittance, negative once the pixel is closed; colour; position in the list of
# the last splat it took; number of the pixel in its row.
_T, _RED, _GREEN, _BLUE, _LAST, _LANE = (np.uint64(SIDE * slot) for slot in range(6))
_WIDTH = SIDE * 6
_ROW = np.uint64(_WIDTH)
_PATIENCE = 8  # splats between two looks at whether rows are finished
FAR = -1000.0  # log2 alpha of nothing
AHEAD = 8  # entries of a list from one whose record is asked for to the one that is drawn


@row_kernel
def _blend_row(
    state: Array, at: Scalar, base: Scalar, weight: Scalar, log_opacity: Scalar,
    red: Scalar, green: Scalar, blue: Scalar,
    alpha_max: Scalar, alpha_min: Scalar, t_min: Scalar, index: Scalar,
) -> None:  # fmt: skip
    """Blend one splat into one row of pixels."""
    real = state.dtype.type
    for lane in range(_LANES):
        i = at + lane
        d = base + weight * state[i + _LANE]
        exponent = log_opacity - d * d
        exponent = exponent if exponent > real(-100) else real(-100)
        alpha = exp2(exponent)
        alpha = alpha if alpha < alpha_max else alpha_max
        alpha = alpha if alpha >= alpha_min else real(0)
        t = state[i + _T]
        part = t * alpha
        rest = t - part
        takes = rest >= t_min
        part = part if takes else real(0)
        state[i + _T] = rest if takes else -abs(t)
        state[i + _LAST] = index if takes else state[i + _LAST]
        state[i + _RED] += part * red
        state[i + _GREEN] += part * green
        state[i + _BLUE] += part * blue


@row_kernel
def _is_open(state: Array, at: Scalar) -> Scalar:
    """Whether any pixel of a row still takes splats."""
    most = state[at + _T]
    for lane in range(_LANES):
        t = state[at + lane + _T]
        most = t if t > most else most
    return most > 0


@inlined
def clip_rows(lines: Array, record: Array, x: int, y: int) -> None:
    """For the SIDE rows of the tile at (x, y): d of the first pixel, and log2 alpha where d = 0.

    Where the splat reaches no pixel of a row, the logarithm is FAR.
    """
    center_x, center_y, weight = record[p.X], record[p.Y], record[p.WEIGHT]
    slope, curve, log_opacity = record[p.SLOPE], record[p.CURVE], record[p.LOG_OPACITY]
    left, top = x + 0.5 - center_x, y + 0.5 - center_y
    for row in range(_LANES):
        dy = top + np.float64(np.int32(row))
        most = log_opacity - curve * dy * dy
        base = weight * (left - slope * dy)
        end = base + (SIDE - 1) * weight
        # No branch: which of the three it is cannot be predicted.
        gap = base if base > 0.0 else (end if end < 0.0 else 0.0)
        lines[row] = base
        lines[row + _LANES] = most if gap * gap <= most - LOG_MIN + 1e-4 else FAR


@inlined
def _blend_tile(
    state: Array, entries: Array, begin: int, end: int, records: Array, rows: Array,
    x: int, y: int, width: int, height: int, alpha_max: float,
) -> None:  # fmt: skip
    """Blend a list into the tile whose first pixel is (x, y)."""
    real = state.dtype.type
    is_open = np.zeros(SIDE, np.bool_)
    lines = np.empty(2 * SIDE, state.dtype)
    state[:] = real(0)
    for row in range(min(SIDE, height - y)):
        is_open[row] = True
        for lane in range(SIDE):
            i = row * _WIDTH + lane
            state[i + 5 * SIDE] = real(lane)
            state[i + 4 * SIDE] = real(-1)
            state[i] = real(1) if lane < width - x else real(-1)
    amax, amin, tmin = real(alpha_max), real(ALPHA_MIN), real(T_MIN)
    for j in range(begin, end):
        if (j - begin) % _PATIENCE == _PATIENCE - 1:
            n_open = 0
            for row in range(SIDE):
                is_open[row] = is_open[row] and _is_open(state, np.uint64(row) * _ROW)
                n_open += is_open[row]
            if n_open == 0:
                break
        splat = entries[j]
        if j + AHEAD < end:
            prefetch(records, entries[j + AHEAD])
            prefetch(records, entries[j + AHEAD] + 1)  # a record is longer than a cache line
            prefetch(rows, entries[j + AHEAD])
        record = records[splat]
        red, green, blue = real(record[p.RED]), real(record[p.GREEN]), real(record[p.BLUE])
        weight = real(record[p.WEIGHT])
        clip_rows(lines, record, x, y)
        for row in range(max(rows[splat, 0] - y, 0), min(rows[splat, 1] - y, SIDE)):
            log_opacity = lines[row + SIDE]
            if is_open[row] and log_opacity > FAR:
                _blend_row(
                    state, np.uint64(row) * _ROW, lines[row], weight, log_opacity,
                    red, green, blue, amax, amin, tmin, real(j - begin),
                )  # fmt: skip


@parallel_kernel
def blend(
    first: int, n_columns: int, offsets: Array, entries: Array, order: Array,
    records: Array, rows: Array, background: Array, alpha_max: float,
    image: Array, transmittance: Array, last: Array, n_workers: int,
) -> None:  # fmt: skip
    """Draw the tiles of a chunk.

    Arguments, several to a line:
        first, n_columns, offsets, entries, order: `tiles.Chunk`, and tiles in a row.
        records, rows: what `projection.project` made.
        background: (3,).
        alpha_max: `Options.alpha_max`.
        image: (H, W, 3), out.
        transmittance, last: (H, W) or (0, 0), out; what is left of the background, and the
            position in its tile's list of the last splat of each pixel, -1 if none.
        n_workers: tiles are dealt out to so many, longest lists first.
    """
    height, width = image.shape[:2]
    states = np.empty((n_workers, SIDE * _WIDTH), image.dtype)
    for worker in prange(n_workers):
        state = states[worker]
        for i in range(worker, len(order), n_workers):
            tile = first + order[i]
            x, y = tile % n_columns * SIDE, tile // n_columns * SIDE
            _blend_tile(
                state, entries, offsets[order[i]], offsets[order[i] + 1], records, rows,
                x, y, width, height, alpha_max,
            )  # fmt: skip
            for row in range(min(SIDE, height - y)):
                for lane in range(min(SIDE, width - x)):
                    at = row * _WIDTH + lane
                    t = abs(state[at])
                    for c in range(3):
                        image[y + row, x + lane, c] = state[at + (1 + c) * SIDE] + t * background[c]
                    if len(last):
                        transmittance[y + row, x + lane] = t
                        last[y + row, x + lane] = np.int32(state[at + 4 * SIDE])
