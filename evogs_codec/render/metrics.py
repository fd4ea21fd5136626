"""How alike two pictures are: PSNR and SSIM."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.similarity import ssim, ssim_gradient

__all__ = ["psnr", "ssim", "ssim_gradient"]

Real = npt.NDArray[np.floating[Any]]


def psnr(a: Real, b: Real) -> float:
    """Peak signal to noise ratio of two pictures with peak 1, dB; infinite where they are equal."""
    if a.shape != b.shape:
        raise ValueError(f"pictures of shapes {a.shape} and {b.shape}")
    off = np.subtract(a, b, dtype=np.float64)
    error = float(np.mean(np.square(off, out=off)))
    return math.inf if error == 0 else -10 * math.log10(error)
