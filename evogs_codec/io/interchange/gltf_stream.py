"""Streams in glTF files: EVOGS_gaussian_splatting_compression, read.

`spec/EVOGS_gaussian_splatting_compression/README.md` is its text.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from evogs_codec.common.printable import shown
from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.editing.byte_stats import levels
from evogs_codec.errors import InputError, StreamError
from evogs_codec.format.directory import read_directory
from evogs_codec.io.interchange.bounded import FREE, RATIO
from evogs_codec.io.interchange.gltf_file import GltfFile, as_object, is_gltf, open_gltf_start
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

__all__ = ["EXTENSION", "KHR", "VERSION", "Streams", "read_gltf_stream"]

KHR = "KHR_gaussian_splatting"
EXTENSION = "EVOGS_gaussian_splatting_compression"
VERSION = 1
START = 1 << 17  # bytes by which a file is judged
# Bytes of splats that a byte of a stream may become: 0.6 bytes a splat of SH degree 3.
MAX_RATIO = 400


def read_gltf_stream(path: str | os.PathLike[str]) -> memoryview | None:
    """The bytes of the stream in a `.glb` or `.gltf`, perhaps without its end, as the file is.

    Returns:
        None if the file is no glTF, or has not exactly one stream.

    Raises:
        InputError: the file is glTF and damaged.
        OSError: it cannot be read.
    """
    at = Path(path)
    if at.is_dir():
        return None
    with at.open("rb") as stream:
        if not is_gltf(at, stream.read(START)):
            return None
    file = open_gltf_start(at)
    found = Streams(file)
    numbers: set[int] = set()
    for mesh in file.list_of(file.root, "meshes"):
        for primitive in file.list_of(as_object(mesh), "primitives"):
            number = found.number_in(_splatting(primitive))
            if number is not None:
                numbers.add(number)
    return file.part(numbers.pop())[0] if len(numbers) == 1 else None


def _splatting(primitive: object) -> dict[str, Any]:
    return as_object(as_object(as_object(primitive).get("extensions")).get(KHR))


class Streams:
    """The streams of a glTF file, each decoded once.

    Attributes:
        allowance: bytes of a file of plain splats that those of the streams count for, where
            sizes are checked.
        info: what the last one says of its scene.
    """

    def __init__(self, file: GltfFile) -> None:
        self.allowance = 0
        self.info = SceneInfo()
        self._file = file
        self._splats: dict[tuple[int, ...], SplatParams] = {}  # by the place of the stream
        self._n_bytes = 0

    def number_in(self, extension: dict[str, Any]) -> int | None:
        """The buffer view that an object of KHR_gaussian_splatting names; None if it has no stream.

        Raises:
            InputError: it has one that cannot be read.
        """
        inside = as_object(extension.get("extensions"))
        if EXTENSION not in inside:
            return None
        said = as_object(inside[EXTENSION])
        version, number = said.get("version"), said.get("bufferView")
        if type(version) is not int or version != VERSION:
            raise InputError(
                f"{self._file.path}: {EXTENSION} has version {shown(version)}, only {VERSION} is"
                " known"
            )
        self._file.item("bufferViews", number)
        assert isinstance(number, int)
        return number

    def splats(self, number: int) -> SplatParams:
        """The splats of all levels of a stream, in its own axes.

        Raises:
            InputError: the stream is damaged, cut short, or would take too much memory.
        """
        view = self._file.item("bufferViews", number)
        place = tuple(
            self._file.count(view, key, 0) for key in ("buffer", "byteOffset", "byteLength")
        )
        if place not in self._splats:
            self._splats[place] = self._decoded(number)
        return self._splats[place]

    def _decoded(self, number: int) -> SplatParams:
        path = self._file.path
        data, size = self._file.part(number)
        if len(data) < size:
            raise InputError(
                f"{path}: cut short: {len(data):,} of the {size:,} bytes of its stream are there"
            )
        self._n_bytes += size
        if self._n_bytes > self._file.n_bytes:
            raise InputError(f"{path}: the streams in it take more bytes than it has: refused")
        try:
            directory = read_directory(data)
            n_each = 4 * (11 + 3 * (directory.sh_degree + 1) ** 2)
            needed = levels(directory)[-1].n_leaves * n_each
            if needed > max(FREE, MAX_RATIO * size):
                raise InputError(
                    f"{path}: the {size:,} bytes of its stream say that they hold {needed:,}, more"
                    f" than {MAX_RATIO} times as many: refused"
                )
            splats = decode_leaves(data, directory=directory)
        except StreamError as error:
            raise InputError(f"{path}: its stream: {error}") from error
        self.allowance += needed // RATIO
        self.info = directory.info
        return splats
