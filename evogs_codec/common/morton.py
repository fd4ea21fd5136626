"""The bits of Z curves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["every_third_bit"]


def every_third_bit(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
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
