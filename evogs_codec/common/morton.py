"""Morton codes: points along a Z curve."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["morton_order"]

BITS = 21  # of an axis: three fit into 64


def morton_order(points: npt.NDArray[np.floating]) -> npt.NDArray[np.int64]:
    """(n,) the points (3, n) along the Z curve of their bounding cube; equal codes keep order."""
    if not points.shape[1]:
        return np.empty(0, np.int64)
    p = points.astype(np.float64)
    p -= p.min(axis=1, keepdims=True)
    extent = float(p.max())
    if extent > 0:
        p /= extent
    cells = (p * (2**BITS - 1)).astype(np.uint64)
    code = np.zeros(p.shape[1], np.uint64)
    for axis in range(3):
        code |= _every_third_bit(cells[axis]) << np.uint64(axis)
    order: npt.NDArray[np.int64] = np.argsort(code, kind="stable")
    return order


def _every_third_bit(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Bit b of the 21 low bits moves to bit 3 b."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
