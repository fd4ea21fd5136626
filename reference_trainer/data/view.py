"""What the trainer sees of a data set: pictures, each with the camera that took it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.render.camera import Camera

__all__ = ["BACKGROUNDS", "F32", "Colour", "Dataset", "View"]

F32: TypeAlias = npt.NDArray[np.float32]
Colour: TypeAlias = tuple[float, float, float]

BACKGROUNDS: dict[str, Colour] = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}


@dataclass(frozen=True, eq=False)
class View:
    """A photograph, free of lens distortion, on the background of its data set.

    Attributes:
        name: path of the photograph in its folder, without the ending; unique in a data set.
        camera: the pinhole that took it, H x W pixels.
        image: (H, W, 3) in 0..1.
    """

    name: str
    camera: Camera
    image: F32

    def __post_init__(self) -> None:
        expected = (self.camera.height, self.camera.width, 3)
        if self.image.shape != expected or self.image.dtype != np.float32:
            found = f"{self.image.dtype} {self.image.shape}"
            raise ValueError(f"image of view {self.name} is {found}, expected float32 {expected}")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Photographs of one scene.

    Attributes:
        name: of the folder.
        train: what a trainer may see.
        test: what it is measured on; empty where nothing was held out.
        points: (N, 3) points on surfaces, in the world of the cameras, where the folder has some.
        colours: (N, 3) of the points, in 0..1.
        background: what transparent photographs were laid on; renderings need the same.
    """

    name: str
    train: tuple[View, ...]
    test: tuple[View, ...]
    points: F32 | None
    colours: F32 | None
    background: Colour
