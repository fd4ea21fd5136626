"""The kernels of `evogs_codec.render`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from evogs_codec.render import Camera
from reference_trainer.models import autograd
from reference_trainer.models.tensors import SplatTensors

__all__ = ["Cpu"]


class Cpu:
    """A backend on the processor; the same bits for any number of threads."""

    device = torch.device("cpu")

    def photograph(self, image: npt.NDArray[np.float32]) -> Tensor:
        """The same memory."""
        return torch.from_numpy(np.ascontiguousarray(image))

    def screen(self, splats: SplatTensors) -> Tensor:
        """Zeros."""
        return torch.zeros((len(splats.means), 2), requires_grad=True)

    def render(
        self,
        splats: SplatTensors,
        camera: Camera,
        background: tuple[float, float, float],
        screen: Tensor,
    ) -> Tensor:
        """(H, W, 3) picture."""
        return autograd.render(*splats, camera=camera, background=background, screen=screen)

    def loss(self, image: Tensor, photograph: Tensor, ssim_weight: float) -> Tensor:
        """Photometric loss, a number."""
        return autograd.photometric_loss(image, photograph, ssim_weight)
