"""How alike two pictures are: PSNR and SSIM."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.compiled import kernel
from evogs_codec.render.similarity import ssim, ssim_gradient

__all__ = ["psnr", "ssim", "ssim_gradient"]

Real = npt.NDArray[np.floating[Any]]

_LANES = 16  # sums, so that the loop becomes vector code; their order is the same everywhere


@kernel
def _sum_of_squares(a: Real, b: Real) -> float:
    """Of the differences of two lists of numbers."""
    sums = np.zeros(_LANES)
    n = len(a) // _LANES * _LANES
    for begin in range(0, n, _LANES):
        for lane in range(_LANES):
            off = np.float64(a[begin + lane]) - np.float64(b[begin + lane])
            sums[lane] += off * off
    for i in range(n, len(a)):
        off = np.float64(a[i]) - np.float64(b[i])
        sums[i - n] += off * off
    return float(sums.sum())


def psnr(a: Real, b: Real) -> float:
    """Peak signal to noise ratio of two pictures with peak 1, dB; infinite where they are equal."""
    if a.shape != b.shape:
        raise ValueError(f"pictures of shapes {a.shape} and {b.shape}")
    if not a.size:
        raise ValueError("pictures without pixels")
    error = _sum_of_squares(np.ravel(a), np.ravel(b)) / a.size
    return math.inf if error == 0 else -10 * math.log10(error)
