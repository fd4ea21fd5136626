"""Photographs of a NeRF-synthetic folder that a tree was not trained on, at any size."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from evogs_codec.render import Camera

__all__ = ["Photograph", "held_out"]

F64 = npt.NDArray[np.float64]
HELD_OUT_EVERY = 8  # which views are held out


@dataclass(frozen=True, eq=False)
class Photograph:
    """A view.

    Attributes:
        pixels: (S, S, 3) on white.
        to_world: (4, 4) of the camera, as Blender has it.
        fov_x: radians.
    """

    pixels: F64
    to_world: list[list[float]]
    fov_x: float

    def at(self, size: int) -> tuple[Camera, F64]:
        """The camera, and (size, size, 3): means of boxes of pixels."""
        box = len(self.pixels) // size
        target = self.pixels.reshape(size, box, size, box, 3).mean((1, 3))
        return Camera.from_blender(self.to_world, self.fov_x, width=size, height=size), target


def held_out(folder: Path) -> list[Photograph]:
    """Every 8th photograph of the folder."""
    scene = json.loads((folder / "transforms_train.json").read_text(encoding="utf-8"))
    return [
        Photograph(
            _on_white(folder / f"{frame['file_path']}.png"),
            frame["transform_matrix"],
            scene["camera_angle_x"],
        )
        for frame in scene["frames"][::HELD_OUT_EVERY]
    ]


def _on_white(path: Path) -> F64:
    with Image.open(path) as file:
        pixels = np.asarray(file, np.float64) / 255
    out: F64 = pixels[..., :3] * pixels[..., 3:] + 1 - pixels[..., 3:]
    return out
