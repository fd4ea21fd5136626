"""Which tiles a splat meets: in each row of tiles, the columns where its alpha reaches 1/255.

A tile is SIDE x SIDE pixels. The span of a splat has its first row of tiles and the one after its
last, then the first column and the one after the last of each of its first RUNS rows.
"""

from __future__ import annotations

import math
from typing import Any

import numpy.typing as npt

from evogs_codec.render.compiled import inlined
from evogs_codec.render.options import ALPHA_MIN

__all__ = ["LOG_MIN", "MARGIN", "RUNS", "SIDE", "SPAN", "columns_of", "fill_span"]

Array = npt.NDArray[Any]

SIDE = 16
RUNS = 3  # rows of tiles: most splats are in no more
SPAN = 2 + 2 * RUNS  # numbers
LOG_MIN = math.log2(ALPHA_MIN)
MARGIN = 1e-3  # pixels; boxes are a little larger than they need to be


@inlined
def columns_of(
    x: float, y: float, weight: float, slope: float, curve: float, log_opacity: float,
    widest: float, first: int, last: int, row: int, width: int,
) -> tuple[int, int]:  # fmt: skip
    """Tile columns [first, last) where alpha reaches 1/255 in a row of tiles.

    Arguments, several to a line:
        x, y, weight, slope, curve, log_opacity, widest: fields of the record of a splat.
        first, last: its rows of pixels.
        row: of tiles.
        width: pixels.
    """
    # The ellipse between two dy: its rightmost point is at `widest` or at the nearer end.
    top = max(row * SIDE, first) + 0.5 - y
    bottom = min(row * SIDE + SIDE, last) - 0.5 - y
    room, inverse = log_opacity - LOG_MIN, 1.0 / weight
    dy = min(max(widest, top), bottom)
    right = math.sqrt(max(0.0, room - curve * dy * dy)) * inverse
    right += slope * dy + x + MARGIN
    dy = min(max(-widest, top), bottom)
    left = -math.sqrt(max(0.0, room - curve * dy * dy)) * inverse
    left += slope * dy + x - MARGIN
    # Pixels whose centres are between them. NaN (an infinite splat) means all.
    begin, end = 0, width
    if left > 0.5:
        begin = width if left > width else math.ceil(left - 0.5)
    if right < width - 0.5:
        end = 0 if right < 0.5 else math.floor(right - 0.5) + 1
    if begin >= end:
        return 0, 0
    return begin // SIDE, (end - 1) // SIDE + 1


@inlined
def fill_span(
    x: float, y: float, weight: float, slope: float, curve: float, log_opacity: float,
    widest: float, first: int, last: int, width: int, spans: Array, i: int,
) -> None:  # fmt: skip
    """Fill the span of splat i, in (N, SPAN); other arguments as of `columns_of`."""
    begin, end = first // SIDE, (last - 1) // SIDE + 1
    spans[i, 0], spans[i, 1] = begin, end
    for row in range(begin, min(end, begin + RUNS)):
        k = 2 + 2 * (row - begin)
        spans[i, k], spans[i, k + 1] = columns_of(
            x, y, weight, slope, curve, log_opacity, widest, first, last, row, width
        )
