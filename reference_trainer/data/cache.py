"""Undistorted photographs on disk, so that each is computed once.

They lie in the user's cache folder, never beside the user's photographs; deleting them is safe.
"""

from __future__ import annotations

import hashlib
import os
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from evogs_codec.errors import InputError
from evogs_codec.io.files import write_atomic
from evogs_codec.render.camera import Camera
from reference_trainer.data.distortion import undistorted_camera, undistorted_image
from reference_trainer.data.photograph import MAX_PIXELS, Photograph, opened, read_image
from reference_trainer.data.view import F32, Colour

__all__ = ["cache_folder", "undistorted"]

BLOCK = 1 << 20  # bytes of a file that are read at a time
VERSION = b"undistorted 1"  # changes when the same photograph would give other pixels


def undistorted(
    photograph: Photograph, background: Colour, folder: Path | None
) -> tuple[F32, Camera]:
    """The picture without lens distortion, of 8 bits a channel, and its pinhole camera.

    Args:
        photograph: a file, its camera and lens.
        background: what its transparent pixels are laid on.
        folder: of the cache; None is the user's.

    Raises:
        InputError: the photograph cannot be read, or the lens bends rays beyond what its four
            numbers describe.
    """
    try:
        camera = undistorted_camera(photograph.camera, photograph.distortion)
    except ValueError as error:
        raise InputError(f"{photograph.path}: {error}") from error
    if camera.width * camera.height > MAX_PIXELS:
        raise InputError(
            f"{photograph.path}: without its lens it has {camera.width} x {camera.height} pixels,"
            f" at most {MAX_PIXELS:,} are possible: make it smaller"
        )
    path = (folder or cache_folder()) / f"{_key(photograph, background)}.png"
    pixels = _read(path, camera)
    if pixels is None:
        image = read_image(photograph, background)
        made = undistorted_image(image, photograph.camera, photograph.distortion)
        made *= 255
        pixels = np.rint(made, out=made).astype(np.uint8)
        _write(path, pixels)
    return pixels.astype(np.float32) / np.float32(255), camera


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/evogs/undistorted`, by default in `~/.cache`."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "evogs" / "undistorted"


def _key(photograph: Photograph, background: Colour) -> str:
    camera = photograph.camera
    lens = [camera.fx, camera.fy, camera.cx, camera.cy, *photograph.distortion]
    digest = hashlib.sha256(VERSION)
    digest.update(np.array([*lens, *background], np.float64).tobytes())
    try:
        with photograph.path.open("rb") as file:
            while block := file.read(BLOCK):
                digest.update(block)
    except OSError as error:
        path = photograph.path
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    return digest.hexdigest()[:32]


def _read(path: Path, camera: Camera) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]] | None:
    try:
        with opened(path) as image:
            if image.size != (camera.width, camera.height):
                return None
            return np.asarray(image.convert("RGB"))
    except Exception:  # not there, or damaged, for which Pillow raises a dozen types: made anew
        return None


def _write(path: Path, pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> None:
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG", compress_level=1)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, file.getvalue())
    except OSError:
        return  # a full or read-only disk costs time at the next start, nothing else
