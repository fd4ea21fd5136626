"""Photographs of a COLMAP folder: `images/` and a model in `sparse/0/`, `sparse/` or beside."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.render.camera import Camera
from reference_trainer.data.colmap_files import ColmapCamera, ColmapImage, read_model
from reference_trainer.data.distortion import Coefficients
from reference_trainer.data.photograph import Photograph, image_size, name_of
from reference_trainer.data.plain_files import is_there
from reference_trainer.data.points import checked_points
from reference_trainer.data.view import F32

__all__ = ["Reconstruction", "find_model", "read_colmap"]

# Where fx, fy, cx, cy and k1, k2, p1, p2 of a model are among its parameters; None is 0.
MODELS: dict[str, tuple[tuple[int, ...], tuple[int | None, ...]]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), (None, None, None, None)),
    "PINHOLE": ((0, 1, 2, 3), (None, None, None, None)),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
}


class Reconstruction(NamedTuple):
    """What a model has.

    Attributes:
        photographs: in the order of their names.
        points, colours: (N, 3) each, perhaps none.
        missing: paths of photographs of which there is no file.
    """

    photographs: list[Photograph]
    points: F32
    colours: F32
    missing: list[Path]


def find_model(folder: Path) -> Path | None:
    """Where the model of a folder is, if it has one."""
    for inner in ("sparse/0", "sparse", "."):
        if any(is_there(folder / inner / f"cameras{ending}") for ending in (".bin", ".txt")):
            return folder / inner
    return None


def read_colmap(folder: Path, model: Path) -> Reconstruction:
    """Photographs and points of a model; photographs are looked at, not yet decoded.

    Raises:
        InputError: the model is damaged, a camera is impossible or of a model that is not
            supported, or its photograph is no picture or of another size.
    """
    found = read_model(model)
    if not found.images:
        raise InputError(f"{model}: no cameras: the model has no image")
    photographs, missing = [], []
    for image in sorted(found.images, key=lambda image: image.name):
        where = f"{model}: image {shown(image.name)}"
        if image.camera not in found.cameras:
            raise InputError(f"{where} names camera {image.camera}, not there")
        path = folder / "images" / image.name
        if is_there(path, "picture"):
            photographs.append(_photograph(where, path, image, found.cameras[image.camera]))
        else:
            missing.append(path)
    points, colours = checked_points(model, found.points, found.colours / 255)
    return Reconstruction(photographs, points, colours, missing)


def _photograph(where: str, path: Path, image: ColmapImage, camera: ColmapCamera) -> Photograph:
    if camera.model not in MODELS:
        raise InputError(
            f"{where}: camera model {shown(camera.model)} is not supported, only "
            f"{', '.join(MODELS)}: run COLMAP's image_undistorter first"
        )
    width, height = image_size(path)
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{where}: the photograph has {width} x {height} pixels, its camera "
            f"{camera.width} x {camera.height}"
        )
    pinhole, lens = MODELS[camera.model]
    if not np.isfinite([*camera.params, *image.quaternion, *image.translation]).all():
        raise InputError(f"{where}: its camera or pose has a number that is not finite")
    if abs(math.hypot(*image.quaternion) - 1) > 0.01:
        raise InputError(f"{where}: its quaternion {list(image.quaternion)} is no rotation")
    try:
        placed = Camera.from_colmap(
            image.quaternion, image.translation, [camera.params[i] for i in pinhole],
            width=width, height=height,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    return Photograph(name_of(image.name), path, placed, _distortion(camera, lens))


def _distortion(camera: ColmapCamera, lens: tuple[int | None, ...]) -> Coefficients:
    k1, k2, p1, p2 = (0.0 if i is None else camera.params[i] for i in lens)
    return k1, k2, p1, p2
