"""What the commands of the viewer are given: a file of any kind, a folder, or an address."""

from __future__ import annotations

import re
import urllib.request
from pathlib import Path
from urllib.parse import unquote, urlsplit

from evogs_codec.cli.encode_and_lift import encode_file
from evogs_codec.cli.many_files import stem_of
from evogs_codec.cli.terminal import progress_bar
from evogs_codec.cli.viewer.scenes import Folder
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.files import KIND_BYTES, STREAM, kind_of
from evogs_codec.io.interchange.gltf_stream import read_gltf_stream
from evogs_codec.io.interchange.scene_files import scene_format

__all__ = ["folder_of_streams", "is_of_web", "is_stream", "newly_encoded", "stream_of"]

_WEB = re.compile(r"https?://", re.IGNORECASE)
_TIMEOUT = 60  # s without a byte


def is_of_web(given: str) -> bool:
    """Whether it names what a browser can fetch by itself."""
    return _WEB.match(given) is not None


def is_stream(path: Path) -> bool:
    """Whether a file begins as a stream does."""
    with path.open("rb") as file:
        return kind_of(file.read(KIND_BYTES)) is STREAM


def folder_of_streams(path: Path) -> tuple[Folder, list[str]]:
    """A folder, and the names of its streams: one at least.

    Raises:
        InputError: there is none.
    """
    folder = Folder(path)
    names = folder.names()
    if not names:
        raise InputError(f"{path}: no .evogs file is in this folder: `evogs encode` makes them")
    return folder, names


def newly_encoded(path: Path, effort: str | int | None = None) -> tuple[str, bytes]:
    """The stream of a scene or of a tree, or in a glTF file, by a name that it could have.

    Args:
        path: of the scene.
        effort: of the encoder, as of `encode_scene`.

    Raises:
        InputError: the file is neither.
    """
    name = f"{stem_of(path)}.evogs"
    if (inside := read_gltf_stream(path)) is not None:
        return name, bytes(inside)
    with progress_bar() as progress:
        data = encode_file(path, progress, effort)
    print(f"{shown(path)}: encoded, {len(data):,} bytes")
    return name, data


def stream_of(given: str | Path, effort: str | int | None = None) -> tuple[str, bytes]:
    """One stream and its name. A scene or a tree is encoded, an address is read.

    Args:
        given: what a command was given.
        effort: of the encoder, as of `encode_scene`.

    Raises:
        InputError: it is no stream and nothing that can be encoded, or several streams.
        OSError: it cannot be read.
    """
    if isinstance(given, str):
        return _downloaded(given)
    path = given
    if path.is_dir() and scene_format(path) != "sog":
        folder, names = folder_of_streams(path)
        if (path / "tileset.json").is_file():
            raise InputError(
                f"{path}: is a tileset, and a page holds one stream: `evogs decode {path} OUT.ply"
                " --max-splats N` makes a scene of it"
            )
        if len(names) > 1:
            raise InputError(f"{path}: {len(names)} .evogs files are in this folder; name one")
        found = folder.find(names[0])
        path = path / names[0] if found is None else found
    if path.is_file() and is_stream(path):
        return path.name, path.read_bytes()
    return newly_encoded(path, effort)


def _downloaded(url: str) -> tuple[str, bytes]:
    with urllib.request.urlopen(url, timeout=_TIMEOUT) as answer:
        data = answer.read()
    if kind_of(data) is not STREAM:
        raise InputError(f"{url}: is no EvoGS stream")
    name = unquote(urlsplit(url).path).rpartition("/")[2]
    return name or "scene.evogs", data
