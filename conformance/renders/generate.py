"""Make streams, goldens and `renders.json` anew from the recipes; or check that they are the same.

A golden is the picture of the float64 oracle, in 8 bits: what a screen shows, an eighth of the
size of exact numbers, and finer than the tolerance. Its alpha is 0 at doubtful pixels.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from conformance.renders.manifest import FOLDER, Image, Thresholds
from conformance.renders.manifest import Scene as SceneEntry
from conformance.renders.png import decode_png, encode_png
from conformance.renders.reference import to_pixels
from conformance.renders.scenes import SCENES, Scene
from evogs_codec import Cut, decode, read_directory
from evogs_codec.render import Camera, Options, psnr, render
from evogs_codec.render.oracle import render_exactly

__all__ = ["check", "make_all", "write"]

Entry = dict[str, Any]
F64 = npt.NDArray[np.float64]
MAX_ERROR = 1 / 255  # what one decision at the threshold of alpha may change
MARGIN = 10  # thresholds are at least so many times what two right renderers differ by
MAX_OVER = 3  # pixels: decisions that rounding in float32 may turn, beyond the doubt of the oracle
MIN_PSNR = 50.0  # rounding down instead of to the nearest gives 51 dB, a step everywhere 48 dB
LEVEL_PSNR = 0.5
PER_MACHINE = ("sha256", "size", "measured", "n_doubtful", "level_psnr", "camera")
MAX_DOUBTFUL = 0.12  # of the pixels of an image


def write(folder: Path = FOLDER) -> list[str]:
    """Write what differs and remove what is no longer made; returns the names."""
    made, there = make_all(), _files(folder)
    for name in there.keys() - made.keys():
        (folder / name).unlink()
    changed = [name for name, data in made.items() if there.get(name) != data]
    for name in changed:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(made[name])
    return sorted({*changed, *(there.keys() - made.keys())})


def check(folder: Path = FOLDER, scenes: tuple[Scene, ...] = SCENES) -> list[str]:
    """Names of the files of these scenes that are not as they would be made.

    Another libzstd may pack streams otherwise, another machine round a golden by a step: what
    they hold is compared where bytes differ.
    """
    made = make_all(scenes)
    return sorted(name for name in made if not _is_same(folder / name, made[name], scenes))


def make_all(scenes: tuple[Scene, ...] = SCENES) -> dict[str, bytes]:
    """Every file of the folder by its name."""
    files: dict[str, bytes] = {}
    entries: dict[str, list[Entry]] = {"scenes": [], "images": []}
    for scene in scenes:
        data = scene.stream()
        name = f"streams/{scene.id}.evogs"
        files[name] = data
        directory = read_directory(data)
        entries["scenes"].append(
            asdict(
                SceneEntry(
                    scene.id, scene.tests, scene.faulty, name, _sha256(data), len(data),
                    directory.n_levels, directory.sh_degree, scene.antialiased,
                    f"conformance.renders.recipes:{_name(scene)}",
                )
            )
        )  # fmt: skip
        for image, golden in _images(scene, data):
            files[image.golden] = golden
            entries["images"].append(asdict(image))
    files["renders.json"] = (json.dumps(entries, indent=1) + "\n").encode()
    return files


def _images(scene: Scene, data: bytes) -> Iterator[tuple[Image, bytes]]:
    """The entries of a scene with their golden files, the finest level first."""
    directory = read_directory(data)
    options = Options(antialiased=scene.antialiased)
    for view in scene.views:
        finest = None
        for level in reversed(range(directory.n_levels)):
            splats = decode(data, Cut.of_level(directory, level)).leaves()
            exact = render_exactly(splats, view.camera, view.background, options=options)
            fast = render(splats, view.camera, view.background, options=options)
            pixels, stable = to_pixels(exact.image), ~exact.doubtful
            name = f"{scene.id}.{view.name}.L{level}"
            _check_ties(name, splats.means.astype(np.float64), view.camera)
            if not stable.mean() > 1 - MAX_DOUBTFUL:
                raise ValueError(f"{name}: {exact.doubtful.mean():.1%} of the pixels are doubtful")
            deviation = np.abs(np.clip(fast, 0, 1) - np.clip(exact.image, 0, 1)).max(2)
            measured = float(deviation[stable].max())
            golden = encode_png(np.dstack([pixels, np.where(stable, 255, 0).astype(np.uint8)]))
            steps = pixels.astype(np.float64) / 255
            yield (
                Image(
                    name, scene.id, view.name, level, _camera(view.camera), view.background,
                    f"goldens/{name}.png", _sha256(golden), len(splats),
                    int(exact.doubtful.sum()), float(f"{measured:.1e}"),
                    None if finest is None else round(psnr(steps, finest), 3),
                    Thresholds(max(MAX_ERROR, MARGIN * measured), MAX_OVER, MIN_PSNR, LEVEL_PSNR),
                ),
                golden,
            )  # fmt: skip
            finest = steps if finest is None else finest


def _check_ties(name: str, means: F64, camera: Camera) -> None:
    """Raise if splats at two places (N, 3) have one depth, but not in every arithmetic."""
    axis = camera.rotation[2]
    if np.count_nonzero(axis) == 1:
        return
    depths = np.unique(means, axis=0) @ axis
    if len(np.unique(depths)) < len(depths):
        raise ValueError(f"{name}: two places have the same depth by chance")


def _is_same(path: Path, made: bytes, scenes: tuple[Scene, ...]) -> bool:
    there = path.read_bytes() if path.exists() else b""
    if there == made or not there:
        return bool(there)
    if path.suffix == ".evogs":
        return _leaves(there) == _leaves(made)
    if path.suffix == ".png":
        width, height = struct.unpack(">II", made[16:24])
        a, b = (decode_png(d, width=width, height=height).astype(int) for d in (there, made))
        judged = (a[..., 3] > 0) & (b[..., 3] > 0)
        return bool(np.abs(a - b)[judged].max(initial=0) <= 1)
    ids = {scene.id for scene in scenes}
    return _entries(there, ids) == _entries(made, ids)


def _leaves(data: bytes) -> list[bytes]:
    """The splats of every level."""
    directory = read_directory(data)
    cuts = [Cut.of_level(directory, level) for level in range(directory.n_levels)]
    return [decode(data, cut).leaves().channels().tobytes() for cut in cuts]


def _entries(manifest: bytes, ids: set[str]) -> list[Entry]:
    """What a manifest says of these scenes, without what may differ between machines."""
    read = json.loads(manifest)
    scenes = [entry for entry in read["scenes"] if entry["id"] in ids]
    images = [entry for entry in read["images"] if entry["scene"] in ids]
    return [{k: v for k, v in e.items() if k not in PER_MACHINE} for e in scenes + images]


def _camera(camera: Camera) -> Entry:
    """As in a file of cameras."""
    return {
        **{name: int(getattr(camera, name)) for name in ("width", "height")},
        **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
        "rotation": camera.rotation.tolist(),
        "translation": camera.translation.tolist(),
    }


def _name(scene: Scene) -> str:
    """What the recipe of a scene is called, with its arguments."""
    if isinstance(scene.recipe, partial):
        return f"{scene.recipe.func.__name__}{scene.recipe.args}"
    return scene.recipe.__name__


def _files(folder: Path) -> dict[str, bytes]:
    """The generated files that are there."""
    paths = [*folder.glob("streams/*"), *folder.glob("goldens/*"), *folder.glob("renders.json")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
