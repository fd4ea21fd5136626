"""`.glb` and `.gltf` with KHR_gaussian_splatting: splats as points with attributes of floats.

glTF is right-handed with y up, and what is in front faces z: LUF. The numbers of drafts before the
release candidate, whose scales were logarithms, are read too.

Letters: N splats, K SH coefficients.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evogs_codec._generated import registry
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.bounded import check_splats
from evogs_codec.io.interchange.frames import PLY_FRAME, info_of_frame, transformed, turn
from evogs_codec.io.interchange.gltf_file import (
    BIN_CHUNK,
    FLOAT,
    JSON_CHUNK,
    MAGIC,
    GltfFile,
    as_object,
    is_gltf,
    open_gltf,
    placed_meshes,
)
from evogs_codec.io.interchange.gltf_stream import KHR, Streams
from evogs_codec.io.interchange.values import C0, as_bytes, log_scales_of, logits_of, sigmoid, unit
from evogs_codec.io.makers import comment_of
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, SplatParams
from evogs_codec.model.viewpoint import CAMERA, CAMERAS

__all__ = [
    "FRAME",
    "KHR",
    "MAGIC",
    "POINTS",
    "as_glb",
    "as_text",
    "asset_of",
    "attributes_of",
    "is_gltf",
    "packed",
    "read",
    "splatting",
    "write",
]

FRAME = "LUF"

POINTS, BYTE, ARRAY = 0, 5121, 34962  # numbers of glTF
IN_AXES = (CAMERA, CAMERAS, "crs", "transform")  # metadata in the coordinates of a stream
COLOUR_SPACES = {"srgb_rec709_display": "srgb", "lin_rec709_display": "linear"}


def read(path: Path) -> tuple[SplatParams, SceneInfo]:
    """The splats of all meshes of a scene, placed by its nodes and turned to the frame of a `.ply`.

    Raises:
        InputError: the file is damaged, or has no splats that can be read.
    """
    file = open_gltf(path)
    streams = Streams(file)
    found: list[tuple[F64, SplatParams]] = []
    known: dict[
        int, SplatParams
    ] = {}  # by the identity of its primitive, which may be placed often
    spaces, n_splats, most = set(), 0, 0
    for placed, mesh in placed_meshes(file):
        for primitive in file.list_of(mesh, "primitives"):
            extension = as_object(as_object(primitive).get("extensions")).get(KHR)
            if not isinstance(extension, dict):
                continue
            if id(primitive) not in known:
                number = streams.number_in(extension)
                if number is None:
                    known[id(primitive)] = _splats(file, primitive, extension)
                else:
                    known[id(primitive)] = streams.splats(number)
                spaces.add(COLOUR_SPACES.get(str(extension.get("colorSpace")), "unspecified"))
            splats = known[id(primitive)]
            n_splats, most = n_splats + len(splats), max(most, splats.sh.shape[1])
            check_splats(path, n_splats, most, file.n_bytes + streams.allowance)
            found.append((placed, splats))
    parts = [transformed(splats, at[:3, :3], at[:3, 3]) for at, splats in found]
    if not parts and "geometricError" in file.root:
        raise InputError(f"{path}: is a tileset: `evogs decode {path} OUT.ply` makes a scene of it")
    if not parts:
        raise InputError(f"{path}: it has no splats ({KHR}) in a scene; is it a mesh?")
    space = spaces.pop() if len(spaces) == 1 else "unspecified"
    said = SceneInfo()
    if len(found) == 1:
        at = found[0][0]
        moves = not np.array_equal(turn(FRAME, PLY_FRAME) @ at[:3], np.eye(4)[:3])
        said = _of_scene(streams.info, moves=moves)
    info = replace(said, colour_space=registry.COLOUR_SPACES.index(space))
    splats = transformed(SplatParams.joined(parts), turn(FRAME, PLY_FRAME))
    return splats, info_of_frame(info, FRAME)


def _of_scene(info: SceneInfo, *, moves: bool) -> SceneInfo:
    """What a stream says that holds for its splats outside, where they may have moved."""
    here = () if moves else IN_AXES
    kept = {*registry.TEXT_OPTIONS, *here}
    return replace(info, text={k: value for k, value in info.text.items() if k in kept})


# --- splats ---------------------------------------------------------------------------------------


def _splats(file: GltfFile, primitive: dict[str, Any], extension: dict[str, Any]) -> SplatParams:
    attributes = as_object(primitive.get("attributes"))
    inner = as_object(extension.get("extensions"))
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
    attributes = attributes_of(splats, info)
    views, accessors, n_bytes = packed(attributes)
    primitive = {
        "mode": POINTS,
        "attributes": {name: i for i, name in enumerate(attributes)},
        "extensions": {KHR: splatting(info)},
    }
    root = {
        "asset": asset_of(info, command),
        "extensionsUsed": [KHR],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": n_bytes}],
    }
    return as_glb(root, [values.tobytes() for values in attributes.values()])


def asset_of(info: SceneInfo, command: str) -> dict[str, str]:
    """Who made a file, by a command."""
    asset = {"version": "2.0", "generator": comment_of(command)}
    if credit := info.text.get("author"):
        asset["copyright"] = credit
    return asset


def splatting(info: SceneInfo) -> dict[str, Any]:
    """The object of KHR_gaussian_splatting of a primitive."""
    space = registry.name(registry.COLOUR_SPACES, info.colour_space)
    return {
        "kernel": "ellipse",
        "colorSpace": "lin_rec709_display" if space == "linear" else "srgb_rec709_display",
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }


def packed(
    attributes: dict[str, Any],
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], int]:
    """Buffer views and accessors of arrays that follow one another in buffer 0, and their bytes."""
    views, accessors, at = [], [], 0
    for name, values in attributes.items():
        views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes, "target": ARRAY})
        width = 1 if values.ndim == 1 else values.shape[1]
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1,
            "componentType": FLOAT if values.dtype == np.float32 else BYTE,
            "count": len(values),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width],
        }
        if name == "POSITION":
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        if name == "COLOR_0":
            accessor["normalized"] = True
        accessors.append(accessor)
        at += values.nbytes
    return views, accessors, at


def as_glb(root: dict[str, Any], parts: Sequence[bytes | memoryview]) -> bytes:
    """A `.glb` of this JSON and these bytes, which are its buffer 0.

    Raises:
        InputError: it would be too large.
    """
    text = as_text(root)
    text += b" " * (-len(text) % 4)
    n_bytes = sum(map(len, parts))
    padding = b"\0" * (-n_bytes % 4)
    n_bytes += len(padding)
    size = 12 + 8 + len(text) + 8 + n_bytes
    if size >= 1 << 32:
        raise InputError(f"a .glb has less than 2**32 bytes, and {size:,} are needed")
    head = MAGIC + struct.pack("<IIII", 2, size, len(text), JSON_CHUNK) + text
    return b"".join([head, struct.pack("<II", n_bytes, BIN_CHUNK), *parts, padding])


def as_text(root: dict[str, Any]) -> bytes:
    """JSON without spaces."""
    return json.dumps(root, separators=(",", ":")).encode()


def attributes_of(splats: SplatParams, info: SceneInfo) -> dict[str, Any]:
    """The arrays of the attributes of splats, by name; `info` says their colour space."""
    opacities = sigmoid(splats.opacity_logits)
    diffuse = np.clip(splats.sh[:, 0] * C0 + 0.5, 0, 1)
    if COLOUR_SPACES[splatting(info)["colorSpace"]] == "srgb":
        diffuse = _linear(diffuse)  # COLOR_0 is linear in glTF
    colours = np.concatenate([diffuse, opacities[:, None]], axis=1)
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


def _linear(srgb: F32) -> F32:
    """Colours of IEC 61966-2-1, 0 to 1, as linear ones."""
    curve = ((srgb + 0.055) / 1.055) ** 2.4
    found: F32 = np.where(srgb <= 0.04045, srgb / 12.92, curve).astype(np.float32)
    return found
