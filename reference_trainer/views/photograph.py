"""A photograph on disk: what is known before its pixels are needed, and the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from conformance.rasterizer.camera import Camera
from evogs_codec.errors import InputError
from reference_trainer.views.view import F32, Color

__all__ = ["Photograph", "image_size", "read_image"]

# Pillow turns these into 8 bits of R G B and A without loss; 16 bits it would clip.
MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr")


@dataclass(frozen=True, eq=False)
class Photograph:
    """One picture of a folder.

    Attributes:
        name: path in the folder, without the ending.
        path: of the file.
        camera: the pinhole behind the lens, of the file's width and height.
        distortion: k1, k2, p1, p2 of the lens, all 0 for a pinhole.
    """

    name: str
    path: Path
    camera: Camera
    distortion: tuple[float, float, float, float]


def image_size(path: Path) -> tuple[int, int]:
    """Width and height, from the header of the file.

    Raises:
        InputError: the photograph is missing or no picture.
    """
    with _opened(path) as image:
        return image.size


def read_image(path: Path, background: Color) -> F32:
    """(H, W, 3) in 0..1, transparent pixels laid on `background`.

    Raises:
        InputError: the photograph is missing, damaged, or not of 8 bits a channel.
    """
    with _opened(path) as image:
        if image.mode not in MODES:
            raise InputError(
                f"{path}: pixels of kind {image.mode}, expected 8 bits a channel: convert it"
            )
        transparent = "A" in image.mode or "transparency" in image.info
        try:
            pixels = np.asarray(image.convert("RGBA" if transparent else "RGB"))
        except (OSError, SyntaxError, ValueError) as error:  # Pillow raises any of them
            raise InputError(f"{path}: the picture is damaged: {error}") from error
    return _composited(pixels, background)


def _composited(pixels: npt.NDArray[np.uint8], background: Color) -> F32:
    values = pixels.astype(np.float32) / np.float32(255)
    colors, alpha = values[..., :3], values[..., 3:]
    if not alpha.size:
        return colors
    return colors * alpha + np.array(background, np.float32) * (1 - alpha)


def _opened(path: Path) -> Image.Image:
    try:
        return Image.open(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: the photograph is missing") from error
    except (UnidentifiedImageError, Image.DecompressionBombError, ValueError) as error:
        raise InputError(f"{path}: no picture that can be read") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
