"""Folders of photographs become data sets: which format, what is held out, and the pixels."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import MAX_PATH, is_there
from evogs_codec.render.camera import Camera
from evogs_codec.render.colmap import find_model
from reference_trainer.data.budget import Budget
from reference_trainer.data.cache import undistorted
from reference_trainer.data.colmap import read_colmap
from reference_trainer.data.photograph import Photograph, read_image
from reference_trainer.data.points import read_points
from reference_trainer.data.pyramid import area_average
from reference_trainer.data.transforms import read_transforms
from reference_trainer.data.view import BACKGROUNDS, F32, Colour, Dataset, View

__all__ = ["load_views"]

MAX_THREADS = 8
IN_FLIGHT = 1 << 25  # pixels of photographs that all threads decode at a time; one may have more
MIN_LEFT = 2  # photographs of a folder where some are missing: one alone has no depth


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
        InputError: the folder or something in it cannot be used; the message is one line. A
            photograph that is missing is only warned of, while two or more are left.
        ValueError: an argument is impossible.
    """
    if test_every < 0 or test_every == 1:
        raise ValueError(f"test_every is {test_every}, expected 0, or 2 or more")
    if size is not None and size < 1:
        raise ValueError(f"size is {size}, expected 1 or more")
    colour = _colour(background)
    folder = Path(path)
    found = _find(folder, test_every)
    _warn_of_missing(folder, found)
    load = partial(
        _load,
        background=colour,
        size=size,
        cache=None if cache is None else Path(cache),
        budget=Budget(IN_FLIGHT),
    )
    with ThreadPoolExecutor(min(MAX_THREADS, os.cpu_count() or 1)) as pool:
        train = tuple(pool.map(load, found.train))
        test = tuple(pool.map(load, found.test))
    return Dataset(folder.resolve().name, train, test, found.points, found.colours, colour)


@dataclass(frozen=True, eq=False)
class _Found:
    """Photographs of a folder before their pixels are read; points and colours if it has some."""

    train: list[Photograph]
    test: list[Photograph]
    missing: list[Path]
    points: F32 | None = None
    colours: F32 | None = None


def _find(folder: Path, test_every: int) -> _Found:
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; photographs are in one (docs/datasets.md)")
    if is_there(folder / "transforms_train.json"):
        return _find_blender(folder, test_every)
    if is_there(folder / "transforms.json"):
        return _find_nerfstudio(folder / "transforms.json", test_every)
    if (model := find_model(folder)) is not None:
        return _find_colmap(folder, model, test_every)
    raise InputError(
        f"{folder}: no photographs with cameras: expected transforms_train.json, transforms.json "
        "or a COLMAP model (sparse/0/cameras.bin or .txt, with images/)"
    )


def _find_blender(folder: Path, test_every: int) -> _Found:
    path = folder / "transforms_train.json"
    found = read_transforms(path)
    train, missing = found.photographs, list(found.missing.values())
    _check_names(path, train)
    for split in ("test", "val"):
        path = folder / f"transforms_{split}.json"
        if is_there(path):
            held_out = read_transforms(path)
            missing += held_out.missing.values()
            if held_out.photographs:
                _check_names(path, [*train, *held_out.photographs])
                return _Found(train, held_out.photographs, missing)
    return _Found(*_held_out(train, test_every), missing)


def _find_nerfstudio(path: Path, test_every: int) -> _Found:
    found = read_transforms(path)
    _check_names(path, found.photographs)
    names = {photograph.name for photograph in found.photographs}
    unknown = found.test - names - set(found.missing)
    if unknown:
        raise InputError(f"{path}: {shown(min(unknown))} is held out but is no frame")
    train, test = _held_out(found.photographs, test_every)
    if found.test & names:
        train = [p for p in found.photographs if p.name not in found.test]
        test = [p for p in found.photographs if p.name in found.test]
    if not train and not found.missing:
        raise InputError(f"{path}: every view is held out, none is left to train on")
    missing = list(found.missing.values())
    if found.points is None:
        return _Found(train, test, missing)
    return _Found(train, test, missing, *read_points(found.points))


def _find_colmap(folder: Path, model: Path, test_every: int) -> _Found:
    found = read_colmap(folder, model)
    _check_names(model, found.photographs)
    train, test = _held_out(found.photographs, test_every)
    if not len(found.points):
        return _Found(train, test, found.missing)
    return _Found(train, test, found.missing, found.points, found.colours)


def _warn_of_missing(folder: Path, found: _Found) -> None:
    """Say how many photographs are missing; refuse where too few are left to train on."""
    if not found.missing:
        return
    n_missing, n_left = len(found.missing), len(found.train) + len(found.test)
    first = shown(found.missing[0], MAX_PATH)
    said = f"{n_missing} of {n_missing + n_left} photographs are missing, {first} is the first"
    if n_left < MIN_LEFT or not found.train:
        raise InputError(f"{folder}: {said}; at least {MIN_LEFT} must be there")
    warnings.warn(f"{folder}: {said}; the other {n_left} are taken", stacklevel=3)


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
            raise InputError(f"{path}: {shown(photograph.name)} is there twice")
        seen.add(photograph.name)


def _load(
    photograph: Photograph,
    *,
    background: Colour,
    size: int | None,
    cache: Path | None,
    budget: Budget,
) -> View:
    """Pixels of a photograph: laid on the background, then undistorted, then averaged."""
    camera = photograph.camera
    with budget.holding(camera.width * camera.height):
        if any(photograph.distortion):
            image, camera = undistorted(photograph, background, cache)
            sides = _sides(camera, size)
            if sides is not None:
                image = area_average(image, *sides)
        else:
            sides = _sides(camera, size)
            image = read_image(photograph, background, sides)
    return View(photograph.name, camera if sides is None else camera.resized(*sides), image)


def _sides(camera: Camera, size: int | None) -> tuple[int, int] | None:
    """Width and height of a picture with a longer side than `size`."""
    longest = max(camera.width, camera.height)
    if size is None or size >= longest:
        return None
    width, height = (max(1, round(n * size / longest)) for n in (camera.width, camera.height))
    return width, height


def _colour(background: str | Sequence[float]) -> Colour:
    if isinstance(background, str):
        if background not in BACKGROUNDS:
            raise ValueError(f"background {background!r} is not one of {', '.join(BACKGROUNDS)}")
        return BACKGROUNDS[background]
    r, g, b = (float(value) for value in background)
    if not all(0 <= value <= 1 for value in (r, g, b)):
        raise ValueError(f"background {r}, {g}, {b} is not in 0..1")
    return r, g, b
