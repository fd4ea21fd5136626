"""Which splats to split or remove: gradients on the screen, and what is of no use."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams

__all__ = ["ScreenGradients", "largest", "useless"]

Array = npt.NDArray[Any]


class ScreenGradients:
    """Mean length of the gradients to the centres of N splats, over the pictures that show them.

    Attributes:
        total: (N,) sum of the lengths, in normalised device coordinates.
        count: (N,) pictures.
    """

    def __init__(self, n: int) -> None:
        self.total = np.zeros(n, np.float64)
        self.count = np.zeros(n, np.int32)

    def add(self, centers: Array, width: int, height: int) -> None:
        """Count a picture: `centers` (N, 2) per pixel."""
        x, y = centers[:, 0] * (0.5 * width), centers[:, 1] * (0.5 * height)
        length = np.sqrt(x * x + y * y)
        self.total += length
        self.count += length > 0

    def mean(self) -> npt.NDArray[np.float64]:
        """(N,), zero where no picture showed the splat."""
        return self.total / np.maximum(self.count, 1)


def largest(scores: Array, threshold: float, most: int) -> npt.NDArray[np.int64]:
    """Rows whose score is over the threshold, the `most` largest of them, in rising order."""
    order = np.argsort(-scores, kind="stable")[: max(most, 0)]
    return np.sort(order[scores[order] > threshold])


def useless(splats: SplatParams, opacity: float, size: float) -> npt.NDArray[np.bool_]:
    """(N,) True for splats less opaque, or wider, than this, or not finite."""
    logit = np.log(opacity / (1 - opacity))
    faint = splats.opacity_logits < logit
    wide = splats.log_scales.max(axis=1) > np.log(size)
    dead: npt.NDArray[np.bool_] = faint | wide | ~splats.finite()
    return dead
