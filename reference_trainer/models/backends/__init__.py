"""Where pictures are made: on the processor by our kernels, on CUDA by gsplat."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from evogs_codec.render import Camera
from reference_trainer.models.tensors import SplatTensors

__all__ = ["Backend", "backend_for"]

Colour = tuple[float, float, float]


class Backend(Protocol):
    """Renders and compares, with gradients."""

    device: torch.device

    def photograph(self, image: npt.NDArray[np.float32]) -> Tensor:
        """A photograph (H, W, 3) on the device."""

    def screen(self, splats: SplatTensors) -> Tensor:
        """(N, 2) zeros that `render` gives the gradient to the centres on the screen, per pixel."""

    def render(
        self, splats: SplatTensors, camera: Camera, background: Colour, screen: Tensor
    ) -> Tensor:
        """(H, W, 3) picture."""

    def loss(self, image: Tensor, photograph: Tensor, ssim_weight: float) -> Tensor:
        """Photometric loss, a number."""


def backend_for(device: str) -> Backend:
    """The backend of a device: "cpu", "cuda" or "cuda:1".

    Raises:
        ValueError: there is no such device, or gsplat is missing.
    """
    if device == "cpu":
        from reference_trainer.models.backends.cpu import Cpu

        return Cpu()
    if device.startswith("cuda"):
        from reference_trainer.models.backends.cuda import Cuda

        return Cuda(device)
    raise ValueError(f"device {device!r} is neither cpu nor cuda")
