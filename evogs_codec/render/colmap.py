"""Cameras of a COLMAP model: pinholes, and what their lenses do to straight lines."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.colmap_files import ColmapCamera, ColmapImage, read_model
from evogs_codec.io.plain_files import is_there
from evogs_codec.render.camera import Camera, Coefficients

__all__ = ["colmap_cameras", "find_model", "own_camera", "placed"]

# Where fx, fy, cx, cy and k1, k2, p1, p2 of a model are among its parameters; None is 0.
MODELS: dict[str, tuple[tuple[int, ...], tuple[int | None, ...]]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), (None, None, None, None)),
    "PINHOLE": ((0, 1, 2, 3), (None, None, None, None)),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
}


def find_model(folder: Path) -> Path | None:
    """Where the model of a folder is, if it has one."""
    for inner in ("sparse/0", "sparse", "."):
        if any(is_there(folder / inner / f"cameras{ending}") for ending in (".bin", ".txt")):
            return folder / inner
    return None


def colmap_cameras(model: Path) -> list[Camera]:
    """The pinhole behind each photograph of a model, in the order of their names.

    Raises:
        InputError: the model is damaged or has no image, or a camera is impossible or of a model
            that is not supported.
    """
    found = read_model(model)
    if not found.images:
        raise InputError(f"{model}: no cameras: the model has no image")
    cameras = []
    for image in sorted(found.images, key=lambda image: image.name):
        where = f"{model}: image {shown(image.name)}"
        cameras.append(placed(where, image, own_camera(where, image, found.cameras))[0])
    return cameras


def own_camera(where: str, image: ColmapImage, cameras: dict[int, ColmapCamera]) -> ColmapCamera:
    """The camera that took an image.

    Raises:
        InputError: it is not there.
    """
    if image.camera not in cameras:
        raise InputError(f"{where} names camera {image.camera}, not there")
    return cameras[image.camera]


def placed(where: str, image: ColmapImage, camera: ColmapCamera) -> tuple[Camera, Coefficients]:
    """The pinhole that took an image, and the distortion of its lens.

    Raises:
        InputError: the camera is of a model that is not supported, or it or its pose is impossible.
    """
    if camera.model not in MODELS:
        raise InputError(
            f"{where}: camera model {shown(camera.model)} is not supported, only "
            f"{', '.join(MODELS)}: run COLMAP's image_undistorter first"
        )
    pinhole, lens = MODELS[camera.model]
    if not np.isfinite([*camera.params, *image.quaternion, *image.translation]).all():
        raise InputError(f"{where}: its camera or pose has a number that is not finite")
    if abs(math.hypot(*image.quaternion) - 1) > 0.01:
        raise InputError(f"{where}: its quaternion {list(image.quaternion)} is no rotation")
    try:
        found = Camera.from_colmap(
            image.quaternion, image.translation, [camera.params[i] for i in pinhole],
            width=camera.width, height=camera.height,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    k1, k2, p1, p2 = (0.0 if i is None else camera.params[i] for i in lens)
    return found, (k1, k2, p1, p2)
