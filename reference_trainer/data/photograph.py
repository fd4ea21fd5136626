"""A photograph on disk: what is known before its pixels are needed, and the pixels."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import MAX_PATH, is_there
from evogs_codec.render.camera import Camera
from reference_trainer.data.pyramid import averaged
from reference_trainer.data.view import F32, Colour

__all__ = ["ENDINGS", "MAX_PIXELS", "Photograph", "image_size", "name_of", "opened", "read_image"]

# Pillow would try fifty formats, some by running other programs (EPS), whatever the ending says.
FORMATS = ("PNG", "JPEG")
ENDINGS = (".png", ".jpg", ".jpeg")
# A view takes 12 bytes a pixel, and its lens 36 while it is undone: 2.4 GB for the largest. Cameras
# of 61 million pixels fit.
MAX_PIXELS = 1 << 26
BAND = 1 << 20  # pixels that are floats at a time
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


def name_of(file_path: str) -> str:
    """`./train/r_0.png`, `../train/r_0` and `train/r_0` are all `train/r_0`."""
    path = PurePosixPath(file_path)
    stem = path.with_suffix("") if path.suffix.lower() in ENDINGS else path
    # Results are written under this name, and never above the folder they belong to.
    return "/".join(part for part in stem.parts if part not in ("/", ".."))


def image_size(path: Path) -> tuple[int, int]:
    """Width and height, from the header of the file; `MAX_PIXELS` at most.

    Raises:
        InputError: the photograph is missing, no picture, or too large.
    """
    with warnings.catch_warnings():
        # Of pictures above a bound of Pillow's, which is above ours.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        with opened(path) as image:
            return image.size


def read_image(
    photograph: Photograph, background: Colour, sides: tuple[int, int] | None = None
) -> F32:
    """(H, W, 3) in 0..1, transparent pixels laid on `background`.

    Args:
        photograph: the file, and a camera of its size.
        background: R G B.
        sides: width and height to average to; by default it keeps its own.

    Raises:
        InputError: the photograph is missing, damaged, or not of 8 bits a channel.
    """
    path, size = photograph.path, (photograph.camera.width, photograph.camera.height)
    with opened(path) as image:
        if image.size != size:
            raise InputError(f"{path}: changed its size while the folder was read")
        if image.mode not in MODES:
            raise InputError(
                f"{path}: pixels of kind {image.mode}, expected 8 bits a channel: convert it"
            )
        try:
            image.load()
        except MemoryError:
            raise
        except Exception as error:  # Pillow raises a dozen types over damaged bytes
            raise InputError(f"{path}: the picture is damaged: {shown(error)}") from error
        transparent = "A" in image.mode or "transparency" in image.info
        mode = "RGBA" if transparent else "RGB"

        def rows(start: int, stop: int) -> F32:
            part = image.crop((0, start, image.width, stop)).convert(mode)
            return _composited(np.asarray(part), background)

        if sides is not None:
            return averaged(rows, size, sides)
        pixels = np.empty((image.height, image.width, 3), np.float32)
        step = max(1, BAND // image.width)
        for start in range(0, image.height, step):
            stop = min(start + step, image.height)
            pixels[start:stop] = rows(start, stop)
        return pixels


def opened(path: Path) -> Image.Image:
    """The picture, its header read, of `MAX_PIXELS` at most.

    Raises:
        InputError: it is missing, too large, or no PNG or JPEG.
    """
    name = shown(path, MAX_PATH)
    if not is_there(path, "picture"):
        raise InputError(f"{name}: the photograph is missing")
    try:
        image = Image.open(path, formats=FORMATS)
    except Image.DecompressionBombError as error:
        count = re.search(r"\d+", str(error))  # it says how many
        raise InputError(f"{name}: {_too_large(count[0] if count else 'more')}") from error
    except UnidentifiedImageError as error:
        expected = " or ".join(FORMATS)
        raise InputError(f"{name}: no picture that can be read, expected {expected}") from error
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # Pillow raises a dozen types over damaged bytes
        raise InputError(f"{name}: no picture that can be read: {shown(error)}") from error
    if image.width * image.height > MAX_PIXELS:
        image.close()
        found = f"{image.width} x {image.height}"
        raise InputError(f"{name}: {_too_large(found)}")
    return image


def _too_large(found: str) -> str:
    return f"has {found} pixels, a photograph has at most {MAX_PIXELS:,}: make it smaller"


def _composited(pixels: npt.NDArray[np.uint8], background: Colour) -> F32:
    values = pixels.astype(np.float32) / np.float32(255)
    colours, alpha = values[..., :3], values[..., 3:]
    if not alpha.size:
        return colours
    return colours * alpha + np.array(background, np.float32) * (1 - alpha)
