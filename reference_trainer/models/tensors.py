"""`SplatTensors`: the parameters of splats as five torch tensors, and the way from and to numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from evogs_codec import SplatParams

__all__ = ["SplatTensors"]


class SplatTensors(NamedTuple):
    """N splats before activation, on one device; also anything shaped like them, such as psi.

    Attributes:
        means: (N, 3). quats: (N, 4), w x y z. log_scales: (N, 3). opacity_logits: (N,).
        sh: (N, K, 3).
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    opacity_logits: Tensor
    sh: Tensor

    @staticmethod
    def of(splats: SplatParams, device: torch.device | str = "cpu") -> SplatTensors:
        """A copy of `splats` as tensors."""
        arrays = (splats.means, splats.quats, splats.log_scales, splats.opacity_logits, splats.sh)
        return SplatTensors(*(torch.tensor(array, device=device) for array in arrays))

    def params(self) -> SplatParams:
        """A copy as arrays."""
        return SplatParams(*(np.array(x.detach().cpu().numpy()) for x in self))

    def trainable(self) -> SplatTensors:
        """The same tensors, asking for gradients."""
        return SplatTensors(*(x.detach().requires_grad_(True) for x in self))

    def rows(self, rows: Tensor) -> SplatTensors:
        """The splats of `rows`, in that order, without gradients."""
        return SplatTensors(*(x.detach()[rows] for x in self))

    def joined(self, other: SplatTensors) -> SplatTensors:
        """These splats, then the others."""
        return SplatTensors(*(torch.cat(pair) for pair in zip(self, other, strict=True)))
