"""Splats of files that commands look at: of a scene, or of a stream, whole or in part."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evogs_codec.cli.looking import without_refuted_up
from evogs_codec.cli.streams import describe_part, part_there, read_stream
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.extract import extract
from evogs_codec.errors import Fault, InputError, StreamError
from evogs_codec.format.directory import Directory
from evogs_codec.io.interchange.gltf_stream import read_gltf_stream
from evogs_codec.io.interchange.scene_files import read_scene, scene_format, size_of_scene
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

__all__ = ["Loaded", "load_part", "load_whole"]


@dataclass(frozen=True, eq=False)
class Loaded:
    """What was read of a file.

    Attributes:
        splats: N splats.
        info: what the file says of them.
        n_bytes: of the file, or of a stream that has what was taken.
        part: what of the file is there, for people; empty for all.
        format: a word for people, as ".ply" or "level 2".
    """

    splats: SplatParams
    info: SceneInfo
    n_bytes: int
    part: str = ""
    format: str = ""


def load_part(
    path: Path,
    limits: dict[str, int] | None,
    choose: Callable[[Directory], Cut],
    *,
    partial: bool,
) -> Loaded:
    """A scene, or a cut of a stream.

    Args:
        path: of the file.
        limits: of the decoder.
        choose: the cut of a stream.
        partial: take what is there of it.

    Raises:
        InputError, StreamError: the file cannot be used.
    """
    if _is_scene(path):
        return _scene(path)
    data, directory = read_stream(path, limits)
    cut, part = choose(directory), ""
    if partial:
        cut = part_there(directory, len(data), cut, path)
        part = f", from {describe_part(directory, len(data))}"
    splats = decode(data, cut, directory=directory).leaves()
    n_bytes = len(extract(data, cut, directory=directory)) if len(data) else 0
    return Loaded(splats, directory.info, n_bytes, part, "evogs")


def load_whole(path: Path, limits: dict[str, int] | None) -> Loaded:
    """A scene, or a whole stream, with which others are compared.

    Raises:
        InputError: the file cannot be used; the message names it, and not the input.
    """
    if _is_scene(path):
        return _scene(path)
    try:
        data, directory = read_stream(path, limits)
        splats = decode(data, directory=directory).leaves()
    except StreamError as error:
        cut_short = "; the reference must be whole" if error.fault is Fault.E_TRUNCATED else ""
        raise InputError(f"{path}: {error}{cut_short}") from error
    return Loaded(splats, directory.info, directory.size, "", "evogs")


def _is_scene(path: Path) -> bool:
    """Whether a file is read as a scene: a stream in a glTF file is read as a stream."""
    kind = scene_format(path)
    return kind is not None and not (kind == "gltf" and read_gltf_stream(path) is not None)


def _scene(path: Path) -> Loaded:
    scene = read_scene(path)
    n_bad = len(scene.splats) - int(np.count_nonzero(scene.splats.finite()))
    if n_bad:
        text = f"{path}: {n_bad:,} splats with NaN or infinite numbers are not drawn"
        warnings.warn(text, stacklevel=1)
    info = without_refuted_up(scene)
    return Loaded(scene.splats, info, size_of_scene(path), "", scene_format(path) or "ply")
