"""The images that a renderer is asked for, and the goldens, read strictly from `renders.json`.

A missing file, a wrong hash or an unknown key is a `SuiteError`: a suite that is not what its
manifest says must never end in a pass.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from conformance.harness.manifest import SuiteError

__all__ = ["FOLDER", "Image", "Scene", "Suite", "Thresholds", "load"]

FOLDER = Path(__file__).resolve().parent
T = TypeVar("T")


@dataclass(frozen=True)
class Scene:
    """A stream, by the names of the manifest."""

    id: str
    tests: str
    faulty: str
    file: str
    sha256: str
    size: int
    n_levels: int
    sh_degree: int
    antialiased: bool
    provenance: str


@dataclass(frozen=True)
class Thresholds:
    """What an image must keep to.

    Attributes:
        max_error: of a channel of a stable pixel, beyond the rounding of both files; white is 1.
        max_over: stable pixels that may be over it.
        min_psnr: of the stable pixels, dB.
        level_psnr: how far the PSNR against the finest level may be from that of the golden, dB.
    """

    max_error: float
    max_over: int
    min_psnr: float
    level_psnr: float


@dataclass(frozen=True)
class Image:
    """One picture to render.

    Attributes:
        id: scene.view.L<level>.
        scene: id of the stream.
        view: name of the camera.
        level: of the stream.
        camera: as in a file of cameras (`evogs_codec.render.save_cameras`).
        background: R G B in 0..1.
        golden, sha256: file and its hash.
        n_splats: splats of the level.
        n_doubtful: pixels that two right renderers may disagree on (golden alpha is 0).
        measured: largest deviation of the fast renderer from the oracle at stable pixels.
        level_psnr: PSNR of the golden against that of the finest level, dB; None: it is that.
        thresholds: what decides.
    """

    id: str
    scene: str
    view: str
    level: int
    camera: Mapping[str, Any]
    background: tuple[float, float, float]
    golden: str
    sha256: str
    n_splats: int
    n_doubtful: int
    measured: float
    level_psnr: float | None
    thresholds: Thresholds


@dataclass(frozen=True)
class Suite:
    """A folder of streams and goldens; `sha256` is that of its manifest."""

    folder: Path
    sha256: str
    scenes: Mapping[str, Scene]
    images: tuple[Image, ...]

    def stream(self, image: Image) -> bytes:
        """The stream of an image.

        Raises:
            SuiteError: the file is missing or another one.
        """
        scene = self.scenes[image.scene]
        return _read(self.folder / scene.file, scene.sha256)

    def golden(self, image: Image) -> bytes:
        """The golden PNG of an image.

        Raises:
            SuiteError: the file is missing or another one.
        """
        return _read(self.folder / image.golden, image.sha256)

    def finest(self, image: Image) -> Image:
        """The image of the same view at the finest level."""
        same = [o for o in self.images if (o.scene, o.view) == (image.scene, image.view)]
        return max(same, key=lambda other: other.level)


def load(folder: Path = FOLDER) -> Suite:
    """Read `renders.json` of a folder; all files are checked.

    Raises:
        SuiteError: the manifest or a file is missing or not what it should be.
    """
    if not (folder / "renders.json").exists():
        raise SuiteError(
            f"no renders.json in {folder}: the goldens are in a checkout of the repository, not in"
            " an installed package; name them with --suite CHECKOUT/conformance/renders"
        )
    try:
        text = (folder / "renders.json").read_bytes()
        manifest = json.loads(text)
        scenes = [_build(Scene, entry) for entry in manifest["scenes"]]
        images = tuple(_image(entry) for entry in manifest["images"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SuiteError(f"renders.json: {error!r}") from None
    suite = Suite(
        folder, hashlib.sha256(text).hexdigest(), {scene.id: scene for scene in scenes}, images
    )
    if not images or len({image.id for image in images}) < len(images):
        raise SuiteError("renders.json: no images, or two with one id")
    for image in images:
        if image.scene not in suite.scenes:
            raise SuiteError(f"renders.json: {image.id} has no scene")
        suite.stream(image)
        suite.golden(image)
    return suite


def _image(entry: Mapping[str, Any]) -> Image:
    background = tuple(float(value) for value in entry["background"])
    thresholds = _build(Thresholds, entry["thresholds"])
    return _build(Image, {**entry, "background": background, "thresholds": thresholds})


def _build(kind: type[T], values: Mapping[str, Any]) -> T:
    """A dataclass from exactly its fields."""
    names = {item.name for item in fields(kind)}  # type: ignore[arg-type]
    if names != set(values):
        raise SuiteError(f"renders.json: keys unknown or missing: {sorted(names ^ set(values))}")
    return kind(**values)


def _read(path: Path, sha256: str) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SuiteError(str(error)) from None
    if hashlib.sha256(data).hexdigest() != sha256:
        raise SuiteError(f"{path.name} is not the file of the manifest")
    return data
