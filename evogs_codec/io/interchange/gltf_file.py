"""glTF files: JSON, buffers, accessors, meshes placed by nodes; nothing is believed unchecked."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import read_bytes
from evogs_codec.model.splats import F32, F64

__all__ = [
    "BIN_CHUNK",
    "FLOAT",
    "JSON_CHUNK",
    "MAGIC",
    "GltfFile",
    "as_object",
    "is_gltf",
    "open_gltf",
    "open_gltf_start",
    "placed_meshes",
]

MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
FLOAT = 5126
TYPES: dict[float, str] = {
    5120: "<i1",
    5121: "<u1",
    5122: "<i2",
    5123: "<u2",
    5125: "<u4",
    FLOAT: "<f4",
}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
MAX_NODES = 10_000


# --- the file -------------------------------------------------------------------------------------


@dataclass
class GltfFile:
    """A glTF file.

    Attributes:
        path: of the file.
        root: its JSON.
        binary: the binary chunk, empty if there is none.
        n_bytes: of the file and its buffers so far.
        n_missing: bytes at the end of a `.glb` that are not there.
        buffers: what is there of those that were read, by number.
        files: of buffers, which several may name; each is read once.
    """

    path: Path
    root: dict[str, Any]
    binary: memoryview
    n_bytes: int
    n_missing: int = 0
    buffers: dict[int, memoryview] = field(default_factory=dict)
    files: dict[Path, memoryview] = field(default_factory=dict)

    def list_of(self, parent: dict[str, Any], key: str) -> list[Any]:
        """The list of an object; an empty one if it has none."""
        found = parent.get(key, [])
        if not isinstance(found, list):
            raise InputError(f"{self.path}: '{key}' is no list")
        return found

    def item(self, key: str, number: object) -> dict[str, Any]:
        """The object of a list of the root that a number names."""
        items = self.list_of(self.root, key)
        if type(number) is not int or not 0 <= number < len(items):
            raise InputError(f"{self.path}: there is no number {shown(number)} in '{key}'")
        return as_object(items[number])

    def count(self, parent: dict[str, Any], key: str, default: int | None = None) -> int:
        """A number of bytes or rows of an object."""
        found = parent.get(key, default)
        if type(found) is not int or not 0 <= found < 1 << 40:
            raise InputError(
                f"{self.path}: '{key}' is no number of bytes or splats: {shown(found)}"
            )
        return found

    def buffer(self, number: object) -> memoryview:
        """The bytes of a buffer, all of them."""
        data, size = self._there(number)
        if size > len(data):
            raise InputError(
                f"{self.path}: cut short: buffer {number} has {len(data):,} of {size:,} bytes"
            )
        return data

    def part(self, number: object) -> tuple[memoryview, int]:
        """What is there of the bytes of a buffer view, and how many it has."""
        view = self.item("bufferViews", number)
        if view.get("extensions"):
            names = shown(", ".join(as_object(view["extensions"])))
            raise InputError(f"{self.path}: its bytes are compressed ({names}), which is not read")
        data, size = self._there(view.get("buffer"))
        start, length = self.count(view, "byteOffset", 0), self.count(view, "byteLength")
        if start + length > size:
            raise InputError(f"{self.path}: buffer view {number} ends after the end of its buffer")
        return data[start : start + length], length

    def _there(self, number: object) -> tuple[memoryview, int]:
        """What is there of the bytes of a buffer, and how many it has."""
        entry = self.item("buffers", number)
        assert isinstance(number, int)
        if number not in self.buffers:
            uri = entry.get("uri")
            data = self.binary if uri is None and number == 0 else self._fetched(uri)
            self.buffers[number] = data[: self.count(entry, "byteLength")]
        return self.buffers[number], self.count(entry, "byteLength")

    def _fetched(self, uri: object) -> memoryview:
        if not isinstance(uri, str):
            raise InputError(f"{self.path}: a buffer has no uri and is not that of a .glb")
        head, comma, body = uri.partition(",")
        if head.startswith("data:") and comma:
            try:
                data = (
                    base64.b64decode(body) if head.endswith(";base64") else unquote(body).encode()
                )
            except ValueError as error:
                raise InputError(f"{self.path}: a data URI is damaged: {shown(error)}") from error
            return memoryview(data)
        name = self._beside(uri)
        if name not in self.files:
            self.files[name] = memoryview(read_bytes(self.path.parent / name))
            self.n_bytes += len(self.files[name])
        return self.files[name]

    def _beside(self, uri: str) -> Path:
        """The file that a uri names, from the folder of this one."""
        name = Path(unquote(uri))
        if ":" in uri or name.is_absolute() or ".." in name.parts or "\0" in uri:
            raise InputError(f"{self.path}: its buffer {shown(uri)} is not a file beside it")
        if not (self.path.parent / name).is_file():
            raise InputError(f"{self.path}: its buffer {shown(uri)} is not there")
        return name

    def size(self) -> int:
        """Bytes of the file and of all files that its buffers name, each once.

        Raises:
            InputError: a file is not there.
        """
        uris = [as_object(entry).get("uri") for entry in self.list_of(self.root, "buffers")]
        names = {self._beside(uri) for uri in uris if isinstance(uri, str) and ":" not in uri}
        beside = [(self.path.parent / name).stat().st_size for name in names]
        return self.path.stat().st_size + sum(beside)

    def accessor(self, number: object, width: str) -> F32:
        """(n, width) or (n,) the numbers of an accessor."""
        entry = self.item("accessors", number)
        kind = entry.get("componentType")
        if entry.get("type") != width or not isinstance(kind, int | float) or kind not in TYPES:
            raise InputError(f"{self.path}: accessor {number} is not {width} of a known type")
        if "sparse" in entry or "bufferView" not in entry:
            raise InputError(f"{self.path}: accessor {number} is sparse or has no bytes: not read")
        view = self.item("bufferViews", entry["bufferView"])
        if view.get("extensions"):
            names = shown(", ".join(as_object(view["extensions"])))
            raise InputError(f"{self.path}: its bytes are compressed ({names}), which is not read")
        buffer, dtype, n_each = (
            self.buffer(view.get("buffer")),
            np.dtype(TYPES[kind]),
            WIDTHS[width],
        )
        n, size = self.count(entry, "count"), dtype.itemsize * n_each
        start, length = self.count(view, "byteOffset", 0), self.count(view, "byteLength")
        stride, at = (
            self.count(view, "byteStride", size) or size,
            self.count(entry, "byteOffset", 0),
        )
        end = start + at + (stride * (n - 1) + size if n else 0)
        if end > min(start + length, len(buffer)) or stride < size:
            raise InputError(f"{self.path}: accessor {number} ends after the end of its bytes")
        if n == 0:
            return np.empty((0, n_each) if n_each > 1 else 0, np.float32)
        raw = np.ndarray((n, n_each), dtype, buffer, start + at, (stride, dtype.itemsize))
        numbers = raw.astype(np.float32)
        if entry.get("normalized") and kind != FLOAT:
            numbers = np.maximum(numbers / np.float32(np.iinfo(dtype).max), -1)
        return numbers if n_each > 1 else numbers[:, 0]


def is_gltf(path: Path, start: bytes) -> bool:
    """Whether a file is a `.glb`, or JSON that is named `.gltf` or begins as one."""
    if start.startswith(MAGIC):
        return True
    text = start.lstrip()
    return text.startswith(b"{") and (path.suffix.lower() == ".gltf" or b'"asset"' in text[:4096])


def open_gltf(path: Path) -> GltfFile:
    """A glTF file, whose JSON is read and nothing else.

    Raises:
        InputError: it is damaged, or cut short.
    """
    file = open_gltf_start(path)
    if file.n_missing:
        there, size = file.n_bytes, file.n_bytes + file.n_missing
        raise InputError(f"{path}: cut short: {there:,} of {size:,} bytes are there")
    return file


def open_gltf_start(path: Path) -> GltfFile:
    """A glTF file as `open_gltf`, perhaps without the end of its binary chunk.

    Raises:
        InputError: it is damaged, or its JSON is cut short.
    """
    data = read_bytes(path)
    if not data.startswith(MAGIC):
        return GltfFile(path, _json(path, data), memoryview(b""), len(data))
    if len(data) < 20:
        raise InputError(f"{path}: cut short: a .glb has a header of 20 bytes")
    version, size, n_json, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2 or kind != JSON_CHUNK:
        raise InputError(f"{path}: is no .glb of version 2 that begins with JSON")
    at, binary = 20 + n_json, memoryview(b"")
    if at > len(data):
        raise InputError(f"{path}: cut short: {len(data):,} of {size:,} bytes are there")
    if at + 8 <= len(data):
        n_binary, kind = struct.unpack_from("<II", data, at)
        if kind == BIN_CHUNK:
            binary = memoryview(data)[at + 8 : at + 8 + n_binary]
    root = _json(path, data[20:at])
    return GltfFile(path, root, binary, len(data), max(0, size - len(data)))


def _json(path: Path, text: bytes) -> dict[str, Any]:
    try:
        root = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its JSON is damaged: {shown(error)}") from error
    if not isinstance(root, dict):
        raise InputError(f"{path}: its JSON is no object")
    return root


def as_object(value: object) -> dict[str, Any]:
    """The object of JSON, or an empty one in place of anything else."""
    return value if isinstance(value, dict) else {}


# --- nodes ----------------------------------------------------------------------------------------


def placed_meshes(file: GltfFile) -> Iterator[tuple[F64, dict[str, Any]]]:
    """Each mesh of the scene with the (4, 4) matrix that places it."""
    if "scenes" in file.root:
        roots = file.list_of(file.item("scenes", file.root.get("scene", 0)), "nodes")
    else:  # then nodes that no other has as a child, or a mesh alone
        nodes = [as_object(node) for node in file.list_of(file.root, "nodes")]
        children = {str(child) for node in nodes for child in file.list_of(node, "children")}
        roots = [i for i in range(len(nodes)) if str(i) not in children]
        if not nodes:
            yield from ((np.eye(4), as_object(mesh)) for mesh in file.list_of(file.root, "meshes"))
    waiting = [(np.eye(4), number) for number in reversed(roots)]
    n_done = 0
    while waiting:
        above, number = waiting.pop()
        n_done += 1
        if n_done > min(MAX_NODES, len(file.list_of(file.root, "nodes"))):
            raise InputError(f"{file.path}: its nodes are no tree, or over {MAX_NODES:,}")
        node = file.item("nodes", number)
        placed = above @ _matrix(file, node)
        if "mesh" in node:
            yield placed, file.item("meshes", node["mesh"])
        waiting += [(placed, child) for child in reversed(file.list_of(node, "children"))]


def _matrix(file: GltfFile, node: dict[str, Any]) -> F64:
    """(4, 4) where a node places what is in it."""

    def numbers(key: str, default: list[float]) -> F64:
        found = node.get(key, default)
        listed = isinstance(found, list) and len(found) == len(default)
        if not listed or not all(type(x) in (int, float) and abs(x) < 1e30 for x in found):
            raise InputError(f"{file.path}: '{key}' of a node is not {len(default)} numbers")
        return np.array(found, np.float64)

    if "matrix" in node:
        matrix = numbers("matrix", [0.0] * 16).reshape(4, 4).T
    else:
        x, y, z, w = numbers("rotation", [0, 0, 0, 1])
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, :3] *= numbers("scale", [1, 1, 1])
        matrix[:3, 3] = numbers("translation", [0, 0, 0])
    squares = matrix[:3, :3].T @ matrix[:3, :3]
    factor = float(np.trace(squares)) / 3
    if not factor > 0 or np.abs(squares - factor * np.eye(3)).max() > 1e-4 * factor:
        raise InputError(f"{file.path}: a node stretches its splats unevenly, which is not read")
    slack = 1e-6 * min(1.0, float(np.sqrt(factor)))
    near = np.abs(matrix[:3, :3] - np.rint(matrix[:3, :3])) < slack
    matrix[:3, :3] = np.where(near, np.rint(matrix[:3, :3]), matrix[:3, :3])  # quarter turns
    return matrix
