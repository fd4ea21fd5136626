"""What follows from arithmetic alone when splats are projected, for LANES splats at a time.

The state of LANES splats is one flat array of float64: groups of LANES numbers, a group for each
quantity. The loops over lanes have a fixed length, no branch, unsigned indexes and one array, which
is what it takes to become vector code. They are IEEE arithmetic in the order that is written, so
that a splat has the same numbers in whichever lane it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render import screen as s
from evogs_codec.render.activation import LOG2_OPACITY, SCALE
from evogs_codec.render.compiled import inlined
from evogs_codec.render.harmonics import basis
from evogs_codec.render.spans import LOG_MIN

__all__ = [
    "BASIS",
    "CURVE",
    "DETERMINANT",
    "FLAT",
    "HALF_X",
    "HALF_Y",
    "LANES",
    "LOG_OPACITY",
    "PART",
    "SLOPE",
    "SLOPE_X",
    "SLOPE_Y",
    "STATE",
    "WEIGHT",
    "XX",
    "XY",
    "YY",
    "X",
    "Y",
    "Z",
    "basis_of_all",
    "fill",
    "footprints",
    "reach_of",
]

Array = npt.NDArray[Any]

LANES = 32
_LANES = np.uint64(LANES)
# Groups: the centre in the world, the rotation matrix, the standard deviations, the logarithm of
# the opacity;
_MEAN_X, _MEAN_Y, _MEAN_Z = (np.uint64(LANES * k) for k in range(3))
_R0, _R1, _R2, _R3, _R4, _R5, _R6, _R7, _R8 = (np.uint64(LANES * (3 + k)) for k in range(9))
_S0, _S1, _S2, LOG_OPACITY = (np.uint64(LANES * (12 + k)) for k in range(4))
# depth, covariance on the screen, its determinant and that without dilation, x / z and y / z;
Z, XX, XY, YY, DETERMINANT, FLAT, SLOPE_X, SLOPE_Y = (np.uint64(LANES * (16 + k)) for k in range(8))
# fields of a record; sqrt(reach / xx), and half of the width and height that alpha = 1/255 has;
X, Y, WEIGHT, SLOPE, CURVE, PART, HALF_X, HALF_Y = (np.uint64(LANES * (24 + k)) for k in range(8))
# the direction from the eye, and the functions of SH.
_DX, _DY, _DZ, BASIS = (np.uint64(LANES * (32 + k)) for k in range(4))
STATE = LANES * (35 + 16)  # numbers


@inlined
def fill(state: Array, means: Array, active: Array, first: int, n: int) -> None:
    """Put n splats into lanes 0 .. n - 1, from `first` on."""
    for lane in range(n):
        for c in range(3):
            state[lane + c * LANES] = means[first + lane, c]
        for c in range(SCALE + 3):
            state[lane + (3 + c) * LANES] = active[first + lane, c]
        state[lane + 15 * LANES] = active[first + lane, LOG2_OPACITY]


@inlined
def footprints(state: Array, view: tuple[float, ...]) -> None:
    """From depth to HALF_Y, of all lanes, and the direction."""
    for lane in range(_LANES):
        mean = (state[lane + _MEAN_X], state[lane + _MEAN_Y], state[lane + _MEAN_Z])
        active = (
            state[lane + _R0], state[lane + _R1], state[lane + _R2],
            state[lane + _R3], state[lane + _R4], state[lane + _R5],
            state[lane + _R6], state[lane + _R7], state[lane + _R8],
            state[lane + _S0], state[lane + _S1], state[lane + _S2],
        )  # fmt: skip
        x, y, z = s.to_camera(view, mean[0], mean[1], mean[2])
        u = s.half_axes(s.world_to_screen(view, x, y, z), active)
        xx, xy, yy, det, flat = s.covariance(u, view[s.DILATION])
        slope_x, slope_y, inverse = x / z, y / z, 1.0 / yy
        state[lane + Z] = z
        state[lane + XX], state[lane + XY], state[lane + YY] = xx, xy, yy
        state[lane + DETERMINANT], state[lane + FLAT] = det, flat
        state[lane + SLOPE_X], state[lane + SLOPE_Y] = slope_x, slope_y
        state[lane + X] = view[s.FX] * slope_x + view[s.CX]
        state[lane + Y] = view[s.FY] * slope_y + view[s.CY]
        state[lane + WEIGHT] = math.sqrt(0.5 * s.LOG2E * (yy / det))
        state[lane + SLOPE] = xy * inverse
        state[lane + CURVE] = 0.5 * s.LOG2E * inverse
        part, half_x, half_y = reach_of(xx, yy, state[lane + LOG_OPACITY])
        state[lane + PART], state[lane + HALF_X], state[lane + HALF_Y] = part, half_x, half_y
        dx, dy, dz = mean[0] - view[s.EYE], mean[1] - view[s.EYE + 1], mean[2] - view[s.EYE + 2]
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        state[lane + _DX], state[lane + _DY] = dx * inverse, dy * inverse
        state[lane + _DZ] = dz * inverse


@inlined
def reach_of(xx: float, yy: float, log_opacity: float) -> tuple[float, float, float]:
    """PART, HALF_X and HALF_Y of a covariance and the binary logarithm of an opacity."""
    reach = 2.0 * (log_opacity - LOG_MIN) / s.LOG2E  # squared, in standard deviations
    part = math.sqrt(reach / xx)
    return part, xx * part, math.sqrt(reach * yy)


@inlined
def basis_of_all(state: Array, n: int) -> None:
    """The first n functions of SH along the directions of all lanes."""
    for lane in range(_LANES):
        x, y, z = state[lane + _DX], state[lane + _DY], state[lane + _DZ]
        basis(x, y, z, state, lane + BASIS, _LANES, n)
