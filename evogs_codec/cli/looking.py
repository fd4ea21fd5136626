"""Options that say how a scene is looked at: cameras, what is up, size and background.

They are the same for targets of `encode` and for `render`, `psnr` and `compare`.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from evogs_codec.cli.argument_types import number
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.scene_files import Scene
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Up
    from evogs_codec.render.views import Colour

__all__ = [
    "AXES",
    "add_camera",
    "add_look",
    "background_of",
    "cameras_of",
    "cameras_to_show",
    "colour",
    "find_up",
    "fitted",
    "need_numba",
    "on_background",
    "up_asked",
    "up_given",
    "without_refuted_up",
]

AXES = ("x", "y", "z", "-x", "-y", "-z")
CAMERAS_IN = (
    "cameras of a JSON file (of `evogs`, transforms.json, a camera path of nerfstudio, cameras.json"
    " of a trainer) or of a COLMAP folder"
)
BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "grey": (0.5, 0.5, 0.5), "black": (0.0, 0.0, 0.0)}
MAX_SIZE = 1 << 14  # pixels of a side


# --- options --------------------------------------------------------------------------------------


def add_camera(parser: argparse.ArgumentParser, uses: str = "") -> None:
    """`--camera` and `--up`.

    Args:
        parser: of a command.
        uses: what they are for.
    """
    parser.add_argument(
        "--camera",
        type=Path,
        metavar="CAMERAS",
        help=f"{CAMERAS_IN}{f', for {uses}' if uses else ''} (default: a circle around the scene)",
    )
    parser.add_argument(
        "--up",
        type=axis_or_cameras,
        metavar="AXIS|CAMERAS",
        help="what is up in the default views: x, y, z, -x, -y or -z, or as the cameras of a file"
        " were held (default: what the file says, or else the splats show, or else z)",
    )


def add_look(parser: argparse.ArgumentParser, size: str) -> None:
    """`add_camera`, `--size` and `--background`; `size` says the default size, in words."""
    add_camera(parser)
    parser.add_argument(
        "--size",
        type=number(int, 1, MAX_SIZE),
        metavar="PIXELS",
        help=f"longer side of a view (default: {size})",
    )
    parser.add_argument(
        "--background",
        type=colour,
        metavar="COLOUR",
        help=f"colour behind the splats: {', '.join(BACKGROUNDS)}, or #rrggbb (default: white, or"
        " black if nearly all splats are white)",
    )


def axis_or_cameras(text: str) -> str | Path:
    """An argparse type: an axis, or the path of a file or folder of cameras.

    Raises:
        argparse.ArgumentTypeError: the text is neither.
    """
    name = text.removeprefix("+")
    if name in AXES:
        return name
    if not text or not Path(text).exists():
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(AXES)}, and no file")
    return Path(text)


def colour(text: str) -> Colour:
    """An argparse type: a name of `BACKGROUNDS`, or `#rrggbb`.

    Raises:
        argparse.ArgumentTypeError: the text is neither.
    """
    if text in BACKGROUNDS:
        return BACKGROUNDS[text]
    found = re.fullmatch(r"#?([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})", text)
    if found is None:
        names = ", ".join(BACKGROUNDS)
        raise argparse.ArgumentTypeError(f"{text!r} is no colour: try {names} or #a0b0c0")
    red, green, blue = (int(digits, 16) / 255 for digits in found.groups())
    return red, green, blue


# --- what they ask for ----------------------------------------------------------------------------


def need_numba() -> None:
    """Refuse a command that renders where nothing can.

    Raises:
        InputError: numba is missing.
    """
    if find_spec("numba") is None:
        raise InputError("pictures need numba: pip install -e '.[render]'")


def background_of(args: argparse.Namespace, scene: SplatParams) -> Colour:
    """The colour of `--background`, or else the one on which a scene shows."""
    from evogs_codec.render.framing import background_for

    return background_for(scene) if args.background is None else args.background


def on_background(args: argparse.Namespace, scene: SplatParams) -> str:
    """What to say of the background that nobody named: nothing of white."""
    from evogs_codec.render.framing import BLACK

    is_found = args.background is None and background_of(args, scene) == BLACK
    return ", on black: the splats are white" if is_found else ""


def cameras_of(
    args: argparse.Namespace, scene: SplatParams, info: SceneInfo, *, size: int
) -> tuple[list[Camera], Up | None]:
    """What figures are measured over: the cameras of `--camera`, or 24 around a scene.

    The default camera of a stream is not among them: figures of two files have the same views.

    Args:
        args: of a command with `add_look`.
        scene: what they look at.
        info: what its file says of it.
        size: of the longer side of a view, pixels, if `--size` does not say.

    Returns:
        The cameras, and what is up, if that was to be found out.
    """
    from evogs_codec.render import cameras_around, load_cameras

    size = size if args.size is None else args.size
    if args.camera is not None:
        return [fitted(camera, size) for camera in load_cameras(args.camera)], None
    up = up_given(args, scene, info)
    return cameras_around(scene, up.vector, size), up


def cameras_to_show(
    args: argparse.Namespace, scene: SplatParams, info: SceneInfo, *, size: int
) -> tuple[list[Camera], Up | None, bool]:
    """`cameras_of` for pictures: the default camera of a scene, if it has one, comes before the 24.

    Returns:
        The cameras, what is up, and whether the first is the default camera.
    """
    from evogs_codec.render.default_camera import default_camera

    cameras, up = cameras_of(args, scene, info, size=size)
    if up is None:
        return cameras, up, False
    own = default_camera(info, up.vector, cameras[0].width)
    return (cameras, up, False) if own is None else ([own, *cameras], up, True)


def up_given(args: argparse.Namespace, scene: SplatParams, info: SceneInfo) -> Up:
    """What `--up` says, or else the file, or else the splats."""
    from evogs_codec.render import Up, load_cameras, up_of

    if isinstance(args.up, Path):
        return up_of(scene, None, load_cameras(args.up))
    if args.up is not None:
        return Up.of(args.up, "as asked for")
    return up_of(scene, info)


def find_up(args: argparse.Namespace, scene: SplatParams, info: SceneInfo) -> Up | None:
    """`up_given`, put in place of what was given; None if no default view is to be rendered."""
    if args.camera is not None or find_spec("numba") is None:
        args.up = None
        return None
    if getattr(args, "max_error", None) and args.page is None:  # counts numbers, not pictures
        args.up = None
        return None
    up = up_given(args, scene, info)
    args.up = up.vector
    return up


def without_refuted_up(scene: Scene) -> SceneInfo:
    """What a file says, without an axis that is only assumed where the splats show another."""
    axis = scene.info.up_axis
    if not axis or not scene.up_is_assumed or find_spec("numba") is None:
        return scene.info
    from evogs_codec.render.up import said_by, shown_by

    ground = shown_by(scene.splats)
    if ground is None or ground.name == said_by(scene.info):
        return scene.info
    return replace(scene.info, up_axis=0)


def up_asked(args: argparse.Namespace) -> Up | None:
    """What `--up` says; None if it says nothing, or where nothing can be rendered."""
    if args.up is None or find_spec("numba") is None:
        return None
    from evogs_codec.render import Up, load_cameras, up_of_cameras

    if isinstance(args.up, Path):
        return Up.of(up_of_cameras(load_cameras(args.up)), "as the cameras were held")
    return Up.of(args.up, "as asked for")


def fitted(camera: Camera, size: int) -> Camera:
    """The same view whose longer side has `size` pixels."""
    part = size / max(camera.width, camera.height)
    return camera.resized(*(max(1, round(part * side)) for side in (camera.width, camera.height)))
