"""Rendered views of a scene, by which an encoder judges accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32, SplatParams
from evogs_codec.render.camera import Camera
from evogs_codec.render.forward import Drawing, draw, render
from evogs_codec.render.gradients import gradients
from evogs_codec.render.metrics import psnr
from evogs_codec.render.viewpoints import camera_rings, cameras_around

__all__ = ["DRAWN", "HELD_OUT", "Colour", "Views", "view_of"]

Colour = tuple[float, float, float]
MOST = 150.0  # dB of a view: of one without any error, for a mean that is a number
DRAWN = 12  # views that the sensitivity is estimated from, at most
HELD_OUT = 5  # every 5th of the cameras given judges what descends on the others


@dataclass(frozen=True)
class Views:
    """Pictures of a scene.

    Attributes:
        scene: what others are compared with.
        cameras: of the views.
        background: behind the splats.
        others: cameras of the views that descent goes by.
    """

    scene: SplatParams
    cameras: Sequence[Camera]
    background: Colour = (1.0, 1.0, 1.0)
    others: Sequence[Camera] = ()

    @staticmethod
    def of(
        scene: SplatParams,
        cameras: Sequence[Camera] | None = None,
        *,
        up: str = "z",
        n_views: int | None = None,
        descent: bool = False,
    ) -> Views:
        """The views that `evogs encode` judges by.

        Args:
            scene: what they show.
            cameras: theirs; by default 24 on a circle around the scene.
            up: axis that is up in the default views: x, y or z, perhaps with a minus.
            n_views: at most this many views.
            descent: with `others`, for `loss_gradient`: 80 on circles around the scene, or of
                the `cameras` given all but every 5th, which judges.

        Raises:
            ValueError: there is one camera only, and `descent` needs two.
        """
        others: Sequence[Camera] = ()
        if cameras is None:
            chosen: Sequence[Camera] = cameras_around(scene, up)
            others = camera_rings(scene, up, 2) if descent else ()
        elif descent:
            if len(cameras) < 2:
                raise ValueError(f"{len(cameras)} camera, expected at least 2")
            chosen = cameras[::HELD_OUT]
            others = [other for k, other in enumerate(cameras) if k % HELD_OUT]
        else:
            chosen = cameras
        every = 1 if n_views is None else -(-len(chosen) // n_views)
        return Views(scene, chosen[::every], others=others)

    def psnr(self, splats: SplatParams) -> float:
        """Mean PSNR over the views, dB; over those that show the scene, if some do."""
        empty = np.array(self.background, np.float32)
        shows = [bool((picture != empty).any()) for picture in self.pictures]
        found = [
            min(psnr(render(splats, camera, self.background), picture), MOST)
            for camera, picture, is_shown in zip(self.cameras, self.pictures, shows, strict=True)
            if is_shown or not any(shows)
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
            total += np.square(_gradients(drawing, splats, signs)) / np.float32(signs.size)
        total /= len(chosen)
        return total

    def loss_gradient(self, splats: SplatParams, iteration: int) -> F32:
        """(D, N) gradient of the mean squared error of a view of `others`, one per iteration.

        Raises:
            ValueError: there are no others.
        """
        if not self.others:
            raise ValueError("there are no other views to descend by")
        view = view_of(iteration, len(self.others))
        camera = self.others[view]
        if view not in self._of_others:
            self._of_others[view] = render(self.scene, camera, self.background)
        drawing = draw(splats, camera, self.background)
        error = drawing.image - self._of_others[view]
        return _gradients(drawing, splats, error * np.float32(2 / error.size))

    @cached_property
    def _of_others(self) -> dict[int, npt.NDArray[np.float32]]:
        """Pictures of the scene that `loss_gradient` has drawn."""
        return {}

    @cached_property
    def pictures(self) -> list[npt.NDArray[np.float32]]:
        """Of the scene, (H, W, 3) each."""
        return [render(self.scene, camera, self.background) for camera in self.cameras]


def view_of(iteration: int, n_views: int) -> int:
    """All views in random order, then all again in another."""
    round_, place = divmod(iteration, n_views)
    return int(np.random.default_rng(round_).permutation(n_views)[place])


def _gradients(drawing: Drawing, splats: SplatParams, of: npt.NDArray[np.float32]) -> F32:
    """(D, N) gradient to the numbers of splats, from that to the picture."""
    found = gradients(drawing, splats, of)
    return SplatParams(
        found.means, found.quats, found.log_scales, found.opacity_logits, found.sh
    ).channels()
