"""Views of a scene, by which an encoder judges accuracy (entry point of `evogs.pictures`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from conformance.rasterizer import Camera, draw, gradients, psnr, render
from evogs_codec import SplatParams
from evogs_codec.splats import F32

__all__ = ["DRAWN", "Color", "Views"]

Color = tuple[float, float, float]
DRAWN = 12  # views that the sensitivity is estimated from, at most


@dataclass(frozen=True)
class Views:
    """Pictures of a scene.

    Attributes:
        scene: what others are compared with.
        cameras: of the views.
        background: behind the splats.
    """

    scene: SplatParams
    cameras: Sequence[Camera]
    background: Color = (1.0, 1.0, 1.0)

    def psnr(self, splats: SplatParams) -> float:
        """Mean PSNR over the views, dB."""
        found = [
            psnr(render(splats, camera, self.background), picture)
            for camera, picture in zip(self.cameras, self.pictures, strict=True)
        ]
        return float(np.mean(found))

    def sensitivity(self, splats: SplatParams) -> F32:
        """(D, N) mean squared change of the pictures to the squared change of each number.

        The gradient of a picture of random signs z, J^T z, has the squared length of a column of J
        as the mean of its square: one backward pass per view sees every number of every splat.
        """
        rng = np.random.default_rng(0)
        total: F32 = np.zeros((len(splats.channels()), len(splats)), np.float32)
        chosen = self.cameras[:: -(-len(self.cameras) // DRAWN)]
        for camera in chosen:
            drawing = draw(splats, camera, self.background)
            signs = rng.integers(0, 2, drawing.image.shape).astype(np.float32) * 2 - 1
            found = gradients(drawing, splats, signs)
            rows = SplatParams(
                found.means, found.quats, found.log_scales, found.opacity_logits, found.sh
            )
            total += np.square(rows.channels()) / np.float32(signs.size)
        total /= len(chosen)
        return total

    @cached_property
    def pictures(self) -> list[npt.NDArray[np.float32]]:
        """Of the scene, (H, W, 3) each."""
        return [render(self.scene, camera, self.background) for camera in self.cameras]
