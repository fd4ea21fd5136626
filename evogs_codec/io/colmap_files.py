"""Records of a COLMAP model: cameras, images and points, of `.bin` and `.txt` files.

The official reader (pycolmap) takes 134 MB on disk and, given an `images.bin` cut short, did not
return within a minute. What is needed here is three tables, little-endian, each after the number
of its rows.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import is_there, read_plain

__all__ = ["ColmapCamera", "ColmapImage", "ColmapModel", "read_model"]

F64: TypeAlias = npt.NDArray[np.float64]

# Name and number of parameters by the number that binary files have.
MODELS = (
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12),
)  # fmt: skip
COUNTS = dict(MODELS)


@dataclass(frozen=True)
class ColmapCamera:
    """A lens and its picture size; `params` in the order of COLMAP's documentation."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class ColmapImage:
    """A photograph: world to camera, quaternion w x y z, and its camera's number."""

    name: str
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """A model.

    Attributes:
        cameras: by number.
        images: in the order of the file.
        points: (N, 3).
        colours: (N, 3) in 0..255.
    """

    cameras: dict[int, ColmapCamera]
    images: list[ColmapImage]
    points: F64
    colours: F64


def read_model(folder: Path) -> ColmapModel:
    """Three files of `folder`, `.bin` before `.txt`; a model without points may lack the third.

    Raises:
        InputError: a file is missing, cut short or damaged.
    """
    ending = ".bin" if is_there(folder / "cameras.bin") else ".txt"
    paths = [folder / (stem + ending) for stem in ("cameras", "images", "points3D")]
    read_cameras, read_images, read_points = READERS[ending]
    cameras = read_cameras(paths[0])
    images = read_images(paths[1])
    rows = read_points(paths[2]) if is_there(paths[2]) else []
    table = np.array(rows, np.float64).reshape(-1, 6)
    return ColmapModel(cameras, images, table[:, :3], table[:, 3:])


# ----------------------------------------------------------------------------------------- binary


class _Bytes:
    """A file read from front to back, never past its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = _read(path)
        self.at = 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """Fields of `layout`, as of `struct`."""
        start = self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def skip(self, n: int) -> int:
        """Pass over `n` bytes; returns where they began."""
        if n > len(self.data) - self.at:
            raise InputError(f"{self.path}: cut short: ends within what begins at byte {self.at}")
        start = self.at
        self.at += n
        return start

    def name(self) -> str:
        """Text up to a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise InputError(f"{self.path}: cut short: a name at byte {self.at} does not end")
        start = self.skip(end + 1 - self.at)
        return self.data[start:end].decode("utf-8", "surrogateescape")

    def end(self) -> None:
        """Refuse what follows the last row."""
        if self.at != len(self.data):
            extra = len(self.data) - self.at
            raise InputError(f"{self.path}: {extra} bytes too many after byte {self.at}")


def _cameras_bin(path: Path) -> dict[int, ColmapCamera]:
    file = _Bytes(path)
    cameras = {}
    for _ in range(file.take("<Q")[0]):
        number, model, width, height = file.take("<iiQQ")
        if not 0 <= model < len(MODELS):
            raise InputError(f"{path}: camera {number} is of unknown model {model}")
        if number in cameras:
            raise _twice(path, number)
        name, n_params = MODELS[model]
        cameras[number] = ColmapCamera(name, width, height, file.take(f"<{n_params}d"))
    file.end()
    return cameras


def _images_bin(path: Path) -> list[ColmapImage]:
    file = _Bytes(path)
    images = []
    for _ in range(file.take("<Q")[0]):
        _, *pose, camera = file.take("<i7di")
        name = file.name()
        file.skip(24 * file.take("<Q")[0])  # where its points are seen: x, y, number of the point
        images.append(ColmapImage(name, tuple(pose[:4]), tuple(pose[4:]), camera))
    file.end()
    return images


def _points_bin(path: Path) -> list[tuple[float, ...]]:
    file = _Bytes(path)
    rows: list[tuple[float, ...]] = []
    for _ in range(file.take("<Q")[0]):
        _, *row, _, n_track = file.take("<Q3d3BdQ")
        file.skip(8 * n_track)  # who sees it: number of the image, index there
        rows.append(tuple(row))
    file.end()
    return rows


# ------------------------------------------------------------------------------------------- text


def _cameras_txt(path: Path) -> dict[int, ColmapCamera]:
    cameras = {}
    for number, line in _lines(path):
        words = line.split()
        if not words:
            continue
        try:
            camera, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            params = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError) as error:
            raise _unreadable(path, number, "a camera") from error
        if len(params) != COUNTS.get(model, len(params)):
            expected = COUNTS[model]
            raise InputError(
                f"{path}: line {number}: {len(params)} parameters, {model} has {expected}"
            )
        if camera in cameras:
            raise _twice(path, camera)
        cameras[camera] = ColmapCamera(model, width, height, params)
    return cameras


def _images_txt(path: Path) -> list[ColmapImage]:
    images = []
    lines = iter(_lines(path))
    for number, line in lines:
        if not line.strip():
            continue
        words = line.split(maxsplit=9)  # names may have spaces
        try:
            pose = tuple(float(word) for word in words[1:8])
            images.append(ColmapImage(words[9].rstrip(), pose[:4], pose[4:], int(words[8])))
        except (ValueError, IndexError) as error:
            raise _unreadable(path, number, "an image") from error
        # The next line is where its points are seen: triples, perhaps none.
        points = next(lines, (number, ""))[1].split()
        if len(points) % 3:
            raise _unreadable(path, number + 1, "a list of points")
    return images


def _points_txt(path: Path) -> list[tuple[float, ...]]:
    rows: list[tuple[float, ...]] = []
    for number, line in _lines(path):
        words = line.split(maxsplit=7)
        if not words:
            continue
        try:
            row = tuple(float(word) for word in words[1:7])
        except ValueError as error:
            raise _unreadable(path, number, "a point") from error
        if len(row) != 6:
            raise _unreadable(path, number, "a point")
        rows.append(row)
    return rows


READERS = {
    ".bin": (_cameras_bin, _images_bin, _points_bin),
    ".txt": (_cameras_txt, _images_txt, _points_txt),
}


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines but comments; empty ones stay: an image without points has one."""
    text = _read(path).decode("utf-8", "surrogateescape")
    for number, line in enumerate(text.split("\n"), 1):
        if not line.startswith("#"):
            yield number, line


def _read(path: Path) -> bytes:
    return read_plain(path, "missing from the COLMAP model")


def _twice(path: Path, number: int) -> InputError:
    return InputError(f"{path}: camera {number} is there twice")


def _unreadable(path: Path, number: int, what: str) -> InputError:
    return InputError(f"{path}: line {number} is not {what}")
