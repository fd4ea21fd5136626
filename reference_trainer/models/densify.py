"""Which splats to split or remove: gradients on the screen, and what is of no use; widths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from evogs_codec import SplatParams
from reference_trainer.models.saved import Arrays, taken

__all__ = ["ScreenGradients", "largest", "log_widths", "reach_of", "useless"]

Array = npt.NDArray[Any]


class ScreenGradients:
    """Mean length of the gradients to the centres of N splats, over the pictures that show them.

    Attributes:
        total: (N,) float64, sum of the lengths, in normalised device coordinates.
        count: (N,) int32, pictures.
    """

    def __init__(self, n: int, device: torch.device) -> None:
        self.total = torch.zeros(n, dtype=torch.float64, device=device)
        self.count = torch.zeros(n, dtype=torch.int32, device=device)

    def add(self, centers: Tensor, width: int, height: int) -> None:
        """Count a picture: `centers` (N, 2) per pixel, on the device."""
        x, y = centers[:, 0] * (0.5 * width), centers[:, 1] * (0.5 * height)
        length = (x * x + y * y).double().sqrt().float()  # torch rounds float32 roots elsewhere
        self.total += length
        self.count += length > 0

    def mean(self) -> npt.NDArray[np.float64]:
        """(N,), zero where no picture showed the splat."""
        found: npt.NDArray[np.float64] = (self.total / self.count.clamp(min=1)).cpu().numpy()
        return found

    def arrays(self) -> Arrays:
        """For a checkpoint."""
        return {"total": self.total.cpu().numpy(), "count": self.count.cpu().numpy()}

    def restore(self, arrays: Arrays) -> None:
        """The inverse of `arrays`, of as many splats.

        Raises:
            InputError: the arrays are of no such gradients.
        """
        n, device = len(self.total), self.total.device
        self.total = torch.from_numpy(taken(arrays, "total", np.float64, n)).to(device)
        self.count = torch.from_numpy(taken(arrays, "count", np.int32, n)).to(device)


def largest(scores: Array, threshold: float, most: int) -> npt.NDArray[np.int64]:
    """Rows whose score is over the threshold, the `most` largest of them, in rising order."""
    order = np.argsort(-scores, kind="stable")[: max(most, 0)]
    return np.sort(order[scores[order] > threshold])


def useless(
    splats: SplatParams, opacity: float, part: float, sizes: npt.NDArray[np.floating]
) -> npt.NDArray[np.bool_]:
    """(N,) True for splats less opaque, or wider than this part of `sizes`, or not finite."""
    logit = np.log(opacity / (1 - opacity))
    faint = splats.opacity_logits < logit
    wide = splats.log_scales.max(axis=1) > np.log(part) + np.log(sizes)
    dead: npt.NDArray[np.bool_] = faint | wide | ~splats.finite()
    return dead


def log_widths(log_scales: Array) -> Array:
    """(N,) logarithms of the geometric mean of the two larger standard deviations."""
    found: Array = np.sort(log_scales, axis=1)[:, 1:].mean(axis=1)
    return found


def reach_of(part: float, log_scales: Array) -> float:
    """This part of the median width of splats; no limit if it is 0, or without splats."""
    if not part or not len(log_scales):
        return math.inf
    return part * math.exp(np.median(log_widths(log_scales)))
