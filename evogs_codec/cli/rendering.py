"""`evogs render` and `evogs psnr`: pictures of scenes, streams and cuts of streams.

The rasterizer needs numba, an extra: it is imported when a command runs, so that all others work
without.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from tqdm import tqdm

from evogs_codec.cli.argument_types import path_or_url
from evogs_codec.cli.options import add_limits, add_output, add_partial
from evogs_codec.cli.streams import describe_part, limits_of, part_there, read_stream
from evogs_codec.common.printable import shown
from evogs_codec.decoding.cut import Cut, tiles_meeting
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.extract import extract
from evogs_codec.editing.presence import level_presence
from evogs_codec.errors import Fault, InputError, StreamError
from evogs_codec.io.files import PICTURE
from evogs_codec.io.interchange.scene_files import read_scene, scene_format
from evogs_codec.model.splats import SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Camera
    from evogs_codec.render.png import Real

__all__ = ["register"]

Commands = Any  # argparse's sub-parsers have no public type
Item = TypeVar("Item")
SHEET_VIEWS = 3  # columns of a contact sheet
BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}


def register(commands: Commands) -> None:
    """Add the commands to `evogs` (entry point of the group `evogs.commands`)."""
    _add(
        commands,
        "render",
        run_render,
        "Render a .ply, a stream or part of a stream to a PNG.",
        "  evogs render scene.evogs scene.png\n"
        "  evogs render scene.evogs sheet.png --sheet\n"
        "  evogs render scene.evogs mixed.png --box 0 0 0 1 1 1 --level 4 --outside 1\n"
        "  evogs render download.evogs.part so-far.png --partial\n"
        "  evogs render scene.ply view.png --camera cameras.json --view 3 --size 800",
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
    _need_numba()
    from evogs_codec.render import render
    from evogs_codec.render.png import write_png

    if args.sheet:
        _render_sheet(args)
        return
    if args.reference is not None:
        raise ValueError("--reference needs --sheet; `evogs psnr` compares two files")
    scene, part = _load_input(args)
    cameras = _cameras(args, scene)
    if not 0 <= args.view < len(cameras):
        raise ValueError(f"view {args.view} is not one of 0..{len(cameras) - 1}")
    picture = render(scene, cameras[args.view], BACKGROUNDS[args.background])
    write_png(args.output, picture, made_by=args.command)
    print(f"{shown(args.output)}: {len(scene):,} splats, 1 view{part}")


def _render_sheet(args: argparse.Namespace) -> None:
    """A row for each level, and one for the reference if there is one."""
    from evogs_codec.render import render
    from evogs_codec.render.png import contact_sheet, write_png

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
        scenes.append(_load_reference(args.reference, limits))
        n_bytes.append(args.reference.stat().st_size)
        names.append("reference")
    cameras = _cameras(args, scenes[len(cuts) - 1])
    chosen = cameras[:: max(1, len(cameras) // SHEET_VIEWS)][:SHEET_VIEWS]
    background = BACKGROUNDS[args.background]
    rows = [
        [render(scene, camera, background) for camera in chosen]
        for scene in _with_bar(scenes, "render")
    ]
    labels = [
        f"{name}: {len(scene):,} splats, {size:,} bytes"
        for name, scene, size in zip(names, scenes, n_bytes, strict=True)
    ]
    for number, row in enumerate(rows[:-1]):
        labels[number] += f", {_mean_psnr(row, rows[-1]):.1f} dB"
    write_png(args.output, contact_sheet(rows, labels=labels), made_by=args.command)
    n_splats = len(scenes[len(cuts) - 1])
    print(f"{shown(args.output)}: {n_splats:,} splats, {len(chosen)} views{part}")


def _mean_psnr(views: list[Real], others: list[Real]) -> float:
    from evogs_codec.render import psnr

    return float(np.mean([psnr(a, b) for a, b in zip(views, others, strict=True)]))


def run_psnr(args: argparse.Namespace) -> None:
    """`evogs psnr`."""
    _need_numba()
    from evogs_codec.render import psnr, render

    scene, part = _load_input(args)
    reference = _load_reference(args.reference, limits_of(args))
    background = BACKGROUNDS[args.background]
    found = [
        psnr(render(scene, camera, background), render(reference, camera, background))
        for camera in _with_bar(_cameras(args, reference), "psnr")
    ]
    mean, least = float(np.mean(found)), min(found)
    print(f"{mean:.2f} dB on average, {least:.2f} dB at least, over {len(found)} views{part}")


def _with_bar(items: list[Item], what: str) -> Iterator[Item]:
    """The items, with a bar on standard error for over two seconds of them, if a terminal."""
    bar: Iterator[Item] = iter(tqdm(items, desc=what, delay=2, disable=None, leave=False))
    return bar


def _need_numba() -> None:
    if find_spec("numba") is None:
        raise InputError("pictures need numba: pip install -e '.[render]'")


def _load_input(args: argparse.Namespace) -> tuple[SplatParams, str]:
    """The splats of a scene, or of a cut of a stream; and what is there of it, if `--partial`.

    The cut is one level, or one inside a box and another outside.
    """
    if scene_format(args.input):
        return _load_scene(args.input), ""
    data, directory = read_stream(args.input, limits_of(args))
    cut = Cut.full(directory) if args.level is None else Cut.of_level(directory, args.level)
    if getattr(args, "box", None) is not None:
        far = Cut.of_level(directory, 0 if args.outside is None else args.outside)
        near = tiles_meeting(directory, args.box)[:, None]
        cut = Cut(np.where(near, cut.steps, far.steps), cut.palette)
    part = ""
    if args.partial:
        cut = part_there(directory, len(data), cut, args.input)
        part = f", from {describe_part(directory, len(data))}"
    return decode(data, cut, directory=directory).leaves(), part


def _load_reference(path: Path, limits: dict[str, int] | None) -> SplatParams:
    """The splats of a scene, or of a whole stream.

    Raises:
        InputError: the file cannot be used; the message names it, and not the input.
    """
    if scene_format(path):
        return _load_scene(path)
    data, directory = read_stream(path, limits)
    try:
        return decode(data, directory=directory).leaves()
    except StreamError as error:
        cut_short = "; the reference must be whole" if error.fault is Fault.E_TRUNCATED else ""
        raise InputError(f"{path}: {error}{cut_short}") from error


def _load_scene(path: Path) -> SplatParams:
    splats = read_scene(path).splats
    n_bad = len(splats) - int(np.count_nonzero(splats.finite()))
    if n_bad:
        text = f"{path}: {n_bad:,} splats with NaN or infinite numbers are not drawn"
        warnings.warn(text, stacklevel=1)
    return splats


def _cameras(args: argparse.Namespace, scene: SplatParams) -> list[Camera]:
    """Those of the file, or 24 around the scene."""
    from evogs_codec.render import cameras_around, load_cameras
    from evogs_codec.render.viewpoints import SIZE

    size = SIZE if args.size is None else args.size
    if args.camera is not None:
        return [_fitted(camera, size) for camera in load_cameras(args.camera)]
    return cameras_around(scene, args.up, size)


def _fitted(camera: Camera, size: int) -> Camera:
    """The same view whose longer side has `size` pixels."""
    part = size / max(camera.width, camera.height)
    return camera.resized(*(max(1, round(part * side)) for side in (camera.width, camera.height)))


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
        add_output(parser, "OUT.png", PICTURE)
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
            "--view", type=int, default=0, metavar="I", help="number of the camera (default: 0)"
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
    parser.add_argument(
        "--camera", type=Path, metavar="FILE.json", help="cameras (default: a circle)"
    )
    parser.add_argument(
        "--size",
        type=int,
        metavar="PIXELS",
        help="longer side of a view (default: 400)",
    )
    parser.add_argument(
        "--up",
        choices=["x", "y", "z", "-x", "-y", "-z"],
        default="z",
        help="up axis of the scene, for the default cameras (default: z)",
    )
    parser.add_argument(
        "--background",
        choices=list(BACKGROUNDS),
        default="white",
        help="colour behind the splats (default: white)",
    )
    add_limits(parser)
    add_partial(parser)
