"""Options that several commands have: what is written, what is read of a stream, and how much."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from evogs_codec._generated.limits import LIMITS
from evogs_codec.cli.argument_types import effort, number, parse_size, path_or_url
from evogs_codec.io import files

__all__ = [
    "SCENES_IN",
    "add_cut_options",
    "add_effort",
    "add_inputs",
    "add_limits",
    "add_output",
    "add_page",
    "add_partial",
]

SCENES_IN = "a .ply, plain or compressed, .spz, .sog, .splat, .ksplat, .glb or .gltf"


def add_output(
    parser: argparse.ArgumentParser,
    metavar: str,
    kind: files.FileKind | Callable[[Path], files.FileKind],
    *,
    is_named: bool = True,
) -> None:
    """What a command makes, and `--force`: `cli.commands` checks both before the work.

    Args:
        parser: of the command.
        metavar: of the output.
        kind: of file, or what tells it from the name.
        is_named: the output is an argument; otherwise `--out-dir` says where outputs go.
    """
    if is_named:
        said = "a file, s3:// or gs://"
        parser.add_argument("output", type=path_or_url, metavar=metavar, help=said)
    parser.add_argument(
        "--force",
        action="store_true",
        help=f"replace {metavar} even if this command did not make it",
    )
    parser.set_defaults(output_kind=kind, command=parser.prog)


def add_inputs(parser: argparse.ArgumentParser, metavar: str, help_: str, *, many: bool) -> None:
    """The input, or with `many` the inputs of a command with `--out-dir`."""
    if many:
        parser.add_argument("inputs", type=path_or_url, nargs="+", metavar=metavar, help=help_)
    else:
        parser.add_argument("input", type=path_or_url, metavar=metavar, help=help_)


def add_page(parser: argparse.ArgumentParser, option: str, help_: str) -> None:
    """A page that a command writes besides, which `cli.commands` checks before the work."""
    parser.add_argument(option, dest="page", type=Path, metavar="FILE.html", help=help_)
    parser.set_defaults(page_kind=files.REPORT, command=parser.prog)


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Limits of this decoder, for streams of strangers."""
    parser.add_argument(
        "--limits",
        type=Path,
        metavar="FILE.json",
        help="refuse a stream that exceeds these limits, before its packets are read. Example:"
        f' {{"slots": 5000000}}. Names: {", ".join(LIMITS)}',
    )


def add_partial(parser: argparse.ArgumentParser) -> None:
    """Take what is there of a file whose end is missing."""
    parser.add_argument(
        "--partial",
        action="store_true",
        help="take what is there of a stream whose end is missing, and print how much that is",
    )


def add_cut_options(parser: argparse.ArgumentParser) -> None:
    """What of a stream is taken, which `cli.streams.cut_of` understands."""
    parser.add_argument(
        "--level", type=number(int, 0, 63), metavar="K", help="leave out the levels above K"
    )
    parser.add_argument(
        "--max-bytes",
        type=parse_size,
        metavar="SIZE",
        help="take the longest prefix that fits in a file of this size: bytes, or 5MB, 4.5MiB, or"
        " 20%% of IN",
    )
    parser.add_argument(
        "--box",
        type=number(float, -1e30, 1e30),
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="take only the tiles that meet this box, in scene units. Tiles are taken whole: encode"
        " with --tiles N for smaller ones",
    )
    parser.add_argument(
        "--sh-degree",
        type=number(int, 0, 3),
        metavar="D",
        help="leave out the SH bands above D; a stream with a palette keeps all bands unless D is"
        " 0",
    )


def add_effort(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """`--effort` and `--fast`.

    Args:
        parser: of a command.
        default: the effort where neither is given; None is that of `evogs encode`.
    """
    work = parser.add_mutually_exclusive_group()
    named = default or "default, level 18"
    work.add_argument(
        "--effort",
        type=effort,
        default=default,
        metavar="WHAT",
        help="fast: fewer and smaller views, about half of the time, and no PSNR of levels;"
        " default: what `evogs encode` does; best: more and larger views, and level 22 of"
        f" Zstandard; 1..22: the default with this level of Zstandard (default: {named})",
    )
    work.add_argument(
        "--fast", dest="effort", action="store_const", const="fast", help="short for --effort fast"
    )
