"""Photographs of `transforms*.json`: Blender / NeRF-synthetic, instant-ngp and nerfstudio."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import first_there
from evogs_codec.render.transforms import Json, frames_of, load_transforms, placed_frame
from reference_trainer.data.photograph import ENDINGS, Photograph, image_size, name_of

__all__ = ["Transforms", "read_transforms"]


@dataclass(frozen=True, eq=False)
class Transforms:
    """One file.

    Attributes:
        photographs: in the order of the file.
        missing: paths of those of which there is no file, by name.
        test: names of those that the file itself holds out.
        points: the `.ply` file that it names, if any.
    """

    photographs: list[Photograph]
    missing: dict[str, Path]
    test: frozenset[str]
    points: Path | None


def read_transforms(path: Path) -> Transforms:
    """All cameras of a file; photographs are looked at, not yet decoded.

    Raises:
        InputError: the file is no list of cameras, a camera is impossible, its lens is of a kind
            that is not supported, or its photograph is no picture or of another size.
    """
    top = load_transforms(path)
    photographs, missing = [], {}
    for index, frame in enumerate(frames_of(path, top)):
        file_path = frame.get("file_path")
        if not isinstance(file_path, str):
            raise InputError(f"{path}: frame {index} has no 'file_path'")
        image = _image(path.parent / file_path)
        if image is None:
            missing[name_of(file_path)] = path.parent / file_path
            continue
        where = f"{path}: frame {index} ({shown(file_path)})"
        camera, distortion = placed_frame(where, top, frame, partial(image_size, image))
        photographs.append(Photograph(name_of(file_path), image, camera, distortion))
    return Transforms(photographs, missing, _test_names(path, top), _points(path, top))


def _image(path: Path) -> Path | None:
    """The file, if there is one; Blender leaves its ending out.

    Raises:
        InputError: what is there is no file.
    """
    return first_there([path, *(Path(f"{path}{ending}") for ending in ENDINGS)], "picture")


def _test_names(path: Path, top: Json) -> frozenset[str]:
    """Photographs that nerfstudio's split holds out."""
    for key in ("test_filenames", "val_filenames"):
        names = top.get(key)
        if names is not None and not (
            isinstance(names, list) and all(isinstance(name, str) for name in names)
        ):
            raise InputError(f"{path}: '{key}' is not a list of names")
        if names:
            return frozenset(name_of(name) for name in names)
    return frozenset()


def _points(path: Path, top: Json) -> Path | None:
    name = top.get("ply_file_path")
    return path.parent / name if isinstance(name, str) else None
