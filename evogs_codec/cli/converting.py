"""`evogs convert`: scenes and streams to other formats, streams into glTF files and out of them."""

from __future__ import annotations

import argparse
from pathlib import Path

from evogs_codec.cli.encode_and_lift import read_splats
from evogs_codec.cli.reports import info_to_write
from evogs_codec.cli.streams import read_stream, warn_of_float32
from evogs_codec.common.printable import shown
from evogs_codec.decoding.decode import decode_leaves
from evogs_codec.editing.byte_stats import levels
from evogs_codec.errors import InputError
from evogs_codec.format.directory import read_directory
from evogs_codec.io.files import KIND_BYTES, STREAM, FileKind, kind_of, write_atomic
from evogs_codec.io.interchange.gltf_stream import read_gltf_stream
from evogs_codec.io.interchange.gltf_stream_write import GLTF, write_gltf_stream
from evogs_codec.io.interchange.scene_files import kind_to_write, write_scene
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

__all__ = ["kind_to_convert", "run_convert"]


def kind_to_convert(path: Path) -> FileKind:
    """The kind of file that `evogs convert` makes of this name.

    Raises:
        InputError: the ending is of no format that is written.
    """
    return {".evogs": STREAM, ".gltf": GLTF}.get(path.suffix.lower()) or kind_to_write(path)


def run_convert(args: argparse.Namespace) -> None:
    """`evogs convert`."""
    ending = args.output.suffix.lower()
    if _is_stream(args.input) and ending in (".glb", ".gltf"):
        _wrap(args)
        return
    if args.fallback:
        raise InputError("--fallback: only a stream in a .glb or .gltf has a fallback")
    if ending == ".evogs" and (stream := read_gltf_stream(args.input)) is not None:
        _unwrap(args, stream)
        return
    if ending in (".evogs", ".gltf"):
        kind_to_write(args.output)  # says what is written
        raise InputError(f"{args.output}: only a stream is written as a .gltf: name a .glb")
    splats, info = _read(args)
    degree = write_scene(args.output, splats, info, made_by=args.command)
    print(f"{shown(args.output)}: {len(splats):,} splats, SH degree {degree}")


def _read(args: argparse.Namespace) -> tuple[SplatParams, SceneInfo]:
    """The splats of a scene, or of a whole stream, and what is known of them."""
    if _is_stream(args.input):
        data, directory = read_stream(args.input, None)
        splats = decode_leaves(data, directory=directory)
        warn_of_float32(args.input, directory, splats)
        return splats, info_to_write(directory)
    scene = read_splats(args.input, drop_invalid=args.drop_invalid)
    return scene.splats, scene.info


def _is_stream(path: Path) -> bool:
    if path.is_dir():
        return False
    with path.open("rb") as file:
        return kind_of(file.read(KIND_BYTES)) is STREAM


def _wrap(args: argparse.Namespace) -> None:
    write_gltf_stream(args.output, args.input, fallback=args.fallback, made_by=args.command)
    directory = read_directory(args.input)
    _say(args.output, levels(directory)[-1].n_leaves, directory.size, args.output.stat().st_size)


def _unwrap(args: argparse.Namespace, stream: memoryview) -> None:
    directory = read_directory(stream)
    if len(stream) != directory.size:
        raise InputError(
            f"{args.input}: cut short: {len(stream):,} of the {directory.size:,} bytes of its"
            " stream are there"
        )
    write_atomic(args.output, bytes(stream))
    _say(args.output, levels(directory)[-1].n_leaves, directory.size, directory.size)


def _say(path: Path, n_splats: int, n_stream: int, n_bytes: int) -> None:
    print(
        f"{shown(path)}: {n_splats:,} splats, a stream of {n_stream:,} bytes, as it was, in"
        f" {n_bytes:,}"
    )
