"""`.sog` of PlayCanvas, versions 1 and 2: pictures and a `meta.json`, in a zip or a folder.

Pictures are lossless WebP, which Pillow decodes. The frame is that of a `.ply`.

Letters: N splats, P palette entries.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import check_size, check_splats, read_bytes
from evogs_codec.io.interchange.values import BYTE_LOGITS, quats_of
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, U8, SplatParams

__all__ = ["META", "is_sog", "read", "size"]

META = "meta.json"
MAX_META = 16 << 20  # bytes
ROW = 64  # palette entries in a row of the picture
N_REST = (0, 3, 8, 15)  # coefficients above band 0, by SH degree
ALLOWED_PIXELS = 4  # times those needed: pictures are rounded up to whole blocks
FIRST_TAG = 252  # of a rotation: the component that is left out is that many less


def is_sog(path: Path, start: bytes) -> bool:
    """Whether a path is a `.sog`: a zip or a folder with a `meta.json`, or that file itself."""
    if path.is_dir():
        return (path / META).is_file()
    if start.startswith(b"PK"):
        try:
            with zipfile.ZipFile(path) as archive:
                return any(Path(name).name == META for name in archive.namelist())
        except Exception:  # whatever `zipfile` raises, it could not read it
            return False
    return path.name == META and start.lstrip().startswith(b"{")


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of a `.sog`.

    Raises:
        InputError: the file is damaged or of another version, or Pillow is not installed.
    """
    if path.is_file() and zipfile.is_zipfile(path):
        with _unzipping(path):
            archive = zipfile.ZipFile(path)
        with archive:
            return _read(_Bundle(path, archive))
    return _read(_Folder(path if path.is_dir() else path.parent, path))


def size(path: Path) -> int:
    """Bytes of a `.sog`: of the zip, or of `meta.json` and the files that it names.

    Raises:
        InputError: `meta.json` is damaged, or a file is not there.
    """
    if path.is_file() and zipfile.is_zipfile(path):
        return path.stat().st_size
    folder = path if path.is_dir() else path.parent
    parts = _json(path, read_bytes(folder / META)).values()
    lists = [part.get("files") for part in parts if isinstance(part, dict)]
    names = {META}.union(*(map(str, files) for files in lists if isinstance(files, list)))
    try:
        return sum((folder / Path(name).name).stat().st_size for name in names)
    except OSError as error:
        what = shown(error.filename or error)
        raise InputError(f"{path}: {META} names a file that is not there: {what}") from error


# --- members --------------------------------------------------------------------------------------


@contextmanager
def _unzipping(path: Path) -> Iterator[None]:
    """Raises InputError of what goes wrong in it."""
    try:
        yield
    except Exception as error:  # whatever `zipfile` raises, it could not read it
        raise InputError(f"{path}: the zip is damaged: {shown(error)}") from error


@dataclass(frozen=True)
class _Bundle:
    path: Path
    archive: zipfile.ZipFile

    @property
    def n_bytes(self) -> int:
        return self.path.stat().st_size

    def member(self, name: str) -> bytes:
        prefix = next(
            (n[: -len(META)] for n in self.archive.namelist() if Path(n).name == META), ""
        )
        try:
            info = self.archive.getinfo(prefix + name)
        except KeyError:
            raise InputError(f"{self.path}: it has no member {shown(name)}") from None
        check_size(self.path, info.file_size, self.n_bytes)
        with _unzipping(self.path):
            return self.archive.read(info)


@dataclass(frozen=True)
class _Folder:
    folder: Path
    path: Path

    @property
    def n_bytes(self) -> int:
        return sum(file.stat().st_size for file in self.folder.iterdir() if file.is_file())

    def member(self, name: str) -> bytes:
        if Path(name).name != name:
            raise InputError(f"{self.path}: {shown(name)} is no name of a file beside it")
        return read_bytes(self.folder / name)


Member = Callable[[str], bytes]


def _picture(path: Path, member: Member, name: str, least: int) -> U8:
    """(pixels, 4) the bytes of a picture.

    Args:
        path: of the scene, for messages.
        member: reads a file.
        name: of the picture.
        least: pixels that it must have.

    Raises:
        InputError: it is damaged, or has far more or fewer pixels.
    """
    return _image(path, member, name, least).reshape(-1, 4)


def _image(path: Path, member: Member, name: str, least: int) -> U8:
    try:
        from PIL import Image
    except ImportError:
        raise InputError(
            f"{path}: reading a .sog needs Pillow: pip install -e '.[interchange]'"
        ) from None
    data = member(name)
    try:
        with Image.open(BytesIO(data), formats=("WEBP", "PNG")) as image:
            width, height = image.size
            fits = least <= width * height <= ALLOWED_PIXELS * least + (1 << 16)
            pixels: U8 = (
                np.asarray(image.convert("RGBA")) if fits else np.empty((0, 0, 4), np.uint8)
            )
    except Exception as error:  # whatever Pillow raises, it could not read it
        raise InputError(f"{path}: {shown(name)} is no picture: {shown(error)}") from error
    if not fits:
        size = f"{width} x {height} pixels"
        raise InputError(f"{path}: {shown(name)} has {size}, expected about {least:,}")
    return pixels


# --- meta.json ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Meta:
    """A part of `meta.json`, whose values are checked as they are taken."""

    path: Path
    value: dict[str, Any]
    name: str

    def part(self, key: str) -> _Meta:
        found = self.value.get(key)
        if not isinstance(found, dict):
            raise InputError(f"{self.path}: {META} has no object '{key}'")
        return _Meta(self.path, found, key)

    def files(self, n: int) -> list[str]:
        found = self.value.get("files")
        if (
            not isinstance(found, list)
            or len(found) < n
            or not all(isinstance(f, str) for f in found)
        ):
            raise InputError(f"{self.path}: '{self.name}' of {META} does not name {n} files")
        return found

    def count(self, key: str) -> int:
        found = self.value.get(key)
        if type(found) is not int or not 0 <= found < 1 << 32:
            raise InputError(f"{self.path}: '{key}' of {META} is no number of splats")
        return found

    def numbers(self, key: str, n: int) -> F32:
        """`n` numbers of a list, or one number for all."""
        found = self.value.get(key)
        listed = found if isinstance(found, list) else [found] * n
        if len(listed) != n or not all(type(x) in (int, float) for x in listed):
            raise InputError(f"{self.path}: '{key}' of '{self.name}' in {META} is not {n} numbers")
        try:
            with np.errstate(over="ignore"):
                return np.array(listed, np.float64).astype(np.float32)
        except OverflowError as error:
            raise InputError(f"{self.path}: '{key}' in {META} is too large") from error


def _json(path: Path, text: bytes) -> dict[str, Any]:
    if len(text) > MAX_META:
        raise InputError(f"{path}: {META} has {len(text):,} bytes, at most {MAX_META:,} are taken")
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {META} is not JSON: {shown(error)}") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: {META} is no JSON object")
    return value


def _read(source: _Bundle | _Folder) -> tuple[SplatParams, SceneInfo]:
    path, member = source.path, source.member
    value = _json(path, member(META))
    meta, version = _Meta(path, value, META), value.get("version", 1)
    if version not in (1, 2):
        raise InputError(f"{path}: .sog version {shown(version)}; versions 1 and 2 are known")
    info = SceneInfo(
        antialiased=value.get("model") == "antialiased" or value.get("antialias") is True
    )
    n = meta.count("count") if version == 2 else _count_1(meta)
    check_splats(path, n, 16 if value.get("shN") else 1, source.n_bytes)
    means = _means(meta.part("means"), member, n)
    quats = _quats(meta.part("quats"), member, n)
    scales, colours = meta.part("scales"), meta.part("sh0")
    scale_bytes = _picture(path, member, scales.files(1)[0], n)[:n, :3]
    colour_bytes = _picture(path, member, colours.files(1)[0], n)[:n]
    if version == 2:
        log_scales = scales.numbers("codebook", 256)[scale_bytes]
        dc = colours.numbers("codebook", 256)[colour_bytes[:, :3]]
        logits = BYTE_LOGITS[colour_bytes[:, 3]]
    else:
        log_scales = _between(scales, 3, scale_bytes)
        of_all = _between(colours, 4, colour_bytes)
        dc, logits = of_all[:, :3], of_all[:, 3]
    rest = _sh(meta.part("shN"), member, n, version) if value.get("shN") else np.empty((n, 0, 3))
    sh = np.concatenate([dc[:, None], rest], axis=1, dtype=np.float32)
    return SplatParams(means, quats, log_scales, logits, sh), info


def _count_1(meta: _Meta) -> int:
    shape = meta.part("means").value.get("shape")
    if not isinstance(shape, list) or not shape:
        raise InputError(f"{meta.path}: 'means' of {META} has no shape")
    return _Meta(meta.path, {"shape": shape[0]}, "means").count("shape")


def _between(meta: _Meta, n: int, stored: U8) -> F32:
    """Numbers from the least to the greatest, each a byte."""
    low, high = meta.numbers("mins", n), meta.numbers("maxs", n)
    return (low + (high - low) * (stored / np.float32(255))).astype(np.float32)


def _means(meta: _Meta, member: Member, n: int) -> F32:
    names = meta.files(2)
    low = _picture(meta.path, member, names[0], n)[:n, :3]
    high = _picture(meta.path, member, names[1], n)[:n, :3]
    least, most = meta.numbers("mins", 3).astype(float), meta.numbers("maxs", 3).astype(float)
    steps = np.arange(65536) / 65535
    words = low.astype(np.uint16) | high.astype(np.uint16) << 8
    means = np.empty((n, 3), np.float32)
    with np.errstate(over="ignore"):
        for axis in range(3):  # each axis has 65536 values: their exponentials are a table
            logs = least[axis] + (most[axis] - least[axis]) * steps
            table = np.copysign(np.expm1(np.abs(logs)), logs).astype(np.float32)
            means[:, axis] = table[words[:, axis]]
    return means


def _quats(meta: _Meta, member: Member, n: int) -> F32:
    stored = _picture(meta.path, member, meta.files(1)[0], n)[:n]
    rest = (stored[:, :3].astype(np.float32) / np.float32(127.5) - 1) * np.float32(0.5**0.5)
    known = stored[:, 3] >= FIRST_TAG
    quats = quats_of(np.where(known, stored[:, 3].astype(np.int64) - FIRST_TAG, 0), rest)
    quats[~known] = (1, 0, 0, 0)
    return quats


def _sh(meta: _Meta, member: Member, n: int, version: int) -> F32:
    """(n, K - 1, 3) coefficients above band 0: splats name entries of a palette."""
    names = meta.files(2)
    labels = _picture(meta.path, member, names[1], n)[:n]
    entry = labels[:, 0].astype(np.int64) | labels[:, 1].astype(np.int64) << 8
    if version == 2:
        degree, n_entries = meta.count("bands"), meta.count("count")
        if not 1 <= degree <= 3 or n_entries > 1 << 16:
            raise InputError(f"{meta.path}: {degree} SH bands with {n_entries:,} entries")
        image = _image(meta.path, member, names[0], -(-n_entries // ROW) * ROW * N_REST[degree])
        table = meta.numbers("codebook", 256)
    else:
        image = _image(meta.path, member, names[0], 1)
        low, high = meta.numbers("mins", 1), meta.numbers("maxs", 1)
        table = (low + (high - low) * (np.arange(256) / 255)).astype(np.float32)
        degree = next((d for d in (1, 2, 3) if image.shape[1] == ROW * N_REST[d]), 0)
    k = N_REST[degree]
    if not k or image.shape[1] != ROW * k:
        raise InputError(f"{meta.path}: {shown(names[0])} has {image.shape[1]} columns")
    palette: npt.NDArray[np.uint8] = image[:, :, :3].reshape(-1, k, 3)
    values = table[palette]
    inside = entry < len(values)
    found = values[np.where(inside, entry, 0)]
    found[~inside] = 0
    return found
