"""Photographs of a COLMAP folder: `images/` and a model in `sparse/0/`, `sparse/` or beside."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.colmap_files import ColmapCamera, ColmapImage, read_model
from evogs_codec.io.plain_files import is_there
from evogs_codec.render.colmap import own_camera, placed
from reference_trainer.data.photograph import Photograph, image_size, name_of
from reference_trainer.data.points import checked_points
from reference_trainer.data.view import F32

__all__ = ["Reconstruction", "read_colmap"]


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
        camera = own_camera(where, image, found.cameras)
        path = folder / "images" / image.name
        if is_there(path, "picture"):
            photographs.append(_photograph(where, path, image, camera))
        else:
            missing.append(path)
    points, colours = checked_points(model, found.points, found.colours / 255)
    return Reconstruction(photographs, points, colours, missing)


def _photograph(where: str, path: Path, image: ColmapImage, camera: ColmapCamera) -> Photograph:
    width, height = image_size(path)
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{where}: the photograph has {width} x {height} pixels, its camera "
            f"{camera.width} x {camera.height}"
        )
    return Photograph(name_of(image.name), path, *placed(where, image, camera))
