"""The options of the command line, a function for each command."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Any, TypeAlias

from evogs_codec._generated import registry
from evogs_codec.cli.argument_types import error_of_group, number, parse_size, path_or_url
from evogs_codec.cli.common_options import (
    SCENES_IN,
    add_cut_options,
    add_effort,
    add_inputs,
    add_limits,
    add_output,
    add_page,
    add_partial,
)
from evogs_codec.cli.converting import kind_to_convert
from evogs_codec.cli.default_view import add_view_option
from evogs_codec.cli.large_scenes import add_large_options
from evogs_codec.cli.looking import add_camera
from evogs_codec.cli.many_files import add_many
from evogs_codec.encoding.layers import MAX_LAYERS, N_LAYERS
from evogs_codec.encoding.settings import MAX_PSNR, PRESETS, TREE_PSNR
from evogs_codec.io import files
from evogs_codec.io.interchange.scene_files import TARGETS, kind_of_stream, kind_to_write
from evogs_codec.lifting.lift import ALL_LEVELS_FROM, N_LEVELS
from evogs_codec.model.channels import GROUPS

__all__ = [
    "Commands",
    "add_convert",
    "add_decode",
    "add_encode",
    "add_extract",
    "add_info",
    "add_lift",
    "add_metadata",
    "add_validate",
    "command_parser",
]

DEFAULT_ITERATIONS = 200
FORMATS = sorted((ending[1:] for ending in TARGETS), key=lambda name: name != "ply")
STREAM_IN = "a stream: a file, or a URL (s3://, gs://, https://)"
TILESET_IN = f"{STREAM_IN}; or the tileset.json of a tileset"

# What argparse is not to take for an option, as it does before Python 3.14 with -1e3, and always
# with an axis (`--up -y`).
NO_OPTION = re.compile(r"-((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[xyz])$")

Commands: TypeAlias = Any  # argparse's sub-parsers have no public type
Run: TypeAlias = Callable[[argparse.Namespace], int | None]


def command_parser(
    commands: Commands,
    name: str,
    run: Run,
    help_: str,
    examples: str,
) -> argparse.ArgumentParser:
    """The parser of a command, with examples behind its options."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=help_,
        description=help_,
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_encode(commands: Commands, run: Run, *, many: bool = False) -> None:
    """`evogs encode`."""
    parser = command_parser(
        commands,
        "encode",
        run,
        "Encode a 3DGS scene or a tree (.tree.npz) as one progressive stream.",
        "  evogs encode scene.ply scene.evogs\n"
        "  evogs encode scene.spz scene.evogs\n"
        "  evogs encode scene.ply scene.evogs --fast\n"
        "  evogs encode scene.ply scene.evogs --levels 6 --title Bonsai --licence CC-BY-4.0\n"
        "  evogs encode lego.tree.npz lego.evogs\n"
        "  evogs encode lego.tree.npz lego.evogs --preset trained\n"
        "  evogs encode city-1.ply city-2.ply city.evogs --workers 8\n"
        "  evogs encode scene.ply scene.evogs --target-psnr 45 --camera transforms.json\n"
        "  evogs encode scene.ply scene.evogs --target-bytes 5000000\n"
        "  evogs encode scene.ply scene.evogs --target-psnr 40 --polish\n"
        "  evogs encode scene.ply scene.evogs --max-error 0.01 position=0.0005\n"
        "  evogs encode lego.tree.npz exact.evogs --near-lossless\n"
        "  evogs encode a.ply b.ply --out-dir streams\n"
        "  evogs encode https://example.org/scene.ply s3://bucket/scene.evogs",
    )
    several = f"{SCENES_IN}; a folder of them; or a .tree.npz"
    add_inputs(parser, "IN", several, many=many)
    if not many:
        said = "other parts of the same scene"
        parser.add_argument("others", type=path_or_url, nargs="*", metavar="IN", help=said)
    add_output(parser, "OUT.evogs", kind_of_stream, is_named=not many)
    add_many(parser, ["evogs"])
    _add_lift_options(
        parser,
        "every view that the encode renders, also those of --refine, --polish and targets",
        f"{N_LEVELS}; fewer of less than {ALL_LEVELS_FROM:,} splats, without --refine",
    )
    add_view_option(parser)
    accuracy = parser.add_mutually_exclusive_group()
    accuracy.add_argument(
        "--preset",
        choices=[name for name in PRESETS if name != "near-lossless"],
        help="quantise with fixed steps. By default rendered views decide how exact each number"
        " is. scene: about as accurate as SPZ version 4; trained: for a .tree.npz; paper: the"
        " pipeline of the EvoGS paper, for comparison",
    )
    accuracy.add_argument(
        "--bits",
        type=number(int, 2, 16),
        metavar="B",
        help="quantise the refinements of each level to B bits over their range (instead of"
        " --preset); each level corrects the rounding of the coarser ones",
    )
    accuracy.add_argument(
        "--near-lossless",
        action="store_true",
        help="keep every number within one unit of a grid that has at least 4 million units over"
        " the range of the number",
    )
    accuracy.add_argument(
        "--target-psnr",
        type=number(float, 5, MAX_PSNR),
        metavar="DB",
        help="make the smallest stream that has this PSNR against the input, over 24 rendered"
        f" views (default for a .tree.npz of floats: {TREE_PSNR:g}; if numba is missing or the"
        " target cannot be met, --preset trained is used instead)",
    )
    accuracy.add_argument(
        "--target-bytes",
        type=parse_size,
        metavar="SIZE",
        help="make the stream of at most this size that has the highest PSNR over rendered views:"
        " bytes, or 5MB, 4.5MiB, or 20%% of IN",
    )
    accuracy.add_argument(
        "--max-error",
        type=error_of_group,
        nargs="+",
        metavar="E",
        help="bound the error of every number by E, in the units of the input; GROUP=E bounds one"
        f" group: {', '.join(GROUPS)}",
    )
    parser.add_argument(
        "--layers",
        type=number(int, 1, MAX_LAYERS),
        metavar="N",
        help="N layers of precision: all splats come at coarse steps first, then are refined, so"
        f" that prefixes of the file look far better (default: {N_LAYERS}; 1 with --preset, --bits,"
        " --near-lossless, --finer and --max-error)",
    )
    _add_descent(
        parser,
        "--polish",
        "adjust the integers of the last level by gradient descent on rendered views; needs"
        " --target-psnr or --target-bytes. It takes minutes and saves 7 to 9 %% of the bytes at"
        " 42 dB, nothing at 52 dB. With --camera, every 5th view is held out to"
        f" measure the PSNR (default: {DEFAULT_ITERATIONS} iterations)",
    )
    parser.add_argument(
        "--finer",
        type=number(float, 1e-3, 1e6),
        metavar="F",
        help="divide all quantiser steps by F",
    )
    parser.add_argument(
        "--no-palette",
        action="store_true",
        help="store the SH above band 0 of every splat, even if most splats share them (as they"
        " do in a scene that was a SOG file)",
    )
    parser.add_argument(
        "--tiles",
        type=number(int, 1, 65536),
        metavar="N",
        help="number of spatial tiles (default: depends on the number of splats; 1 below 200,000)",
    )
    add_effort(parser)
    add_metadata(parser)
    add_large_options(parser)
    _add_json(parser)
    add_page(
        parser,
        "--report",
        "write a page that says what was kept and what it cost, level by level, with pictures",
    )


def add_metadata(parser: argparse.ArgumentParser) -> None:
    """What a person says of a scene."""
    for key in registry.TEXT_OPTIONS:
        parser.add_argument(f"--{key}", metavar="TEXT", help="metadata of the stream")
    for option, names in (
        ("--coordinate-system", registry.COORDINATE_SYSTEMS),
        ("--up-axis", registry.UP_AXES),
        ("--unit", registry.UNITS),
        ("--colour-space", registry.COLOUR_SPACES),
    ):
        parser.add_argument(
            option,
            choices=names,
            default=names[0],
            help="metadata of the stream (default: what the input says)",
        )
    parser.add_argument(
        "--antialiased",
        action="store_true",
        help="mark the scene as trained with antialiasing, as the input may say too",
    )


def add_decode(commands: Commands, run: Run, *, many: bool = False) -> None:
    """`evogs decode`."""
    parser = command_parser(
        commands,
        "decode",
        run,
        "Decode a stream, or part of it, to a .ply or another format, which the ending says.",
        "  evogs decode scene.evogs scene.ply\n"
        "  evogs decode scene.evogs scene.spz\n"
        "  evogs decode scene.evogs coarse.ply --level 1 --sh-degree 0\n"
        "  evogs decode scene.evogs corner.ply --box 0 0 0 1 1 1\n"
        "  evogs decode download.evogs.part so-far.ply --partial\n"
        "  evogs decode a.evogs b.evogs --out-dir scenes\n"
        "  evogs decode s3://bucket/scene.evogs corner.ply --box 0 0 0 1 1 1\n"
        "  evogs decode city/tileset.json seen.ply --max-splats 500000",
    )
    add_inputs(parser, "IN.evogs", TILESET_IN, many=many)
    add_output(parser, "OUT.ply", kind_to_write, is_named=not many)
    add_many(parser, FORMATS)
    add_cut_options(parser)
    parser.add_argument(
        "--max-splats",
        type=number(int, 1, 1 << 40),
        metavar="N",
        help="of a tileset: take overviews and coarse levels, so that there are at most N splats",
    )
    add_limits(parser)
    add_partial(parser)
    parser.add_argument(
        "--verify", action="store_true", help="check the SHA-256 digests of the stream"
    )


def add_convert(commands: Commands, run: Run, *, many: bool = False) -> None:
    """`evogs convert`."""
    parser = command_parser(
        commands,
        "convert",
        run,
        "Convert a scene to another format, which the ending says.",
        "  evogs convert scene.spz scene.ply\n"
        "  evogs convert scene.sog scene.compressed.ply\n"
        "  evogs convert scene.ply scene.glb\n"
        "  evogs convert scene.evogs scene.spz      # all of it; decode takes a part\n"
        "  evogs convert scene.evogs scene.glb      # the stream in a glTF file, as it is\n"
        "  evogs convert scene.evogs scene.gltf     # a glTF file that names the stream\n"
        "  evogs convert scene.glb scene.evogs      # the same stream again\n"
        "  evogs convert a.ply b.sog --out-dir out --to spz",
    )
    several = f"{SCENES_IN}; or a stream, which a .glb or .gltf holds as it is"
    add_inputs(parser, "IN", several, many=many)
    add_output(parser, "OUT", kind_to_convert, is_named=not many)
    add_many(parser, FORMATS)
    parser.add_argument(
        "--drop-invalid", action="store_true", help="drop splats that have a NaN or an infinity"
    )
    parser.add_argument(
        "--fallback",
        action="store_true",
        help="of a stream in a .glb or .gltf: add the splats of level 0, uncompressed, for readers"
        " that do not know streams",
    )


def add_lift(commands: Commands, run: Run) -> None:
    """`evogs lift`."""
    parser = command_parser(
        commands,
        "lift",
        run,
        "Build the levels of a scene and write them as a tree, uncompressed.",
        "  evogs lift scene.ply scene.tree.npz\n"
        "  evogs lift scene.ply scene.tree.npz --refine --up -y\n"
        "  evogs encode scene.tree.npz scene.evogs --preset scene",
    )
    parser.add_argument("input", type=path_or_url, metavar="IN", help=SCENES_IN)
    add_output(parser, "OUT.tree.npz", files.TREE)
    _add_lift_options(parser, "--refine", str(N_LEVELS))


def add_info(commands: Commands, run: Run) -> None:
    """`evogs info`."""
    parser = command_parser(
        commands,
        "info",
        run,
        "Show what a stream contains: header, levels, bytes per group.",
        "  evogs info scene.evogs\n  evogs info scene.evogs --json\n  evogs info city/tileset.json",
    )
    parser.description = (
        "Show what a stream contains: header, levels, bytes per group.\n\n"
        "adds: detail (other splats than the level below), or precision (the same, refined)\n"
        "to move: estimated RMS distance of the splats from their final positions, scene units\n"
        "PSNR: of pictures of the level against the scene, where the encoder measured it\n"
        "over order-0: how far the bytes exceed the order-0 entropy of the integers\n\n"
        "Of a file whose end is missing, each level is marked present, in part or missing."
    )
    parser.add_argument("input", type=path_or_url, metavar="IN.evogs", help=TILESET_IN)
    add_limits(parser)
    _add_json(parser)


def add_validate(commands: Commands, run: Run) -> None:
    """`evogs validate`."""
    parser = command_parser(
        commands,
        "validate",
        run,
        "Check a whole stream; exit 0 if it is valid, 1 with the fault if it is not.",
        "  evogs validate scene.evogs\n  evogs validate scene.evogs --json\n"
        "  evogs validate download.evogs --limits limits.json\n"
        "  evogs validate city/tileset.json",
    )
    parser.add_argument("input", type=path_or_url, metavar="IN.evogs", help=TILESET_IN)
    add_limits(parser)
    _add_json(parser)


def add_extract(commands: Commands, run: Run) -> None:
    """`evogs extract`."""
    parser = command_parser(
        commands,
        "extract",
        run,
        "Make a smaller stream from some of the packets, without decoding them, and print what"
        " it keeps.",
        "  evogs extract scene.evogs small.evogs --level 2\n"
        "  evogs extract scene.evogs small.evogs --max-bytes 500000\n"
        "  evogs extract scene.evogs corner.evogs --box 0 0 0 1 1 1 --sh-degree 0",
    )
    parser.add_argument("input", type=path_or_url, metavar="IN.evogs", help=STREAM_IN)
    add_output(parser, "OUT.evogs", kind_of_stream)
    add_cut_options(parser)
    add_limits(parser)


def _add_lift_options(parser: argparse.ArgumentParser, uses: str, levels: str) -> None:
    parser.add_argument(
        "--levels",
        type=number(int, 1, 64),
        metavar="N",
        help=f"number of levels to build from a scene (default: {levels})",
    )
    parser.add_argument(
        "--drop-invalid", action="store_true", help="drop splats that have a NaN or an infinity"
    )
    _add_descent(
        parser,
        "--refine",
        "improve the coarse levels of a .ply by gradient descent on rendered views (default:"
        f" {DEFAULT_ITERATIONS} iterations per level)",
    )
    add_camera(parser, uses)


def _add_descent(parser: argparse.ArgumentParser, option: str, help_: str) -> None:
    """An option that draws pictures for so many iterations."""
    parser.add_argument(
        option,
        type=number(int, 2, 1_000_000),
        nargs="?",
        const=DEFAULT_ITERATIONS,
        metavar="ITERATIONS",
        help=help_,
    )


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
