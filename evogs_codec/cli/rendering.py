"""`evogs render` and `evogs psnr`: pictures of scenes, streams and cuts of streams.

The rasterizer needs numba, an extra: it is imported when a command runs, so that all others work
without.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from tqdm import tqdm

from evogs_codec.cli.options import add_limits, add_output
from evogs_codec.common.printable import shown
from evogs_codec.decoding.cut import Cut, tiles_meeting
from evogs_codec.decoding.decode import decode
from evogs_codec.editing.extract import extract
from evogs_codec.errors import InputError
from evogs_codec.format.directory import read_directory
from evogs_codec.io.files import PICTURE
from evogs_codec.io.json_files import read_limits
from evogs_codec.io.ply import read_ply
from evogs_codec.model.splats import SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Camera
    from evogs_codec.render.png import Real
    from evogs_codec.render.views import Views

__all__ = ["around", "pictures", "register"]

Commands = Any  # argparse's sub-parsers have no public type
Item = TypeVar("Item")
N_ORBIT = 24
SIZE = 400  # pixels, of a view
SHEET_VIEWS = 3  # columns of a contact sheet
HELD_OUT = 5  # every 5th camera of a file judges what descends by the others
# Number, elevation and distance of the cameras of a circle, as of `around`; on none that it has.
RINGS = ((9, 0.05, 1.7), (11, 0.2, 2.4), (11, 0.5, 1.9), (9, 0.8, 2.2))
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
        "  evogs render scene.ply view.png --camera cameras.json --view 3 --size 800",
    )
    _add(
        commands,
        "psnr",
        run_psnr,
        f"Measure the PSNR of one scene against another, over {N_ORBIT} views around the second.",
        "  evogs psnr scene.evogs scene.ply\n  evogs psnr scene.evogs scene.ply --level 2",
    )


def run_render(args: argparse.Namespace) -> None:
    """`evogs render`."""
    _need_numba()
    from evogs_codec.render import render
    from evogs_codec.render.png import write_png

    limits = None if args.limits is None else read_limits(args.limits)
    if args.sheet:
        _render_sheet(args, limits)
        return
    if args.reference is not None:
        raise ValueError("--reference needs --sheet; `evogs psnr` compares two files")
    scene = _load(args.input, limits, level=args.level, box=args.box, outside=args.outside)
    cameras = _cameras(args, scene)
    if not 0 <= args.view < len(cameras):
        raise ValueError(f"view {args.view} is not one of 0..{len(cameras) - 1}")
    write_png(args.output, render(scene, cameras[args.view], BACKGROUNDS[args.background]))
    print(f"{shown(args.output)}: {len(scene):,} splats, 1 view")


def _render_sheet(args: argparse.Namespace, limits: dict[str, int] | None) -> None:
    """A row for each level, and one for the reference if there is one."""
    from evogs_codec.render import render
    from evogs_codec.render.png import contact_sheet, write_png

    data = args.input.read_bytes()
    directory = read_directory(memoryview(data), limits)
    cuts = [Cut.of_level(directory, level) for level in range(directory.n_levels)]
    scenes = [decode(data, cut, limits=limits).leaves() for cut in cuts]
    n_bytes = [len(extract(data, cut)) for cut in cuts]
    names = [f"level {level}" for level in range(len(cuts))]
    if args.reference is not None:
        scenes.append(_load(args.reference, limits))
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
    write_png(args.output, contact_sheet(rows, labels=labels))
    print(f"{shown(args.output)}: {len(scenes[len(cuts) - 1]):,} splats, {len(chosen)} views")


def _mean_psnr(views: list[Real], others: list[Real]) -> float:
    from evogs_codec.render import psnr

    return float(np.mean([psnr(a, b) for a, b in zip(views, others, strict=True)]))


def run_psnr(args: argparse.Namespace) -> None:
    """`evogs psnr`."""
    _need_numba()
    from evogs_codec.render import psnr, render

    limits = None if args.limits is None else read_limits(args.limits)
    scene = _load(args.input, limits, level=args.level)
    reference = _load(args.reference, limits)
    background = BACKGROUNDS[args.background]
    found = [
        psnr(render(scene, camera, background), render(reference, camera, background))
        for camera in _with_bar(_cameras(args, reference), "psnr")
    ]
    mean, least = float(np.mean(found)), min(found)
    print(f"{mean:.2f} dB on average, {least:.2f} dB at least, over {len(found)} views")


def _with_bar(items: list[Item], what: str) -> Iterator[Item]:
    """The items, with a bar on standard error for over two seconds of them, if a terminal."""
    bar: Iterator[Item] = iter(tqdm(items, desc=what, delay=2, disable=None, leave=False))
    return bar


def _need_numba() -> None:
    if find_spec("numba") is None:
        raise InputError("pictures need numba: pip install -e '.[render]'")


def _load(
    path: Path,
    limits: dict[str, int] | None,
    *,
    level: int | None = None,
    box: list[float] | None = None,
    outside: int | None = None,
) -> SplatParams:
    """The splats of a .ply, or of a cut of a stream: one level inside a box, another outside."""
    with path.open("rb") as file:
        if file.read(3) == b"ply":
            splats = read_ply(path)
            n_bad = len(splats) - int(np.count_nonzero(splats.finite()))
            if n_bad:
                text = f"{path}: {n_bad:,} splats with NaN or infinite numbers are not drawn"
                warnings.warn(text, stacklevel=1)
            return splats
    data = path.read_bytes()
    directory = read_directory(memoryview(data), limits)
    cut = Cut.full(directory) if level is None else Cut.of_level(directory, level)
    if box is not None:
        far = Cut.of_level(directory, 0 if outside is None else outside)
        near = tiles_meeting(directory, box)[:, None]
        cut = Cut(np.where(near, cut.steps, far.steps), cut.palette)
    return decode(data, cut).leaves()


def _cameras(args: argparse.Namespace, scene: SplatParams) -> list[Camera]:
    """Those of the file, or `N_ORBIT` around the scene."""
    if args.camera is not None:
        return [_fitted(camera, args.size) for camera in cameras_of(args.camera)]
    return around(scene, args.up, args.size)


def _fitted(camera: Camera, size: int) -> Camera:
    """The same view whose longer side has `size` pixels."""
    part = size / max(camera.width, camera.height)
    return camera.resized(*(max(1, round(part * side)) for side in (camera.width, camera.height)))


def around(
    scene: SplatParams,
    up: str,
    size: int,
    *,
    n: int = N_ORBIT,
    elevation: float = 0.35,
    distance: float = 2.0,
) -> list[Camera]:
    """Cameras on a circle around the bulk of a scene.

    Args:
        scene: what they look at.
        up: an axis, perhaps with a sign.
        size: pixels.
        n: how many.
        elevation: radians above the middle.
        distance: from the middle, in diagonals of the bulk, or of a splat where all are in a place.
    """
    from evogs_codec.render import orbit

    means = scene.means[np.isfinite(scene.means).all(axis=1)].astype(np.float64)
    if not len(means):
        raise ValueError("the scene is empty: name cameras with --camera")
    low, high = np.percentile(means, (20, 80), axis=0)
    bulk = float(np.linalg.norm(high - low))
    if bulk == 0:
        bulk = math.exp(float(np.clip(np.median(scene.log_scales), -30, 30)))
    sign = -1.0 if up.startswith("-") else 1.0
    return orbit(
        n,
        (low + high) / 2,
        radius=distance * bulk,
        elevation=elevation,
        up=tuple(sign * np.eye(3)["xyz".index(up[-1])]),
        width=size,
        height=size,
        fov_x=math.radians(45),
    )


def cameras_of(path: Path) -> list[Camera]:
    """The cameras of a file; an InputError where it has none, or an impossible one."""
    from evogs_codec.render import load_cameras

    return load_cameras(path)


def rings(scene: SplatParams, up: str, times: int = 1) -> list[Camera]:
    """`times` 40 cameras around the bulk of a scene, at four heights and distances."""
    return [
        camera
        for n, elevation, distance in RINGS
        for camera in around(scene, up, SIZE, n=times * n, elevation=elevation, distance=distance)
    ]


def pictures(
    scene: SplatParams,
    camera: Path | None,
    up: str,
    n_views: int | None = None,
    *,
    polish: bool = False,
) -> Views | None:
    """Views by which `evogs encode` aims; None without numba (entry point of `evogs.pictures`).

    Args:
        scene: what they show.
        camera: a file of cameras, or None for an orbit.
        up: axis of the orbit.
        n_views: at most so many of them.
        polish: with others beside them, which polishing goes by.

    Raises:
        InputError: the file has a single camera, and polishing needs others.
    """
    if find_spec("numba") is None:
        return None
    from evogs_codec.render.views import Views

    cameras = around(scene, up, SIZE) if camera is None else cameras_of(camera)
    others: list[Camera] = []
    if polish and camera is None:
        others = rings(scene, up, 2)
    elif polish:
        others = [other for k, other in enumerate(cameras) if k % HELD_OUT]
        cameras = cameras[::HELD_OUT]
        if not others:
            raise InputError(f"{camera}: 1 camera, expected at least 2")
    every = 1 if n_views is None else -(-len(cameras) // n_views)
    return Views(scene, cameras[::every], others=others)


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
    parser.add_argument("input", type=Path, metavar="IN", help="a .ply or .evogs file")
    if name == "psnr":
        parser.add_argument(
            "reference", type=Path, metavar="REFERENCE", help="the scene to compare with"
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
            type=Path,
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
        default=SIZE,
        metavar="PIXELS",
        help=f"longer side of a view (default: {SIZE})",
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
