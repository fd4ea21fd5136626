"""Scenes read from and written to files of any format that is known.

The bytes of a file say what it is; only a `.splat` needs its name too. What is written is said by
the ending of the name.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from evogs_codec.errors import InputError
from evogs_codec.io import makers
from evogs_codec.io.files import SCENE, STREAM, FileKind, write_atomic
from evogs_codec.io.finite import finite_opacities
from evogs_codec.io.foreign import WITHOUT_MAGIC
from evogs_codec.io.interchange import (
    compressed_ply,
    gltf,
    gltf_file,
    ksplat,
    ply_comments,
    sog,
    splat,
    spz,
)
from evogs_codec.io.interchange.frames import frame_of, transformed, turn
from evogs_codec.io.makers import comment_of
from evogs_codec.io.ply import read_ply, write_ply
from evogs_codec.io.ply_header import read_ply_header
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

__all__ = [
    "TARGETS",
    "Scene",
    "is_named_as_scene",
    "kind_of_stream",
    "kind_to_write",
    "read_scene",
    "scene_format",
    "size_of_scene",
    "write_scene",
]

START = 1 << 17  # bytes by which a file is judged


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that was read.

    Attributes:
        splats: N splats, in the axes of a `.ply`.
        info: what the file says of them.
        up_is_assumed: no program said what is up, only the axes of the format do. Converters turn
            a scene to those axes whatever is up in it.
    """

    splats: SplatParams
    info: SceneInfo = field(default_factory=SceneInfo)
    up_is_assumed: bool = False


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene of a `.ply`, plain or compressed, `.spz`, `.sog`, `.splat`, `.ksplat` or glTF.

    A `.sog` may be unpacked: then the folder is given, or its `meta.json`. Splats are turned to the
    axes that a `.ply` has, right, down, forward, where the format has others. Infinite opacities
    are made finite as by `finite_opacities`; of a `.ply`, where they are infinite numbers, a
    warning says how many. Other numbers that are not finite are returned as they are.

    Raises:
        InputError: the file cannot be read, or is none of these.
    """
    at = Path(path)
    try:
        name = scene_format(at)
    except OSError as error:
        raise InputError(f"{at}: cannot be read: {error.strerror or error}") from error
    if name is None and (at / "tileset.json").is_file():
        raise InputError(f"{at}: is a tileset: `evogs decode {at} OUT.ply` makes a scene of it")
    if name is None and at.suffix.lower() in WITHOUT_MAGIC and _has_numbers(at):
        raise InputError(f"{at}: is named {at.suffix}, but its numbers are not those of one")
    if name in (None, "ply"):  # others are refused by `read_ply`, which says what they seem to be
        splats = read_ply(at)
        return Scene(splats, ply_comments.info_of(read_ply_header(at).comments))
    splats, info = READERS[name](at)
    # Of bytes and of opacities from 0 to 1 many are 1: that is nothing to warn of.
    return Scene(finite_opacities(splats)[0], info, up_is_assumed=name == "spz")


def size_of_scene(path: Path) -> int:
    """Bytes of the files that hold a scene: of a glTF file its buffers too, of a `.sog` all of it.

    Raises:
        InputError: a file is damaged, or not there.
        OSError: the file cannot be read.
    """
    name = scene_format(path)
    if name == "gltf":
        return gltf_file.open_gltf_start(path).size()
    return sog.size(path) if name == "sog" else path.stat().st_size


def write_scene(
    path: str | os.PathLike[str],
    splats: SplatParams,
    info: SceneInfo | None = None,
    *,
    made_by: str = "evogs",
) -> int:
    """Write a `.ply`, `.compressed.ply`, `.spz` (version 4), `.splat` or `.glb`, by the ending.

    A name without an ending, or of a device or pipe, gets a `.ply`.

    A warning says what of the splats the format cannot hold. docs/interchange.md has the rounding
    of each format.

    Args:
        path: the file to make or replace.
        splats: N splats.
        info: what is known of them; splats are turned from its `coordinate_system`, or from that of
            a `.ply`, where a format has axes of its own.
        made_by: the program, which is named in the file if it has a place for it.

    Returns:
        The SH degree that the file has, which is that of the splats if the format holds it.

    Raises:
        InputError: the ending is of no format that is written, or the splats do not fit in it.
        OSError: the file cannot be written.
    """
    at, info = Path(path), info or SceneInfo()
    target = _target(at)
    if target.write is None:
        write_ply(at, splats, [comment_of(made_by), *ply_comments.comments_of(info)])
        return splats.sh_degree
    n_bad = len(splats) - int(splats.finite().sum())
    if n_bad:
        raise InputError(
            f"{at}: {n_bad:,} splats have a NaN or an infinite number, which only a .ply holds"
        )
    if target.frame is not None:
        splats = transformed(splats, turn(frame_of(info), target.frame))
    try:
        data = target.write(splats, info, made_by)
    except InputError as error:
        raise InputError(f"{at}: {error}") from error
    write_atomic(at, data)
    return min(splats.sh_degree, target.max_degree)


# --- formats --------------------------------------------------------------------------------------


READERS: dict[str | None, Callable[[Path], tuple[SplatParams, SceneInfo]]] = {
    "compressed.ply": compressed_ply.read,
    "spz": spz.read,
    "sog": sog.read,
    "gltf": gltf.read,
    "ksplat": ksplat.read,
    "splat": splat.read,
}


def scene_format(path: Path) -> str | None:
    """What a file is: `ply`, or a name of `READERS`; None if it is no scene that is known.

    Raises:
        OSError: the file cannot be read.
    """
    if path.is_dir():
        return "sog" if sog.is_sog(path, b"") else None
    with path.open("rb") as file:
        start = file.read(START)
    if start.startswith((b"ply\n", b"ply\r")):
        return _which_ply(path)
    tests: tuple[tuple[str, bool], ...] = (
        ("spz", spz.is_spz(start)),
        ("sog", sog.is_sog(path, start)),
        ("gltf", gltf.is_gltf(path, start)),
        ("ksplat", ksplat.is_ksplat(path, start)),
        ("splat", splat.is_splat(path, start)),
    )
    return next((name for name, found in tests if found), None)


def _which_ply(path: Path) -> str:
    try:
        compressed = compressed_ply.is_compressed(read_ply_header(path))
    except InputError:  # `read_ply` says it
        compressed = False
    return "compressed.ply" if compressed else "ply"


def _has_numbers(path: Path) -> bool:
    with path.open("rb") as file:
        return any(file.read(START))


Write: TypeAlias = Callable[[SplatParams, SceneInfo, str], bytes]


@dataclass(frozen=True)
class _Target:
    """A format that is written.

    Attributes:
        kind: of file, for what is replaced.
        write: makes its bytes; None for a `.ply`, which is written piece by piece.
        frame: of its axes; None where they are those of the scene.
        max_degree: of SH.
    """

    kind: FileKind
    write: Write | None = None
    frame: str | None = None
    max_degree: int = 3


def _by_nobody(_path: Path, _command: str) -> bool:
    return False  # the format has no place to name a maker


TARGETS = {
    ".compressed.ply": _Target(SCENE, compressed_ply.write),
    ".ply": _Target(SCENE),
    ".spz": _Target(
        FileKind(".spz", (spz.MAGIC, spz.GZIP), made_by=_by_nobody), spz.write, spz.FRAME
    ),
    ".splat": _Target(FileKind(".splat", (b"",), made_by=_by_nobody), splat.write, max_degree=0),
    ".glb": _Target(
        FileKind(".glb", (gltf.MAGIC,), made_by=makers.marked_gltf), gltf.write, gltf.FRAME
    ),
}


def kind_to_write(path: Path) -> FileKind:
    """The kind of file that `write_scene` makes of this name.

    Raises:
        InputError: the ending is of no format that is written.
    """
    return _target(path).kind


def is_named_as_scene(path: Path) -> bool:
    """Whether the ending is that of a scene, not of a stream."""
    return path.name.lower().endswith((*TARGETS, ".gltf", ".ksplat", ".sog"))


def kind_of_stream(path: Path) -> FileKind:
    """The kind of file that a command makes that writes streams, whatever the ending.

    Raises:
        InputError: the ending is that of a scene, which a stream would be taken for.
    """
    if is_named_as_scene(path) and not (path.exists() and not path.is_file()):
        raise InputError(
            f"{path}: a stream is written, and this is the name of a scene: name an .evogs;"
            " `evogs convert` and `evogs decode` write scenes"
        )
    return STREAM


def _target(path: Path) -> _Target:
    is_device = path.exists() and not path.is_file() and not path.is_dir()
    if is_device or not path.suffix:  # the name says nothing
        return TARGETS[".ply"]
    name = path.name.lower()
    for ending, target in TARGETS.items():
        if name.endswith(ending):
            return target
    hint = "; `evogs encode` makes a stream" if name.endswith(".evogs") else ""
    raise InputError(f"{path}: scenes are written as {', '.join(TARGETS)}; name one of these{hint}")
