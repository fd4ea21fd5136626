"""`evogs edit`: crops, floaters, transforms, several scenes as one."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from evogs_codec.cli.argument_types import number, path_or_url
from evogs_codec.cli.common_options import SCENES_IN, add_limits, add_output
from evogs_codec.cli.encode_and_lift import read_splats
from evogs_codec.cli.options import Commands, command_parser
from evogs_codec.cli.streams import limits_of, read_stream
from evogs_codec.cli.terminal import progress_bar
from evogs_codec.common.printable import shown
from evogs_codec.encoding.grids import NotRepresentableError
from evogs_codec.encoding.settings import PRESETS
from evogs_codec.errors import InputError, StreamError
from evogs_codec.io.files import KIND_BYTES, STREAM, FileKind, kind_of, write_atomic
from evogs_codec.io.interchange.scene_files import Scene, kind_to_write, write_scene
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64
from evogs_codec.scene import encode_scene
from evogs_codec.scene_edits import Box, Edit, Edited, Sphere, edit_scenes
from evogs_codec.scene_edits.floaters import N_NEIGHBOURS, THRESHOLD
from evogs_codec.scene_edits.regions import Region
from evogs_codec.scene_edits.rotations import (
    rotation_about,
    rotation_of_matrix,
    rotation_of_quaternion,
)

__all__ = ["add_edit", "run_edit"]

ENDING = ".evogs"
COORDINATE = number(float, -1e30, 1e30)
AXES = ("X", "Y", "Z")


def add_edit(commands: Commands) -> None:
    """`evogs edit`."""
    parser = command_parser(
        commands,
        "edit",
        run_edit,
        "Crop, clean, scale, rotate and move scenes or streams, or make one of several.",
        "  evogs edit scene.evogs part.evogs --crop-box -1 -1 -1 1 1 1\n"
        "  evogs edit scene.ply clean.spz --drop-floaters\n"
        "  evogs edit scene.evogs there.evogs --translate 10 0 0\n"
        "  evogs edit scene.evogs up.evogs --rotate 1 0 0 90 --scale 0.01\n"
        "  evogs edit house.evogs garden.evogs both.evogs",
    )
    parser.description = (
        "Crop, clean, scale, rotate and move scenes or streams, or make one of several.\n\n"
        "Whatever the order of the options: inputs are joined, cropped, floaters dropped; then the"
        " rest\nis scaled, rotated and moved. Numbers are in the units of the input. They are in"
        " the axes of a\n.ply, to which other formats are turned, or in those of a stream. Streams"
        " keep their packets\nwhere they can, which the line `exact:` says; otherwise the splats"
        " are encoded again."
    )
    several = f"a stream, or {SCENES_IN}"
    parser.add_argument("input", type=path_or_url, metavar="IN", help=several)
    parser.add_argument(
        "others", type=path_or_url, nargs="*", metavar="IN", help="more, which become one scene"
    )
    add_output(parser, "OUT", _kind)
    region = parser.add_mutually_exclusive_group()
    region.add_argument(
        "--crop-box",
        type=COORDINATE,
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="keep the splats whose positions are in this box, from one corner to the opposite one",
    )
    region.add_argument(
        "--crop-sphere",
        type=COORDINATE,
        nargs=4,
        metavar=(*AXES, "RADIUS"),
        help="keep the splats whose positions are in this sphere",
    )
    parser.add_argument(
        "--drop-floaters",
        type=number(float, 0, 1e6),
        nargs="?",
        const=THRESHOLD,
        metavar="T",
        help=f"leave out splats that are far from all others, by the mean distance to"
        f" the {N_NEIGHBOURS} nearest and by that distance over their size: the logarithms of both"
        f" are over T robust standard deviations above the median (default: {THRESHOLD:g})",
    )
    parser.add_argument(
        "--scale", type=number(float, 1e-12, 1e12), default=1.0, metavar="F", help="times F"
    )
    rotation = parser.add_mutually_exclusive_group()
    rotation.add_argument(
        "--rotate",
        type=COORDINATE,
        nargs=4,
        metavar=(*AXES, "DEGREES"),
        help="rotate about an axis, anticlockwise where it points at the viewer",
    )
    rotation.add_argument(
        "--rotate-quaternion", type=COORDINATE, nargs=4, metavar=("W", *AXES), help="rotate"
    )
    rotation.add_argument(
        "--rotate-matrix",
        type=COORDINATE,
        nargs=9,
        metavar="M",
        help="rotate by a matrix of three rows",
    )
    parser.add_argument(
        "--about",
        type=COORDINATE,
        nargs=3,
        metavar=AXES,
        help="the point that --scale and --rotate leave where it is (default: 0 0 0)",
    )
    parser.add_argument(
        "--translate", type=COORDINATE, nargs=3, metavar=AXES, help="move by this offset, at last"
    )
    parser.add_argument(
        "--drop-invalid", action="store_true", help="drop splats that have a NaN or an infinity"
    )
    parser.add_argument(
        "--preset",
        choices=[name for name in PRESETS if name != "near-lossless"],
        help="where splats are encoded again: fixed steps, as of `evogs encode`",
    )
    add_limits(parser)


def run_edit(args: argparse.Namespace) -> None:
    """`evogs edit`."""
    edit, paths = _edit_of(args), [args.input, *args.others]
    inputs = [_read(path, args) for path in paths]
    changes = edit.crop or edit.floaters is not None or edit.turns or edit.offset.any()
    if not changes and len(paths) == 1:
        raise InputError(f"{args.input}: nothing to do: say what to edit, or use `evogs convert`")
    try:
        edited = edit_scenes(inputs, edit)
    except InputError as error:
        raise InputError(f"{args.output}: {error}; nothing is written") from error
    n = len(edited.scene.splats)
    if edited.n_before and not n:
        raise InputError(f"{args.output}: no splat is left, so nothing is written")
    said = _write(args, edited)
    print(f"{shown(args.output)}: {n:,} of {edited.n_before:,} splats{said}")
    if edit.crop is not None:
        print(f"outside {edit.crop}: {edited.n_outside:,} splats")
    if edit.floaters is not None:
        print(f"floaters: {edited.n_floaters:,} splats")


def _kind(path: Path) -> FileKind:
    """What is written: a stream, or what `convert` writes of this name."""
    if _is_stream(path):
        return STREAM
    try:
        return kind_to_write(path)
    except InputError as error:
        raise InputError(f"{error}, or {ENDING}") from error


def _is_stream(path: Path) -> bool:
    return path.suffix.lower() == ENDING


def _edit_of(args: argparse.Namespace) -> Edit:
    """What the options ask for.

    Raises:
        InputError: numbers say no sphere or no rotation.
    """
    crop: Region | None = None
    try:
        if args.crop_box:
            crop = Box(tuple(args.crop_box[:3]), tuple(args.crop_box[3:]))
        if args.crop_sphere:
            crop = Sphere(tuple(args.crop_sphere[:3]), args.crop_sphere[3])
        rotation = _rotation(args)
    except ValueError as error:
        raise InputError(str(error)) from error
    about = np.array(args.about or (0, 0, 0), np.float64)
    there = np.array(args.translate or (0, 0, 0), np.float64)
    return Edit(
        crop,
        args.drop_floaters,
        args.scale,
        rotation,
        about - args.scale * rotation @ about + there,
    )


def _rotation(args: argparse.Namespace) -> F64:
    if args.rotate:
        return rotation_about(args.rotate[:3], args.rotate[3])
    if args.rotate_quaternion:
        return rotation_of_quaternion(args.rotate_quaternion)
    if args.rotate_matrix:
        return rotation_of_matrix(args.rotate_matrix)
    return np.eye(3)


def _read(path: Path, args: argparse.Namespace) -> Scene | memoryview:
    """A scene, or the bytes of a stream that is whole."""
    if not path.is_dir():
        with path.open("rb") as file:
            start = file.read(KIND_BYTES)
        if kind_of(start) is STREAM:
            try:
                return read_stream(path, limits_of(args))[0]
            except StreamError as error:
                raise InputError(f"{path}: {error}") from error
    return read_splats(path, drop_invalid=args.drop_invalid)


def _write(args: argparse.Namespace, edited: Edited) -> str:
    """Write what was made; returns what there is to say of it."""
    scene = edited.scene
    if not _is_stream(args.output):
        degree = write_scene(args.output, scene.splats, scene.info, made_by=args.command)
        return f", SH degree {degree}"
    if edited.stream is not None:
        write_atomic(args.output, edited.stream)
        return f", {len(edited.stream):,} bytes\nexact: {edited.how}"
    text = {key: value for key, value in scene.info.text.items() if key != "generator"}
    info = SceneInfo(**{**vars(scene.info), "text": text})
    try:
        with progress_bar() as progress:
            data = encode_scene(scene.splats, preset=args.preset, info=info, progress=progress)
    except NotRepresentableError as error:
        raise InputError(f"{args.output}: {error}; nothing is written") from error
    write_atomic(args.output, data)
    return f", {len(data):,} bytes\nencoded again: {edited.how}"
