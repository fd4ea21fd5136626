"""`evogs render` and `evogs psnr`: pictures of scenes, streams and cuts of streams.

The rasterizer needs numba, an extra: it is imported when a command runs, so that all others work
without.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from tqdm import tqdm

from evogs_codec.cli.argument_types import path_or_url
from evogs_codec.cli.common_options import add_limits, add_output, add_partial
from evogs_codec.cli.loading import Loaded, load_part, load_whole
from evogs_codec.cli.looking import (
    add_look,
    background_of,
    cameras_of,
    cameras_to_show,
    need_numba,
    on_background,
)
from evogs_codec.cli.streams import describe_part, limits_of, part_there, read_stream
from evogs_codec.common.printable import shown
from evogs_codec.decoding.cut import Cut, tiles_meeting
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.extract import extract
from evogs_codec.editing.presence import level_presence
from evogs_codec.format.directory import Directory
from evogs_codec.io.files import JPEG
from evogs_codec.io.pictures import kind_of_picture

if TYPE_CHECKING:
    from evogs_codec.render.png import Real

__all__ = ["register"]

Commands = Any  # argparse's sub-parsers have no public type
Item = TypeVar("Item")
SHEET_VIEWS = 3  # columns of a contact sheet


def register(commands: Commands) -> None:
    """Add the commands to `evogs` (entry point of the group `evogs.commands`)."""
    _add(
        commands,
        "render",
        run_render,
        "Render a scene, a stream or part of a stream to a .png or .jpg.",
        "  evogs render scene.evogs scene.png\n"
        "  evogs render scene.evogs sheet.png --sheet\n"
        "  evogs render scene.evogs mixed.png --box 0 0 0 1 1 1 --level 4 --outside 1\n"
        "  evogs render download.evogs.part so-far.png --partial\n"
        "  evogs render scene.ply view.jpg --camera transforms.json --view 3 --background black\n"
        "  evogs render scene.ply view.png --camera colmap/sparse/0 --size 1200",
    )
    _add(
        commands,
        "psnr",
        run_psnr,
        "Measure the PSNR of one scene against another, over 24 views around the second.",
        "  evogs psnr scene.evogs scene.ply\n  evogs psnr scene.evogs scene.ply --level 2\n"
        "  evogs psnr download.evogs.part scene.ply --partial",
    )


def run_render(args: argparse.Namespace) -> None:
    """`evogs render`."""
    need_numba()
    _need_pillow(args.output)
    from evogs_codec.render import render
    from evogs_codec.render.framing import options_for
    from evogs_codec.render.front import most_detailed
    from evogs_codec.render.viewpoints import PICTURE_SIZE

    if args.sheet:
        _render_sheet(args)
        return
    if args.reference is not None:
        raise ValueError("--reference needs --sheet; `evogs psnr` compares two files")
    scene = _load_input(args)
    cameras, up, has_own = cameras_to_show(args, scene.splats, scene.info, size=PICTURE_SIZE)
    number, background = args.view or 0, background_of(args, scene.splats)
    if args.view is None and up is not None and not has_own:
        number = most_detailed(scene.splats, cameras, background)
    if not 0 <= number < len(cameras):
        raise ValueError(f"view {number} is not one of 0..{len(cameras) - 1}")
    options = options_for(scene.splats)
    _write(args, render(scene.splats, cameras[number], background, options=options))
    found = "" if up is None else f"{up}, view {number}, "
    print(f"{shown(args.output)}: {found}{len(scene.splats):,} splats, 1 view{scene.part}")


def _render_sheet(args: argparse.Namespace) -> None:
    """A row for each level, and one for the reference if there is one."""
    from evogs_codec.render import render
    from evogs_codec.render.framing import options_for
    from evogs_codec.render.png import contact_sheet
    from evogs_codec.render.viewpoints import SIZE

    limits = limits_of(args)
    data, directory = read_stream(args.input, limits)
    numbers, part = list(range(directory.n_levels)), ""
    cuts = [Cut.of_level(directory, level) for level in numbers]
    if args.partial:
        cuts = [part_there(directory, len(data), cut, args.input) for cut in cuts]
        there = level_presence(directory, Cut.of_prefix(directory, len(data)))
        numbers = [level for level in numbers if there[level].state != "missing"]
        cuts = [cuts[level] for level in numbers]
        part = f", from {describe_part(directory, len(data))}"
    scenes = [decode(data, cut, directory=directory).leaves() for cut in cuts]
    n_bytes = [len(extract(data, cut, directory=directory)) for cut in cuts]
    names = [f"level {level}" for level in numbers]
    if args.reference is not None:
        reference = load_whole(args.reference, limits)
        scenes.append(reference.splats)
        n_bytes.append(reference.n_bytes)
        names.append("reference")
    cameras, up, _ = cameras_to_show(args, scenes[len(cuts) - 1], directory.info, size=SIZE)
    chosen = cameras[:: max(1, len(cameras) // SHEET_VIEWS)][:SHEET_VIEWS]
    options, background = options_for(scenes[-1]), background_of(args, scenes[-1])
    rows = [
        [render(scene, camera, background, options=options) for camera in chosen]
        for scene in _with_bar(scenes, "render")
    ]
    labels = [
        f"{name}: {len(scene):,} splats, {size:,} bytes"
        for name, scene, size in zip(names, scenes, n_bytes, strict=True)
    ]
    for number, row in enumerate(rows[:-1]):
        labels[number] += f", {_mean_psnr(row, rows[-1]):.1f} dB"
    _write(args, contact_sheet(rows, labels=labels))
    found = "" if up is None else f"{up}, "
    n_splats = len(scenes[len(cuts) - 1])
    print(f"{shown(args.output)}: {found}{n_splats:,} splats, {len(chosen)} views{part}")


def _need_pillow(path: Path) -> None:
    from evogs_codec.render.jpeg import need_pillow

    if kind_of_picture(path) is JPEG:
        need_pillow(path)


def _write(args: argparse.Namespace, picture: Real) -> None:
    from evogs_codec.render.jpeg import write_jpeg
    from evogs_codec.render.png import write_png

    write = write_jpeg if kind_of_picture(args.output) is JPEG else write_png
    write(args.output, picture, made_by=args.command)


def _mean_psnr(views: list[Real], others: list[Real]) -> float:
    from evogs_codec.render import psnr

    return float(np.mean([psnr(a, b) for a, b in zip(views, others, strict=True)]))


def run_psnr(args: argparse.Namespace) -> None:
    """`evogs psnr`."""
    need_numba()
    from evogs_codec.render import psnr, render
    from evogs_codec.render.framing import options_for
    from evogs_codec.render.viewpoints import SIZE

    scene, reference = _load_input(args), load_whole(args.reference, limits_of(args))
    cameras, up = cameras_of(args, reference.splats, reference.info, size=SIZE)
    options, both = options_for(reference.splats), (scene.splats, reference.splats)
    background = background_of(args, reference.splats)
    found = [
        psnr(*(render(one, camera, background, options=options) for one in both))
        for camera in _with_bar(cameras, "psnr")
    ]
    differ = [decibels for decibels in found if math.isfinite(decibels)] or found
    n_equal = len(found) - len(differ)
    said = "" if up is None else f"{up}, "
    print(
        f"{np.mean(differ):.2f} dB on average, {min(differ):.2f} dB at least, {said}"
        f"over {len(differ)} views{f' ({n_equal} others are equal)' if n_equal else ''}"
        f"{on_background(args, reference.splats)}{scene.part}"
    )


def _with_bar(items: list[Item], what: str) -> Iterator[Item]:
    """The items, with a bar on standard error for over two seconds of them, if a terminal."""
    bar: Iterator[Item] = iter(tqdm(items, desc=what, delay=2, disable=None, leave=False))
    return bar


def _load_input(args: argparse.Namespace) -> Loaded:
    """The splats of a scene, or of a cut of a stream.

    The cut is one level, or one inside a box and another outside.
    """

    def choose(directory: Directory) -> Cut:
        cut = Cut.full(directory) if args.level is None else Cut.of_level(directory, args.level)
        if getattr(args, "box", None) is None:
            return cut
        far = Cut.of_level(directory, 0 if args.outside is None else args.outside)
        near = tiles_meeting(directory, args.box)[:, None]
        return Cut(np.where(near, cut.steps, far.steps), cut.palette)

    return load_part(args.input, limits_of(args), choose, partial=args.partial)


def _add(
    commands: Commands,
    name: str,
    run: Callable[[argparse.Namespace], None],
    help_: str,
    examples: str,
) -> None:
    parser = commands.add_parser(
        name,
        help=help_,
        description=help_,
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "input",
        type=path_or_url,
        metavar="IN",
        help="a scene of any format that `evogs convert` reads, or a stream",
    )
    if name == "psnr":
        parser.add_argument(
            "reference", type=path_or_url, metavar="REFERENCE", help="the scene to compare with"
        )
    else:
        add_output(parser, "OUT.png", kind_of_picture)
        parser.add_argument(
            "--sheet",
            action="store_true",
            help=f"render every level from {SHEET_VIEWS} views, labelled with splats, bytes, PSNR",
        )
        parser.add_argument(
            "--reference",
            type=path_or_url,
            metavar="FILE",
            help="with --sheet: compare every level with this scene and show it in the last row"
            " (default: compare with the last level)",
        )
        parser.add_argument(
            "--view",
            type=int,
            metavar="I",
            help="number of the camera (default: 0, which is the default camera of a stream; of"
            " the 24 default views, that with the most detail)",
        )
        parser.add_argument(
            "--box",
            type=float,
            nargs=6,
            metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
            help="render tiles that meet this box at --level, all others at --outside",
        )
        parser.add_argument(
            "--outside", type=int, metavar="K", help="level of tiles outside --box (default: 0)"
        )
    parser.add_argument(
        "--level", type=int, metavar="K", help="level of a stream (default: the last)"
    )
    add_look(parser, "400" if name == "psnr" else "800, and 400 of a sheet")
    add_limits(parser)
    add_partial(parser)
