"""Writers of the folders that `reference_trainer.data` reads: Blender, nerfstudio and COLMAP.

Letters: P points, V views.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from evogs_codec.render import Camera

__all__ = ["FORMATS", "Cloud", "Shot", "write_blender", "write_colmap", "write_nerfstudio"]

F64: TypeAlias = npt.NDArray[np.float64]
Distortion: TypeAlias = tuple[float, float, float, float]

_FLIP = np.diag([1.0, -1.0, -1.0])  # our camera axes to y up and z backward
MAX_TRACK = 6  # views that a COLMAP point is written as seen by


class Shot(NamedTuple):
    """A photograph and its camera.

    Attributes:
        camera: the pinhole behind the lens.
        distortion: k1, k2, p1, p2 of the lens.
        pixels: (H, W, 3) or, with transparency, (H, W, 4).
        test: whether the view is held out, where the format can say so.
    """

    camera: Camera
    distortion: Distortion
    pixels: npt.NDArray[np.uint8]
    test: bool


class Cloud(NamedTuple):
    """Points on surfaces: (P, 3) in the world, and (P, 3) colours in 0..255."""

    points: F64
    colours: npt.NDArray[np.uint8]


def write_blender(folder: Path, shots: Sequence[Shot], cloud: Cloud) -> None:
    """NeRF-synthetic: `transforms_train.json`, `transforms_test.json`; no lens, no points.

    Raises:
        ValueError: a lens distorts, or a camera does not look along the middle of its picture.
    """
    del cloud  # the format has no place for it
    for split in ("train", "test"):
        chosen = [shot for shot in shots if shot.test == (split == "test")]
        frames = []
        for i, (camera, distortion, pixels, _) in enumerate(chosen):
            middle = (camera.cx, camera.cy) == (camera.width / 2, camera.height / 2)
            if any(distortion) or not middle or camera.fx != camera.fy:
                raise ValueError("a Blender file has one angle for a lens, nothing else")
            _save(folder / split / f"r_{i}.png", pixels)
            frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": _matrix(camera)})
        top: dict[str, Any] = {"frames": frames}
        if chosen:
            camera = chosen[0].camera
            top = {"camera_angle_x": 2 * math.atan(camera.width / 2 / camera.fx), **top}
        _write_json(folder / f"transforms_{split}.json", top)


def write_nerfstudio(folder: Path, shots: Sequence[Shot], cloud: Cloud) -> None:
    """`transforms.json` with the lens in every frame, names of test views, and `points.ply`."""
    frames = []
    for i, (camera, distortion, pixels, _) in enumerate(shots):
        _save(folder / _image_name(i), pixels)
        lens = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
        lens |= {"cx": camera.cx, "cy": camera.cy}
        lens |= dict(zip(("k1", "k2", "p1", "p2"), distortion, strict=True))
        frames.append({"file_path": _image_name(i), **lens, "transform_matrix": _matrix(camera)})
    splits = {
        key: [_image_name(i) for i, shot in enumerate(shots) if shot.test == test]
        for key, test in (("train_filenames", False), ("test_filenames", True))
    }
    top = {"camera_model": "OPENCV", "ply_file_path": "points.ply", **splits, "frames": frames}
    _write_json(folder / "transforms.json", top)
    _write_ply(folder / "points.ply", cloud)


def write_colmap(folder: Path, shots: Sequence[Shot], cloud: Cloud) -> None:
    """`images/` and a binary model in `sparse/0/`; a point is seen by views that it is inside."""
    _write_colmap(folder, shots, cloud, ".bin", _cameras_bin, _images_bin, _points_bin)


def write_colmap_text(folder: Path, shots: Sequence[Shot], cloud: Cloud) -> None:
    """`write_colmap` with a model in text."""
    _write_colmap(folder, shots, cloud, ".txt", _cameras_txt, _images_txt, _points_txt)


FORMATS: dict[str, Callable[[Path, Sequence[Shot], Cloud], None]] = {
    "blender": write_blender,
    "nerfstudio": write_nerfstudio,
    "colmap": write_colmap,
    "colmap-text": write_colmap_text,
}


def _save(path: Path, pixels: npt.NDArray[np.uint8]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, compress_level=4)


def _image_name(index: int) -> str:
    return f"images/view_{index:04d}.png"


def _matrix(camera: Camera) -> list[list[float]]:
    """(4, 4) camera to world, y up and z backward."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.rotation.T @ _FLIP
    matrix[:3, 3] = camera.position
    rows: list[list[float]] = matrix.tolist()
    return rows


def _write_json(path: Path, top: dict[str, Any]) -> None:
    path.write_text(json.dumps(top, indent=1) + "\n", encoding="utf-8")


def _write_ply(path: Path, cloud: Cloud) -> None:
    kinds = [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.empty(len(cloud.points), kinds)
    for i, (place, shade) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        rows[place], rows[shade] = cloud.points[:, i], cloud.colours[:, i]
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(str(path))


# ----------------------------------------------------------------------------------------- COLMAP


class _Sight(NamedTuple):
    """Where points are seen: pixels (x, y) by view, and (view, index there) by point."""

    by_view: list[list[tuple[float, float, int]]]
    by_point: list[list[tuple[int, int]]]


Writer: TypeAlias = Callable[[Path, Sequence[Shot], Cloud, _Sight], None]


def _write_colmap(
    folder: Path, shots: Sequence[Shot], cloud: Cloud, ending: str, *writers: Writer
) -> None:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True, exist_ok=True)
    for i, shot in enumerate(shots):
        _save(folder / _image_name(i), shot.pixels)
    sight = _sight(shots, cloud)
    for stem, write in zip(("cameras", "images", "points3D"), writers, strict=True):
        write(model / (stem + ending), shots, cloud, sight)


def _sight(shots: Sequence[Shot], cloud: Cloud) -> _Sight:
    """Points in the picture of a camera; what hides them is not asked."""
    sight = _Sight([[] for _ in shots], [[] for _ in cloud.points])
    for view, (camera, *_) in enumerate(shots):
        x, y, z = (cloud.points @ camera.rotation.T + camera.translation).T
        u = camera.fx * x / np.where(z > 0, z, np.nan) + camera.cx
        v = camera.fy * y / np.where(z > 0, z, np.nan) + camera.cy
        inside = (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
        for point in np.flatnonzero(inside).tolist():
            if len(sight.by_point[point]) < MAX_TRACK:
                sight.by_point[point].append((view, len(sight.by_view[view])))
                sight.by_view[view].append((float(u[point]), float(v[point]), point))
    return sight


def _params(shot: Shot) -> tuple[str, int, tuple[float, ...]]:
    """Name, number and parameters of the camera's model."""
    camera, distortion = shot.camera, shot.distortion
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
    return ("OPENCV", 4, pinhole + distortion) if any(distortion) else ("PINHOLE", 1, pinhole)


def _pose(camera: Camera) -> list[float]:
    """Quaternion w x y z and translation, world to camera."""
    x, y, z, w = Rotation.from_matrix(camera.rotation).as_quat().tolist()
    return [w, x, y, z, *camera.translation.tolist()]


def _cameras_bin(path: Path, shots: Sequence[Shot], cloud: Cloud, sight: _Sight) -> None:
    data = struct.pack("<Q", len(shots))
    for i, shot in enumerate(shots):
        _, model, params = _params(shot)
        data += struct.pack("<iiQQ", i + 1, model, shot.camera.width, shot.camera.height)
        data += struct.pack(f"<{len(params)}d", *params)
    path.write_bytes(data)


def _cameras_txt(path: Path, shots: Sequence[Shot], cloud: Cloud, sight: _Sight) -> None:
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for i, shot in enumerate(shots):
        model, _, params = _params(shot)
        numbers = " ".join(map(repr, params))
        lines.append(f"{i + 1} {model} {shot.camera.width} {shot.camera.height} {numbers}")
    _write_lines(path, lines)


def _images_bin(path: Path, shots: Sequence[Shot], cloud: Cloud, sight: _Sight) -> None:
    data = bytearray(struct.pack("<Q", len(shots)))
    for i, (shot, seen) in enumerate(zip(shots, sight.by_view, strict=True)):
        data += struct.pack("<i7di", i + 1, *_pose(shot.camera), i + 1)
        data += _colmap_name(i).encode() + b"\0" + struct.pack("<Q", len(seen))
        for u, v, point in seen:
            data += struct.pack("<ddq", u, v, point + 1)
    path.write_bytes(data)


def _images_txt(path: Path, shots: Sequence[Shot], cloud: Cloud, sight: _Sight) -> None:
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# X, Y, POINT3D_ID"]
    for i, (shot, seen) in enumerate(zip(shots, sight.by_view, strict=True)):
        numbers = " ".join(map(repr, _pose(shot.camera)))
        lines.append(f"{i + 1} {numbers} {i + 1} {_colmap_name(i)}")
        lines.append(" ".join(f"{u!r} {v!r} {point + 1}" for u, v, point in seen))
    _write_lines(path, lines)


def _points_bin(path: Path, shots: Sequence[Shot], cloud: Cloud, sight: _Sight) -> None:
    data = bytearray(struct.pack("<Q", len(cloud.points)))
    rows = zip(cloud.points.tolist(), cloud.colours.tolist(), sight.by_point, strict=True)
    for i, (place, shade, track) in enumerate(rows):
        data += struct.pack("<Q3d3BdQ", i + 1, *place, *shade, 0.5, len(track))
        for view, index in track:
            data += struct.pack("<ii", view + 1, index)
    path.write_bytes(data)


def _points_txt(path: Path, shots: Sequence[Shot], cloud: Cloud, sight: _Sight) -> None:
    lines = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    rows = zip(cloud.points.tolist(), cloud.colours.tolist(), sight.by_point, strict=True)
    for i, (place, shade, track) in enumerate(rows):
        numbers = " ".join(map(repr, [*place, *shade, 0.5]))
        seen = " ".join(f"{view + 1} {index}" for view, index in track)
        lines.append(f"{i + 1} {numbers} {seen}")
    _write_lines(path, lines)


def _colmap_name(index: int) -> str:
    """COLMAP's names begin below `images/`."""
    return _image_name(index).removeprefix("images/")


def _write_lines(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
