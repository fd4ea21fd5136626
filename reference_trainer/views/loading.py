"""Folders of photographs become data sets: which format, what is held out, and the pixels."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from evogs_codec.errors import InputError
from reference_trainer.views.cache import undistorted
from reference_trainer.views.colmap import find_model, read_colmap
from reference_trainer.views.photograph import Photograph, read_image
from reference_trainer.views.points import read_points
from reference_trainer.views.pyramid import area_average
from reference_trainer.views.transforms import read_transforms
from reference_trainer.views.view import BACKGROUNDS, F32, Color, Dataset, View

__all__ = ["load_views"]

MAX_THREADS = 8  # each holds a photograph at full size, or three where it undistorts


def load_views(
    path: str | os.PathLike[str],
    *,
    background: str | Sequence[float] = "white",
    test_every: int = 8,
    size: int | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> Dataset:
    """Photographs of a folder (docs/datasets.md), undistorted, on a background.

    Args:
        path: a folder with `transforms_train.json`, `transforms.json` or a COLMAP model.
        background: "white", "black", or R G B in 0..1; for transparent photographs.
        test_every: view 0 of every so many is held out where the folder names no test views; 0
            holds out none.
        size: longest side in pixels of larger photographs, averaged by area.
        cache: where undistorted photographs are kept; by default the user's cache folder.

    Raises:
        InputError: the folder or something in it cannot be used; the message is one line.
        ValueError: an argument is impossible.
    """
    if test_every < 0 or test_every == 1:
        raise ValueError(f"test_every is {test_every}, expected 0, or 2 or more")
    if size is not None and size < 1:
        raise ValueError(f"size is {size}, expected 1 or more")
    color = _color(background)
    folder = Path(path)
    found = _find(folder, test_every)
    load = partial(_load, background=color, size=size, cache=None if cache is None else Path(cache))
    with ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1)) as pool:
        train = tuple(pool.map(load, found.train))
        test = tuple(pool.map(load, found.test))
    return Dataset(folder.resolve().name, train, test, found.points, found.colours, color)


@dataclass(frozen=True, eq=False)
class _Found:
    """Photographs of a folder before their pixels are read; points and colours if it has some."""

    train: list[Photograph]
    test: list[Photograph]
    points: F32 | None = None
    colours: F32 | None = None


def _find(folder: Path, test_every: int) -> _Found:
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; photographs are in one (docs/datasets.md)")
    if (folder / "transforms_train.json").is_file():
        return _find_blender(folder, test_every)
    if (folder / "transforms.json").is_file():
        return _find_nerfstudio(folder / "transforms.json", test_every)
    if (model := find_model(folder)) is not None:
        photographs, points, colours = read_colmap(folder, model)
        train, test = _held_out(photographs, test_every)
        return _Found(train, test, points, colours) if len(points) else _Found(train, test)
    raise InputError(
        f"{folder}: no photographs with cameras: expected transforms_train.json, transforms.json "
        "or a COLMAP model (sparse/0/cameras.bin or .txt, with images/)"
    )


def _find_blender(folder: Path, test_every: int) -> _Found:
    train = read_transforms(folder / "transforms_train.json").photographs
    for split in ("test", "val"):
        path = folder / f"transforms_{split}.json"
        if path.is_file():
            test = read_transforms(path).photographs
            _check_names(path, [*train, *test])
            return _Found(train, test)
    _check_names(folder / "transforms_train.json", train)
    return _Found(*_held_out(train, test_every))


def _find_nerfstudio(path: Path, test_every: int) -> _Found:
    found = read_transforms(path)
    _check_names(path, found.photographs)
    train, test = _held_out(found.photographs, test_every)
    if found.test:
        missing = found.test - {photograph.name for photograph in found.photographs}
        if missing:
            raise InputError(f"{path}: {min(missing)} is held out but is no frame")
        train = [p for p in found.photographs if p.name not in found.test]
        test = [p for p in found.photographs if p.name in found.test]
    if not train:
        raise InputError(f"{path}: every view is held out, none is left to train on")
    if found.points is None:
        return _Found(train, test)
    return _Found(train, test, *read_points(found.points))


def _held_out(
    photographs: list[Photograph], test_every: int
) -> tuple[list[Photograph], list[Photograph]]:
    """Train and test views: as the benchmarks do, the first of every `test_every` is for tests."""
    if test_every == 0 or len(photographs) == 1:
        return photographs, []
    train = [p for i, p in enumerate(photographs) if i % test_every]
    return train, photographs[::test_every]


def _check_names(path: Path, photographs: list[Photograph]) -> None:
    """A view that is there twice would be trained on and then measured."""
    seen: set[str] = set()
    for photograph in photographs:
        if photograph.name in seen:
            raise InputError(f"{path}: {photograph.name} is there twice")
        seen.add(photograph.name)


def _load(
    photograph: Photograph, *, background: Color, size: int | None, cache: Path | None
) -> View:
    """Pixels of a photograph: laid on the background, then undistorted, then averaged."""
    if any(photograph.distortion):
        image, camera = undistorted(photograph, background, cache)
    else:
        image, camera = read_image(photograph.path, background), photograph.camera
    longest = max(camera.width, camera.height)
    if size is not None and size < longest:
        width, height = (max(1, round(n * size / longest)) for n in (camera.width, camera.height))
        image, camera = area_average(image, width, height), camera.resized(width, height)
    return View(photograph.name, camera, image)


def _color(background: str | Sequence[float]) -> Color:
    if isinstance(background, str):
        if background not in BACKGROUNDS:
            raise ValueError(f"background {background!r} is not one of {', '.join(BACKGROUNDS)}")
        return BACKGROUNDS[background]
    r, g, b = (float(value) for value in background)
    if not all(0 <= value <= 1 for value in (r, g, b)):
        raise ValueError(f"background {r}, {g}, {b} is not in 0..1")
    return r, g, b
