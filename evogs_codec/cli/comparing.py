"""`evogs compare`: files beside a reference, as numbers and as a page of pictures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from evogs_codec.cli.argument_types import number, path_or_url
from evogs_codec.cli.common_options import (
    SCENES_IN,
    add_cut_options,
    add_limits,
    add_page,
    add_partial,
)
from evogs_codec.cli.loading import Loaded, load_part, load_whole
from evogs_codec.cli.looking import (
    add_look,
    background_of,
    cameras_of,
    need_numba,
    on_background,
)
from evogs_codec.cli.streams import cut_of, limits_of
from evogs_codec.cli.terminal import progress_bar
from evogs_codec.common.printable import shown
from evogs_codec.common.version import __version__
from evogs_codec.errors import Fault, InputError, StreamError
from evogs_codec.io.files import write_atomic

__all__ = ["add_compare", "run_compare"]

HELP = "Compare files with the first of them: bytes, PSNR, SSIM, errors, pictures."
DESCRIPTION = f"""{HELP}

Options that cut a stream cut every stream but the first file, so that a level may be compared with
all of its stream. Errors are those of splats that correspond: by their order where both files have
as many in the same order, or else the nearest."""
EXAMPLES = """examples:
  evogs compare scene.ply scene.evogs scene.spz
  evogs compare scene.ply scene.evogs scene.sog --html report.html
  evogs compare scene.evogs scene.evogs --level 2
  evogs compare scene.ply download.evogs.part --partial --json"""
N_VIEWS_SHOWN = 3
MAX_SHOWN = 24


def add_compare(commands: Any) -> None:  # noqa: ANN401 - argparse's sub-parsers have no public type
    """Add the command to `evogs`."""
    parser = commands.add_parser(
        "compare",
        help=HELP,
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run_compare)
    parser.add_argument(
        "reference", type=path_or_url, metavar="A", help=f"{SCENES_IN}; or a stream"
    )
    parser.add_argument(
        "others",
        type=path_or_url,
        nargs="+",
        metavar="B",
        help="files of these kinds to compare with it",
    )
    add_page(parser, "--html", "write a page with the pictures side by side, and what differs")
    parser.add_argument(
        "--force", action="store_true", help="replace the page even if this command did not make it"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--shown",
        type=number(int, 1, MAX_SHOWN),
        default=N_VIEWS_SHOWN,
        metavar="N",
        help=f"views on the page (default: {N_VIEWS_SHOWN}); all are measured",
    )
    add_look(parser, "400")
    add_cut_options(parser)  # of the streams among the others: the reference is whole
    add_limits(parser)
    add_partial(parser)


def run_compare(args: argparse.Namespace) -> None:
    """`evogs compare`."""
    need_numba()
    from evogs_codec.comparison.compared import Subject, as_json, as_page, as_text, compare
    from evogs_codec.render.viewpoints import SIZE

    limits = limits_of(args)
    loaded = [load_whole(args.reference, limits)]
    loaded += [_load(path, args, limits) for path in args.others]
    cuts = ["", *(_cut_said(args) if one.format == "evogs" else "" for one in loaded[1:])]
    said = [cut + one.part for cut, one in zip(cuts, loaded, strict=True)]
    names = _names([args.reference, *args.others], said)
    cameras, up = cameras_of(args, loaded[0].splats, loaded[0].info, size=SIZE)
    subjects = [
        Subject(name, one.format, one.n_bytes, one.splats)
        for name, one in zip(names, loaded, strict=True)
    ]
    where = f"{len(cameras)} of {shown(args.camera)}"
    if up is not None:
        where = f"{len(cameras)} on a circle, {up}"
    size = f"{cameras[0].width} x {cameras[0].height} pixels"
    size += on_background(args, loaded[0].splats)
    with progress_bar() as progress:
        found = compare(
            subjects,
            cameras,
            background_of(args, loaded[0].splats),
            views=f"{where}, {size}",
            n_shown=args.shown if args.page else 0,
            progress=progress,
        )
    if args.page is not None:
        made_with = f"evogs {__version__}: evogs compare {' '.join(map(str, _given(args)))}"
        write_atomic(args.page, as_page(found, command=args.command, made_with=made_with))
    if args.json:
        print(json.dumps(as_json(found), indent=2))
        return
    print(shown_lines(as_text(found)))
    if args.page is not None:
        print(f"\n{shown(args.page)}: {args.page.stat().st_size:,} bytes")


def shown_lines(text: str) -> str:
    """Text of several lines, each fit to print."""
    return "\n".join(shown(line, None) for line in text.split("\n"))


def _load(path: Path, args: argparse.Namespace, limits: dict[str, int] | None) -> Loaded:
    try:
        return load_part(path, limits, partial(cut_of, args=args), partial=args.partial)
    except StreamError as error:
        could_be_partial = error.fault is Fault.E_TRUNCATED and not args.partial
        hint = "; --partial takes what is there" if could_be_partial else ""
        raise InputError(f"{path}: {error}{hint}") from error


def _given(args: argparse.Namespace) -> list[str]:
    """The files and the cut, for the foot of a page."""
    files = [path.name for path in (args.reference, *args.others)]
    return [*files, *filter(None, [_cut_said(args).lstrip(", ")])]


def _cut_said(args: argparse.Namespace) -> str:
    """The cut that the options ask for, for people."""
    said = ""
    if args.level is not None:
        said += f", level {args.level}"
    if args.sh_degree is not None:
        said += f", SH degree {args.sh_degree}"
    if args.max_bytes is not None:
        size = args.max_bytes
        said += f", {100 * size.part:g} %" if size.part is not None else f", {size.n_bytes:,} bytes"
    if args.box is not None:
        said += f", box {' '.join(f'{side:g}' for side in args.box)}"
    return said


def _names(paths: Sequence[Path], said: Sequence[str]) -> list[str]:
    """The last part of each path and what is said of it, or all of the path where that is unclear.

    Raises:
        InputError: a file is named twice with the same cut.
    """
    for of in (lambda path: path.name or str(path), str):
        names = [of(path) + more for path, more in zip(paths, said, strict=True)]
        if len(set(names)) == len(names):
            return names
    twice = next(path for path, name in zip(paths, names, strict=True) if names.count(name) > 1)
    raise InputError(f"{twice}: is named twice, so there is nothing to compare")
