"""gsplat on CUDA (an optional extra); its alpha is at most 0.999 where ours is 0.99."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from evogs_codec.render import Camera
from reference_trainer.models.tensors import SplatTensors

__all__ = ["Cuda"]

NEAR_PLANE = 0.2
RADIUS, SIGMA, C1, C2 = 5, 1.5, 0.01**2, 0.03**2  # of SSIM


class Cuda:
    """A backend on a GPU; not deterministic to the bit.

    Raises:
        ValueError: there is no such device, or gsplat is missing.
    """

    def __init__(self, device: str) -> None:
        if not torch.cuda.is_available():
            raise ValueError(f"device {device}: torch finds no CUDA device")
        if find_spec("gsplat") is None:
            raise ValueError(f"device {device} needs gsplat: pip install -e '.[cuda]'")
        self.device = torch.device(device)
        x = torch.arange(-RADIUS, RADIUS + 1, dtype=torch.float32, device=self.device)
        window = torch.exp(-(x**2) / (2 * SIGMA**2))
        self._window = (window / window.sum()).reshape(1, 1, -1, 1)
        self._pinholes: dict[Camera, tuple[Tensor, Tensor]] = {}
        self._backgrounds: dict[tuple[float, float, float], Tensor] = {}

    def photograph(self, image: npt.NDArray[np.float32]) -> Tensor:
        """A copy on the device."""
        return torch.tensor(image, device=self.device)

    def screen(self, splats: SplatTensors) -> Tensor:
        """Zeros, filled by the gradient of gsplat's own centres."""
        return torch.zeros((len(splats.means), 2), device=self.device, requires_grad=True)

    def render(
        self,
        splats: SplatTensors,
        camera: Camera,
        background: tuple[float, float, float],
        screen: Tensor,
    ) -> Tensor:
        """(H, W, 3) picture."""
        from gsplat import rasterization  # type: ignore[import-not-found, unused-ignore]

        view, intrinsics = self._pinhole(camera)
        means = splats.means
        if torch.is_grad_enabled() and not means.requires_grad:
            # No input asks for gradients: the centres do, so that `screen` gets its own.
            means = means.detach().requires_grad_(True)
        info: dict[str, Any]
        images, _, info = rasterization(
            means,
            splats.quats,
            splats.log_scales.exp(),
            splats.opacity_logits.sigmoid(),
            splats.sh,
            view,
            intrinsics,
            camera.width,
            camera.height,
            near_plane=NEAR_PLANE,
            sh_degree=round(splats.sh.shape[1] ** 0.5) - 1,
            backgrounds=self._background(background),
            packed=False,
        )
        if info["means2d"].requires_grad:
            info["means2d"].register_hook(lambda g: _keep(screen, g[0]))
        image: Tensor = images[0]
        return image

    def loss(self, image: Tensor, photograph: Tensor, ssim_weight: float) -> Tensor:
        """Photometric loss, a number."""
        difference = (image - photograph).abs().mean()
        return (1 - ssim_weight) * difference + ssim_weight * (1 - self._ssim(image, photograph))

    def _pinhole(self, camera: Camera) -> tuple[Tensor, Tensor]:
        """(1, 4, 4) world to camera and (1, 3, 3) intrinsics, copied to the device once."""
        if camera not in self._pinholes:
            view = torch.eye(4)
            view[:3, :3] = torch.tensor(camera.rotation)
            view[:3, 3] = torch.tensor(camera.translation)
            lens = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
            found = view[None].to(self.device), torch.tensor([lens]).float().to(self.device)
            self._pinholes[camera] = found
        return self._pinholes[camera]

    def _background(self, colour: tuple[float, float, float]) -> Tensor:
        """(1, 3) colour, copied to the device once."""
        if colour not in self._backgrounds:
            self._backgrounds[colour] = torch.tensor([colour], device=self.device)
        return self._backgrounds[colour]

    def _ssim(self, a: Tensor, b: Tensor) -> Tensor:
        x, y = (image.permute(2, 0, 1)[:, None] for image in (a, b))
        moments = self._blur(torch.cat([x, y, x * x, y * y, x * y])).chunk(5)
        ma, mb = moments[0], moments[1]
        vab = moments[4] - ma * mb
        va, vb = moments[2] - ma * ma, moments[3] - mb * mb
        top = (2 * ma * mb + C1) * (2 * vab + C2)
        bottom = (ma * ma + mb * mb + C1) * (va + vb + C2)
        return (top / bottom).mean()

    def _blur(self, x: Tensor) -> Tensor:
        rows = functional.conv2d(x, self._window, padding=(RADIUS, 0))
        return functional.conv2d(rows, self._window.transpose(2, 3), padding=(0, RADIUS))


def _keep(screen: Tensor, g: Tensor) -> None:
    screen.grad = g.detach().clone()
