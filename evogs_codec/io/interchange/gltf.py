"""`.glb` and `.gltf` with KHR_gaussian_splatting: splats as points with attributes of floats.

glTF is right-handed with y up, and what is in front faces z: LUF. The numbers of drafts before the
release candidate, whose scales were logarithms, are read too.

Letters: N splats, K SH coefficients.
"""

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

from evogs_codec._generated import registry
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import check_splats, read_bytes
from evogs_codec.io.interchange.frames import PLY_FRAME, info_of_frame, transformed, turn
from evogs_codec.io.interchange.values import C0, as_bytes, log_scales_of, logits_of, sigmoid, unit
from evogs_codec.io.makers import comment_of
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, SplatParams

__all__ = ["FRAME", "MAGIC", "is_gltf", "read", "write"]

MAGIC = b"glTF"
FRAME = "LUF"
KHR = "KHR_gaussian_splatting"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
POINTS, FLOAT, ARRAY = 0, 5126, 34962
TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
COLOUR_SPACES = {"srgb_rec709_display": "srgb", "lin_rec709_display": "linear"}
MAX_NODES = 10_000


def is_gltf(path: Path, start: bytes) -> bool:
    """Whether a file is a `.glb`, or JSON that is named `.gltf` or begins as one."""
    if start.startswith(MAGIC):
        return True
    text = start.lstrip()
    return text.startswith(b"{") and (path.suffix.lower() == ".gltf" or b'"asset"' in text[:4096])


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of all meshes of a scene, placed by its nodes and turned to the frame of a `.ply`.

    Raises:
        InputError: the file is damaged, or has no splats that can be read.
    """
    file = _open(path)
    found: list[tuple[F64, SplatParams]] = []
    known: dict[
        int, SplatParams
    ] = {}  # by the identity of its primitive, which may be placed often
    spaces, n_splats, most = set(), 0, 0
    for placed, mesh in _placed_meshes(file):
        for primitive in file.list_of(mesh, "primitives"):
            extension = _dict(_dict(primitive).get("extensions")).get(KHR)
            if not isinstance(extension, dict):
                continue
            if id(primitive) not in known:
                known[id(primitive)] = _splats(file, primitive, extension)
                spaces.add(COLOUR_SPACES.get(str(extension.get("colorSpace")), "unspecified"))
            splats = known[id(primitive)]
            n_splats, most = n_splats + len(splats), max(most, splats.sh.shape[1])
            check_splats(path, n_splats, most, file.n_bytes)
            found.append((placed, splats))
    parts = [transformed(splats, at[:3, :3], at[:3, 3]) for at, splats in found]
    if not parts:
        raise InputError(f"{path}: it has no splats ({KHR}) in a scene; is it a mesh?")
    space = spaces.pop() if len(spaces) == 1 else "unspecified"
    info = SceneInfo(colour_space=registry.COLOUR_SPACES.index(space))
    splats = transformed(_joined(parts), turn(FRAME, PLY_FRAME))
    return splats, info_of_frame(info, FRAME)


def _joined(parts: list[SplatParams]) -> SplatParams:
    k = max(part.sh.shape[1] for part in parts)
    padded = [
        np.concatenate(
            [part.sh, np.zeros((len(part), k - part.sh.shape[1], 3), np.float32)], axis=1
        )
        for part in parts
    ]
    return SplatParams(
        np.concatenate([part.means for part in parts]),
        np.concatenate([part.quats for part in parts]),
        np.concatenate([part.log_scales for part in parts]),
        np.concatenate([part.opacity_logits for part in parts]),
        np.concatenate(padded),
    )


# --- the file -------------------------------------------------------------------------------------


@dataclass
class _File:
    """A glTF file.

    Attributes:
        path: of the file.
        root: its JSON.
        binary: the binary chunk, empty if there is none.
        n_bytes: of the file and its buffers so far.
        buffers: those that were read, by number.
    """

    path: Path
    root: dict[str, Any]
    binary: memoryview
    n_bytes: int
    buffers: dict[int, memoryview] = field(default_factory=dict)

    def list_of(self, parent: dict[str, Any], key: str) -> list[Any]:
        found = parent.get(key, [])
        if not isinstance(found, list):
            raise InputError(f"{self.path}: '{key}' is no list")
        return found

    def item(self, key: str, number: object) -> dict[str, Any]:
        """The object of a list of the root that a number names."""
        items = self.list_of(self.root, key)
        if type(number) is not int or not 0 <= number < len(items):
            raise InputError(f"{self.path}: there is no number {shown(number)} in '{key}'")
        return _dict(items[number])

    def count(self, parent: dict[str, Any], key: str, default: int | None = None) -> int:
        found = parent.get(key, default)
        if type(found) is not int or not 0 <= found < 1 << 40:
            raise InputError(
                f"{self.path}: '{key}' is no number of bytes or splats: {shown(found)}"
            )
        return found

    def buffer(self, number: object) -> memoryview:
        entry = self.item("buffers", number)
        assert isinstance(number, int)
        if number not in self.buffers:
            uri = entry.get("uri")
            data = self.binary if uri is None and number == 0 else self._fetched(uri)
            size = self.count(entry, "byteLength")
            if size > len(data):
                raise InputError(
                    f"{self.path}: cut short: buffer {number} has {len(data):,} of {size:,} bytes"
                )
            self.buffers[number] = data[:size]
        return self.buffers[number]

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
        name = Path(unquote(uri))
        if ":" in uri or name.is_absolute() or ".." in name.parts or "\0" in uri:
            raise InputError(f"{self.path}: its buffer {shown(uri)} is not a file beside it")
        if not (self.path.parent / name).is_file():
            raise InputError(f"{self.path}: its buffer {shown(uri)} is not there")
        data = read_bytes(self.path.parent / name)
        self.n_bytes += len(data)
        return memoryview(data)

    def accessor(self, number: object, width: str) -> F32:
        """(n, width) or (n,) the numbers of an accessor."""
        entry = self.item("accessors", number)
        kind = entry.get("componentType")
        if entry.get("type") != width or kind not in TYPES:
            raise InputError(f"{self.path}: accessor {number} is not {width} of a known type")
        if "sparse" in entry or "bufferView" not in entry:
            raise InputError(f"{self.path}: accessor {number} is sparse or has no bytes: not read")
        view = self.item("bufferViews", entry["bufferView"])
        if view.get("extensions"):
            names = shown(", ".join(_dict(view["extensions"])))
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


def _open(path: Path) -> _File:
    data = read_bytes(path)
    if not data.startswith(MAGIC):
        return _File(path, _json(path, data), memoryview(b""), len(data))
    if len(data) < 20:
        raise InputError(f"{path}: cut short: a .glb has a header of 20 bytes")
    version, size, n_json, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2 or kind != JSON_CHUNK:
        raise InputError(f"{path}: is no .glb of version 2 that begins with JSON")
    if size > len(data) or 20 + n_json > len(data):
        raise InputError(f"{path}: cut short: {len(data):,} of {size:,} bytes are there")
    at, binary = 20 + n_json, memoryview(b"")
    if at + 8 <= len(data):
        n_binary, kind = struct.unpack_from("<II", data, at)
        if kind == BIN_CHUNK:
            binary = memoryview(data)[at + 8 : at + 8 + n_binary]
    return _File(path, _json(path, data[20 : 20 + n_json]), binary, len(data))


def _json(path: Path, text: bytes) -> dict[str, Any]:
    try:
        root = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its JSON is damaged: {shown(error)}") from error
    if not isinstance(root, dict):
        raise InputError(f"{path}: its JSON is no object")
    return root


def _dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


# --- nodes ----------------------------------------------------------------------------------------


def _placed_meshes(file: _File) -> Iterator[tuple[F64, dict[str, Any]]]:
    """Each mesh of the scene with the (4, 4) matrix that places it."""
    if "scenes" in file.root:
        roots = file.list_of(file.item("scenes", file.root.get("scene", 0)), "nodes")
    else:  # then nodes that no other has as a child, or a mesh alone
        nodes = [_dict(node) for node in file.list_of(file.root, "nodes")]
        children = {str(child) for node in nodes for child in file.list_of(node, "children")}
        roots = [i for i in range(len(nodes)) if str(i) not in children]
        if not nodes:
            yield from ((np.eye(4), _dict(mesh)) for mesh in file.list_of(file.root, "meshes"))
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


def _matrix(file: _File, node: dict[str, Any]) -> F64:
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
    near = np.abs(matrix[:3, :3] - np.rint(matrix[:3, :3])) < 1e-6
    matrix[:3, :3] = np.where(near, np.rint(matrix[:3, :3]), matrix[:3, :3])  # quarter turns
    return matrix


# --- splats ---------------------------------------------------------------------------------------


def _splats(file: _File, primitive: dict[str, Any], extension: dict[str, Any]) -> SplatParams:
    attributes = _dict(primitive.get("attributes"))
    inner = _dict(extension.get("extensions"))
    kernel = extension.get("kernel", "ellipse")
    if kernel != "ellipse":
        raise InputError(f"{file.path}: its splats have the kernel {shown(kernel)}, not 'ellipse'")
    needed = ("POSITION", f"{KHR}:ROTATION", f"{KHR}:SCALE", f"{KHR}:OPACITY", _coefficient(0, 0))
    missing = [name for name in needed if name not in attributes]
    if missing:
        by = shown(", ".join(inner))
        compressed = f": its splats are compressed ({by}), which is not read" if inner else ""
        raise InputError(f"{file.path}: no attribute {missing[0]}{compressed}")
    means = file.accessor(attributes["POSITION"], "VEC3")
    xyzw = file.accessor(attributes[f"{KHR}:ROTATION"], "VEC4")
    scales = file.accessor(attributes[f"{KHR}:SCALE"], "VEC3")
    opacities = file.accessor(attributes[f"{KHR}:OPACITY"], "SCALAR")
    bands = []
    for band in range(4):
        names = [_coefficient(band, n) for n in range(2 * band + 1)]
        if not set(names) <= attributes.keys():
            break
        bands += [file.accessor(attributes[name], "VEC3") for name in names]
    columns = (means, xyzw, scales, opacities, *bands)
    if len({len(column) for column in columns}) != 1:
        raise InputError(f"{file.path}: the attributes of a primitive have different lengths")
    # Scales are never negative: those of early drafts are logarithms.
    log_scales = scales if (scales < 0).any() else log_scales_of(scales)
    return SplatParams(
        means, np.roll(xyzw, 1, axis=1), log_scales, logits_of(opacities), np.stack(bands, axis=1)
    )


def _coefficient(band: int, n: int) -> str:
    return f"{KHR}:SH_DEGREE_{band}_COEF_{n}"


# --- writing --------------------------------------------------------------------------------------


def write(splats: SplatParams, info: SceneInfo, command: str) -> bytes:
    """A `.glb`; the splats are in its frame."""
    if not len(splats):
        raise InputError("a .glb holds at least one splat")
    attributes = _attributes(splats)
    views, accessors, at = [], [], 0
    for name, values in attributes.items():
        views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes, "target": ARRAY})
        width = 1 if values.ndim == 1 else values.shape[1]
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1,
            "componentType": FLOAT if values.dtype == np.float32 else 5121,
            "count": len(values),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width],
        }
        if name == "POSITION":
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        if name == "COLOR_0":
            accessor["normalized"] = True
        accessors.append(accessor)
        at += values.nbytes
    space = registry.name(registry.COLOUR_SPACES, info.colour_space)
    extension = {
        "kernel": "ellipse",
        "colorSpace": "lin_rec709_display" if space == "linear" else "srgb_rec709_display",
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }
    primitive = {
        "mode": POINTS,
        "attributes": {name: i for i, name in enumerate(attributes)},
        "extensions": {KHR: extension},
    }
    asset = {"version": "2.0", "generator": comment_of(command)}
    if credit := info.text.get("author"):
        asset["copyright"] = credit
    root = {
        "asset": asset,
        "extensionsUsed": [KHR],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + at
    if size >= 1 << 32:
        raise InputError(f"{len(splats):,} splats need {size:,} bytes; a .glb has less than 2**32")
    head = MAGIC + struct.pack("<IIII", 2, size, len(text), JSON_CHUNK) + text
    chunk = struct.pack("<II", at, BIN_CHUNK)
    return b"".join([head, chunk, *(values.tobytes() for values in attributes.values())])


def _attributes(splats: SplatParams) -> dict[str, Any]:
    opacities = sigmoid(splats.opacity_logits)
    colours = np.concatenate([splats.sh[:, 0] * C0 + 0.5, opacities[:, None]], axis=1)
    with np.errstate(over="ignore", under="ignore"):
        scales = np.minimum(np.exp(splats.log_scales), np.finfo(np.float32).max)
    attributes: dict[str, Any] = {
        "POSITION": splats.means,
        "COLOR_0": as_bytes(colours * 255),
        f"{KHR}:ROTATION": np.roll(unit(splats.quats), -1, axis=1),
        f"{KHR}:SCALE": scales,
        f"{KHR}:OPACITY": opacities,
    }
    for band in range(splats.sh_degree + 1):
        for n in range(2 * band + 1):
            attributes[_coefficient(band, n)] = splats.sh[:, band**2 + n]
    return attributes
