"""The streams that commands read: what to do where a file is none, or its end is missing."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evogs_codec.decoding.cut import Cut, tiles_meeting, tiles_within
from evogs_codec.decoding.float_view import n_moved_by_float32
from evogs_codec.editing.extract import choose_cut
from evogs_codec.editing.presence import LevelPresence, bytes_for_first_splats, level_presence
from evogs_codec.errors import Fault, InputError, StreamError
from evogs_codec.format.directory import HEADER_SIZE, Directory, read_directory, read_header
from evogs_codec.io.files import KIND_BYTES, PICTURE, TREE, kind_of
from evogs_codec.io.interchange.gltf_file import MAGIC
from evogs_codec.io.interchange.gltf_stream import read_gltf_stream
from evogs_codec.io.interchange.scene_files import START, scene_format
from evogs_codec.io.json_files import read_limits
from evogs_codec.model.splats import SplatParams
from evogs_codec.stores.remote_file import RemoteFile
from evogs_codec.stores.sources import ByteSource, bytes_of, source_of

__all__ = [
    "cut_of",
    "describe_levels",
    "describe_part",
    "limits_of",
    "located",
    "open_stream",
    "part_there",
    "read_stream",
    "sh_degree_of",
    "warn_of_float32",
]

TILESET = "tileset.json"
OF_TILESET = b'"geometricError"'  # is in every one, and in no glTF file


def limits_of(args: argparse.Namespace) -> dict[str, int] | None:
    """What `--limits` asks for."""
    return None if args.limits is None else read_limits(args.limits)


def located(at: Path | RemoteFile) -> ByteSource:
    """The stream of a file, which may be glTF with a stream in it; of a URL, that is fetched.

    Raises:
        InputError: the file is glTF and damaged, or the folder of a tileset.
        OSError: it cannot be read.
    """
    if isinstance(at, Path) and (at / TILESET).is_file():
        raise InputError(f"{at}: {_hint_for_tileset(at)}")
    if isinstance(at, RemoteFile):
        is_glb = at.size >= KIND_BYTES and at.having([(0, KIND_BYTES)])[:4] == MAGIC
        inside = read_gltf_stream(at.whole()) if is_glb else None
    else:
        inside = read_gltf_stream(at)
    return source_of(at if inside is None else inside)


def open_stream(
    at: Path | RemoteFile, limits: dict[str, int] | None
) -> tuple[ByteSource, Directory]:
    """A stream, perhaps without its end, and its directory; of a URL only that is fetched.

    Raises:
        InputError, OSError, StreamError: as `_read_directory`, or the file cannot be read.
    """
    source = located(at)
    return source, _read_directory(source, at, limits)


def read_stream(path: Path, limits: dict[str, int] | None) -> tuple[memoryview, Directory]:
    """The bytes of a stream, perhaps without its end, and its directory.

    Raises:
        InputError, OSError, StreamError: as `_read_directory`, or the file cannot be read.
    """
    source, directory = open_stream(path, limits)
    return bytes_of(source), directory


def _read_directory(
    source: ByteSource, at: Path | RemoteFile, limits: dict[str, int] | None
) -> Directory:
    """The directory of a stream, of which at least so much must be there.

    Raises:
        InputError: the file is no stream, or its directory is cut short: what to do is said.
        StreamError: header or chunks are not legal, or over the limits.
    """
    try:
        return read_directory(source, limits)
    except StreamError as error:
        if error.fault is Fault.E_SIGNATURE:
            raise InputError(f"{at}: {_hint_for_other_file(source, at)}") from error
        if error.fault is Fault.E_TRUNCATED:
            raise InputError(f"{at}: {error}; {_hint_for_short_file(source)}") from error
        raise


def _hint_for_short_file(source: ByteSource) -> str:
    """How much of a file is needed to read its directory."""
    if source.size < HEADER_SIZE:
        return f"get at least the header of {HEADER_SIZE} bytes and the directory behind it"
    data = source.having([(0, HEADER_SIZE)])[:HEADER_SIZE]
    n_bytes = HEADER_SIZE + read_header(data)["chunks_size"]
    return f"get at least the header and the directory, {n_bytes:,} bytes"


def _hint_for_other_file(source: ByteSource, at: Path | RemoteFile) -> str:
    """What the file is instead, and what to give."""
    path = at.path if isinstance(at, RemoteFile) else at
    data = bytes(source.having([(0, START)])[:START])
    kind = kind_of(data)
    if data.lstrip().startswith(b"{") and OF_TILESET in data:
        return _hint_for_tileset(at)
    if (name := scene_format(path)) is not None:
        return f"is a .{name} scene, not a stream: `evogs encode {at} OUT.evogs` makes one"
    if kind is TREE:
        return f"is a zip (.npz), not a stream: `evogs encode {at} OUT.evogs` encodes a tree"
    if kind is PICTURE:
        return "is a PNG, not a stream: give a file that `evogs encode` made"
    if not any(data):
        return "has only zeros, as of an interrupted copy or download: get the stream again"
    return "is not an EvoGS stream: give a file that `evogs encode` made"


def _hint_for_tileset(at: Path | RemoteFile) -> str:
    return (
        f"is a tileset, not a stream: `evogs decode {at} OUT.ply --box X0 Y0 Z0 X1 Y1 Z1` takes a"
        " part of it, and each file of its folder `tiles` is a stream"
    )


def warn_of_float32(path: Path | str, directory: Directory, splats: SplatParams) -> None:
    """Say where a file of float32 holds positions less exactly than the stream it is made of."""
    n_moved = n_moved_by_float32(directory, splats)
    if n_moved:
        x, y, z = -np.rint(np.median(splats.means, axis=0))
        warnings.warn(
            f"float32 moves up to {n_moved:,} splats by more than a tenth of their size; to move"
            f" the scene first is exact: `evogs edit {path} NEAR.evogs --translate {x:.0f} {y:.0f}"
            f" {z:.0f}`",
            stacklevel=1,
        )


# --- of a cut ----------------------------------------------------------------------------------


def cut_of(directory: Directory, args: argparse.Namespace) -> Cut:
    """What of a stream the options of `add_cut_options` ask for.

    Raises:
        InputError: nothing of the stream is in the box.
    """
    if args.box:
        _check_box(directory, args.box)
    return choose_cut(
        directory,
        level=args.level,
        sh_degree=sh_degree_of(directory, args),
        box=args.box,
        max_bytes=args.max_bytes and args.max_bytes.of(directory.size),
    )


def sh_degree_of(directory: Directory, args: argparse.Namespace) -> int | None:
    """That of the options, which may be above that of the stream."""
    return None if args.sh_degree is None else min(args.sh_degree, directory.sh_degree)


def _check_box(directory: Directory, box: Sequence[float]) -> None:
    met = tiles_meeting(directory, box)
    if len(met) and not met.any():
        raise InputError("--box meets no tile, so nothing would be left")
    if met.all() and not tiles_within(directory, box).all():
        more = "; `evogs encode --tiles N` makes more" if len(met) == 1 else ""
        warnings.warn(f"the box meets all tiles: nothing is left out{more}", stacklevel=1)


# --- of a part ------------------------------------------------------------------------------------


def part_there(directory: Directory, n_bytes: int, asked: Cut, path: Path | RemoteFile) -> Cut:
    """What `--partial` takes: of the cut `asked`, the packets in the first `n_bytes` of the file.

    Raises:
        InputError: the cut asked for has splats, and none is there yet.
    """
    needed = bytes_for_first_splats(directory, asked)
    if needed is not None and n_bytes < needed:
        raise InputError(
            f"{path}: no splat is there yet, get more of the file: the first splats need"
            f" {needed:,} of its {directory.size:,} bytes, and {n_bytes:,} are there"
        )
    return Cut.of_prefix(directory, n_bytes).intersection(asked)


def describe_part(directory: Directory, n_bytes: int) -> str:
    """How many bytes of a file and what levels are there."""
    there = min(n_bytes, directory.size)
    levels = describe_levels(level_presence(directory, Cut.of_prefix(directory, n_bytes)))
    share = 100 * there / directory.size
    return f"{there:,} of {directory.size:,} bytes ({share:.1f} %) with {levels}"


def describe_levels(levels: list[LevelPresence]) -> str:
    """How many levels have all splats, which have some, and whether SH are missing."""
    n_whole = sum(level.has_all_splats for level in levels)
    said = f"{n_whole} of {len(levels)} levels"
    some = [str(k) for k, level in enumerate(levels) if k >= n_whole and level.state == "in part"]
    if some:
        said += f", part of level{'s' if len(some) > 1 else ''} {', '.join(some)}"
    lacks_sh = any(level.state != "present" for level in levels[:n_whole])
    return said + (" (SH in part)" if lacks_sh else "")
