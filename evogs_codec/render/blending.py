"""Front to back over the pixels of tiles (spec/rasterizer.md 5).

The state of a tile is one flat array: for each pixel row, SLOTS groups of SIDE numbers. Half of a
row is blended at a time, since most splats are narrower than a tile. The loop over its pixels has a
fixed length, no branch, unsigned indexes and one array, which is what it takes to become vector
code. `real` is the type of that array: float32 or float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.np.unsafe.ndarray import to_fixed_tuple

from evogs_codec.render import projection as p
from evogs_codec.render.compiled import (
    POWERS,
    Scalar,
    exp2,
    inlined,
    parallel_kernel,
    prange,
    prefetch,
    row_kernel,
)
from evogs_codec.render.options import ALPHA_MIN, T_MIN, Options
from evogs_codec.render.spans import LOG_MIN, SIDE

__all__ = [
    "AHEAD",
    "ALPHA_LEAST",
    "ALPHA_MOST",
    "EXPONENT_LEAST",
    "LOG_NOTHING",
    "N_CONSTANTS",
    "blend",
    "clip_halves",
    "constants_of",
]

Array = npt.NDArray[Any]

_LANES = np.uint64(SIDE)
_HALF = np.uint64(SIDE // 2)
# Groups of a row: transmittance, negative once the pixel is closed; colour; position in the list of
# the last splat it took; number of the pixel in its row.
_T, _RED, _GREEN, _BLUE, _LAST, _LANE = (np.uint64(SIDE * slot) for slot in range(6))
_WIDTH = SIDE * 6
_ROW = np.uint64(_WIDTH)
_PATIENCE = 16  # splats between two looks at whether rows are finished
LOG_NOTHING = -1000.0  # log2 alpha of nothing
AHEAD = 8  # entries of a list from one whose record is asked for to the one that is drawn

# Places in `constants_of`, after `POWERS`.
EXPONENT_LEAST, ALPHA_LEAST, ALPHA_MOST, _T_LEAST = range(len(POWERS), len(POWERS) + 4)
N_CONSTANTS = len(POWERS) + 4


def constants_of(options: Options, dtype: npt.DTypeLike) -> Array:
    """(N_CONSTANTS,) what the loops over pixels compute with, of the type of the picture."""
    return np.array([*POWERS, -100, ALPHA_MIN, options.alpha_max, T_MIN], dtype)


@row_kernel
def _blend_half(
    state: Array, at: Scalar, base: Scalar, weight: Scalar, log_opacity: Scalar,
    red: Scalar, green: Scalar, blue: Scalar, index: Scalar, constants: Sequence[Scalar],
) -> None:  # fmt: skip
    """Blend one splat into half of a row of pixels."""
    real = state.dtype.type
    for lane in range(_HALF):
        i = at + lane
        d = base + weight * state[i + _LANE]
        exponent = log_opacity - d * d
        exponent = max(exponent, constants[EXPONENT_LEAST])
        alpha = min(exp2(exponent, constants), constants[ALPHA_MOST])
        alpha = alpha if alpha >= constants[ALPHA_LEAST] else real(0)
        t = state[i + _T]
        part = t * alpha
        rest = t - part
        takes = rest >= constants[_T_LEAST]
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
def _row_in(row: int) -> Scalar:
    """The nearest of 0..SIDE, unsigned: what is indexed by it is not looked at for its sign."""
    return np.uint64(min(max(row, 0), SIDE))


@inlined
def _log_alpha(first: float, last: float, most: float) -> float:
    """The most of log2 alpha; `LOG_NOTHING` if alpha shows for no d from the first to the last."""
    # No branch: which of the three it is cannot be predicted.
    gap = first if first > 0.0 else (last if last < 0.0 else 0.0)
    return most if gap * gap <= most - LOG_MIN + 1e-4 else LOG_NOTHING


@inlined
def clip_halves(lines: Array, record: Array, x: int, y: int) -> None:
    """For the SIDE rows of the tile at (x, y): d of the first pixel, and log2 alpha where d = 0.

    The logarithm is that of left halves, then that of right halves; `LOG_NOTHING` where the splat
    reaches no pixel of a half.
    """
    center_x, center_y, weight = record[p.X], record[p.Y], record[p.WEIGHT]
    slope, curve, log_opacity = record[p.SLOPE], record[p.CURVE], record[p.LOG_OPACITY]
    left, top = x + 0.5 - center_x, y + 0.5 - center_y
    for row in range(_LANES):
        dy = top + np.float64(np.int32(row))
        most = log_opacity - curve * dy * dy
        base = weight * (left - slope * dy)
        middle, end = base + (SIDE // 2) * weight, base + (SIDE - 1) * weight
        lines[row] = base
        lines[row + _LANES] = _log_alpha(base, middle - weight, most)
        lines[row + _LANES + _LANES] = _log_alpha(middle, end, most)


@inlined
def _blend_tile(
    state: Array, entries: Array, begin: int, end: int, records: Array, rows: Array,
    x: int, y: int, width: int, height: int, constants: Array,
) -> None:  # fmt: skip
    """Blend a list into the tile whose first pixel is (x, y)."""
    real = state.dtype.type
    is_open = np.zeros(SIDE, np.bool_)
    lines = np.empty(3 * SIDE, state.dtype)
    state[:] = real(0)
    for row in range(min(SIDE, height - y)):
        is_open[row] = True
        for lane in range(SIDE):
            i = row * _WIDTH + lane
            state[i + 5 * SIDE] = real(lane)
            state[i + 4 * SIDE] = real(-1)
            state[i] = real(1) if lane < width - x else real(-1)
    values = to_fixed_tuple(constants, N_CONSTANTS)
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
        clip_halves(lines, record, x, y)
        for row in range(_row_in(rows[splat, 0] - y), _row_in(rows[splat, 1] - y)):
            if not is_open[row]:
                continue
            for half in range(np.uint64(2)):
                log_opacity = lines[row + _LANES + half * _LANES]
                if log_opacity > LOG_NOTHING:
                    _blend_half(
                        state, row * _ROW + half * _HALF, lines[row], weight, log_opacity,
                        red, green, blue, real(j - begin), values,
                    )  # fmt: skip


@parallel_kernel
def blend(
    first: int, n_columns: int, offsets: Array, entries: Array, order: Array,
    records: Array, rows: Array, background: Array, constants: Array,
    image: Array, transmittance: Array, last: Array, n_workers: int,
) -> None:  # fmt: skip
    """Draw the tiles of a chunk.

    Arguments, several to a line:
        first, n_columns, offsets, entries, order: `tiles.Chunk`, and tiles in a row.
        records, rows: what `projection.project` made.
        background: (3,).
        constants: `constants_of`.
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
                x, y, width, height, constants,
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
