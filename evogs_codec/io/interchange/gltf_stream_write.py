"""Streams in glTF files: EVOGS_gaussian_splatting_compression, written.

`spec/EVOGS_gaussian_splatting_compression/README.md` is its text. The bytes of the stream are not
decoded: counts and bounds are those of its directory. Only a fallback has splats of its level 0.
"""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from evogs_codec._generated import registry
from evogs_codec.decoding.cut import scene_bounds
from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.editing.byte_stats import levels
from evogs_codec.errors import InputError
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.io import makers
from evogs_codec.io.files import FileKind, write_atomic
from evogs_codec.io.interchange import gltf
from evogs_codec.io.interchange.frames import frame_of, turn
from evogs_codec.io.interchange.gltf_file import FLOAT
from evogs_codec.io.interchange.gltf_stream import EXTENSION, KHR, VERSION
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64
from evogs_codec.stores.sources import Source, bytes_of

__all__ = ["GLTF", "write_gltf_stream"]

GLTF = FileKind(".gltf", (b'{"asset":',), made_by=makers.marked_gltf)
# The frame of a scene that says what is up and nothing else.
FRAMES = {"+x": "URF", "-x": "DLF", "+y": "RUB", "-y": "RDF", "+z": "RFU", "-z": "RBD"}


def write_gltf_stream(
    path: str | os.PathLike[str],
    stream: Source,
    *,
    fallback: bool = False,
    made_by: str = "evogs",
) -> None:
    """Write a `.glb` with a stream in it, or a `.gltf` that names the file of one.

    Args:
        path: the file to make or replace; the ending says which of both.
        stream: the bytes of a whole stream, or its path, which a `.gltf` needs.
        fallback: add the splats of level 0, uncompressed, for readers that do not know streams.
        made_by: the program, which is named in the file.

    Raises:
        InputError: the stream is not whole, has no splats, does not fit in a `.glb`, or lies where
            a `.gltf` cannot name it.
        StreamError: the stream is not legal.
        OSError: a file cannot be read or written.
    """
    at, data = Path(path), bytes_of(stream)
    directory = read_directory(data)
    if len(data) != directory.size:
        raise InputError(
            f"{at}: the stream has {len(data):,} of {directory.size:,} bytes: get all of it first"
        )
    if at.suffix.lower() == ".gltf":
        if not isinstance(stream, str | os.PathLike):
            raise InputError(f"{at}: a .gltf names the file of its stream: give its path")
        root = _beside(at, Path(stream), data, directory, fallback, made_by)
        write_atomic(at, gltf.as_text(root))
        return
    root, arrays = _described(data, directory, fallback, made_by)
    start = sum(map(len, arrays))
    root["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": len(data)})
    root["buffers"] = [{"byteLength": start + len(data)}]
    try:
        write_atomic(at, gltf.as_glb(root, [*arrays, data]))
    except InputError as error:
        raise InputError(f"{at}: {error}; a .gltf beside its stream has no limit") from error


def _beside(
    at: Path, stream: Path, data: memoryview, directory: Directory, fallback: bool, made_by: str
) -> dict[str, Any]:
    """The JSON of a `.gltf` whose last buffer is the file of a stream."""
    name = Path(os.path.relpath(os.path.realpath(stream), os.path.realpath(at.parent)))
    if ".." in name.parts or name.is_absolute():
        raise InputError(
            f"{at}: a .gltf names its stream by a path below its own folder: write it beside"
            f" {stream}, or make a .glb"
        )
    root, arrays = _described(data, directory, fallback, made_by)
    root["buffers"] = []
    if arrays:
        packed = base64.b64encode(b"".join(arrays)).decode()
        uri = f"data:application/octet-stream;base64,{packed}"
        root["buffers"].append({"byteLength": sum(map(len, arrays)), "uri": uri})
    root["bufferViews"].append({"buffer": len(root["buffers"]), "byteLength": len(data)})
    root["buffers"].append({"byteLength": len(data), "uri": quote(name.as_posix())})
    return root


def _described(
    data: memoryview, directory: Directory, fallback: bool, made_by: str
) -> tuple[dict[str, Any], list[bytes]]:
    """The JSON without the buffer of the stream and its view, which is last; arrays before it."""
    said: dict[str, Any] = {"version": VERSION, "levels": directory.n_levels}
    views: list[dict[str, Any]] = []
    arrays: list[bytes] = []
    if not levels(directory)[-1].n_leaves:
        raise InputError("a glTF file holds at least one splat")
    if fallback:
        attributes = gltf.attributes_of(_level_0(data, directory), directory.info)
        views, accessors, _ = gltf.packed(attributes)
        arrays = [values.tobytes() for values in attributes.values()]
        names = list(attributes)
        said["fallbackLevel"] = 0
    else:
        names, accessors = ["POSITION"], [_positions(directory)]
    said = {"bufferView": len(views), **said}
    splatting = gltf.splatting(directory.info) | {"extensions": {EXTENSION: said}}
    primitive = {
        "mode": gltf.POINTS,
        "attributes": {name: number for number, name in enumerate(names)},
        "extensions": {KHR: splatting},
    }
    needed = {} if fallback else {"extensionsRequired": [KHR, EXTENSION]}
    root = {
        "asset": gltf.asset_of(directory.info, made_by),
        "extensionsUsed": [KHR, EXTENSION],
        **needed,
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": _matrix(directory.info)}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
    }
    return root, arrays


def _level_0(data: memoryview, directory: Directory) -> Any:  # noqa: ANN401
    splats = decode_leaves(data, level=0, directory=directory)
    if not len(splats):
        raise InputError("level 0 has no splats: there is no fallback")
    return splats


def _positions(directory: Directory) -> dict[str, Any]:
    """The accessor of positions that are in the stream alone."""
    low, high = scene_bounds(directory)
    return {
        "componentType": FLOAT,
        "count": levels(directory)[-1].n_leaves,
        "type": "VEC3",
        "min": _outward(low, -np.inf),
        "max": _outward(high, np.inf),
    }


def _outward(corner: F64, towards: float) -> list[float]:
    """The nearest floats of 32 bits that are not inside."""
    near = corner.astype(np.float32)
    inside = near > corner if towards < 0 else near < corner
    found: list[float] = np.where(inside, np.nextafter(near, np.float32(towards)), near).tolist()
    return found


def _matrix(info: SceneInfo) -> list[float]:
    """The matrix of a node, column by column, from the axes of a stream to those of glTF."""
    up = registry.name(registry.UP_AXES, info.up_axis)
    frame = frame_of(info) if info.coordinate_system else FRAMES.get(up, frame_of(info))
    matrix = np.eye(4)
    matrix[:3, :3] = turn(frame, gltf.FRAME)
    return [float(number) for number in matrix.T.ravel()]
