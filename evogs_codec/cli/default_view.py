"""`--view` of `evogs encode`: the default camera that a stream gets."""

from __future__ import annotations

import argparse
from dataclasses import replace
from importlib.util import find_spec

from evogs_codec.cli.looking import need_numba, up_given
from evogs_codec.errors import InputError
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.viewpoint import CAMERA, default_viewpoint

__all__ = ["add_view_option", "with_default_camera", "with_opening_view"]

NONE = "none"


def add_view_option(parser: argparse.ArgumentParser) -> None:
    """`--view`."""
    parser.add_argument(
        "--view",
        type=_number_or_none,
        metavar="I|none",
        help="the default camera of the stream, in which viewers open it: number of a camera of"
        " --camera, or else of the 24 default views (default: the first of --camera, or none)",
    )


def _number_or_none(text: str) -> int | str:
    """An argparse type.

    Raises:
        argparse.ArgumentTypeError: the text is neither.
    """
    if text == NONE:
        return text
    if not text.isdecimal() or len(text) > 9:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of a camera, and not 'none'")
    return int(text)


def with_default_camera(
    args: argparse.Namespace, splats: SplatParams, info: SceneInfo
) -> SceneInfo:
    """What is said of a scene, with the default camera that the options ask for.

    Args:
        args: of `encode`, with `up` as it was given.
        splats: the scene.
        info: what else is said, perhaps a camera of the file, which options replace.

    Raises:
        InputError: there is no such camera.
    """
    text = dict(info.text)
    if args.view == NONE:
        text.pop(CAMERA, None)
        return replace(info, text=text)
    if args.view is None and (args.camera is None or find_spec("numba") is None):
        return info
    need_numba()
    from evogs_codec.render import cameras_around, load_cameras
    from evogs_codec.render.default_camera import viewpoint_of
    from evogs_codec.render.framing import focus_of

    if not len(splats):
        return info
    if args.camera is not None:
        cameras = load_cameras(args.camera)
    else:
        cameras = cameras_around(splats, up_given(args, splats, info).vector)
    number = args.view or 0
    if number >= len(cameras):
        raise InputError(f"--view: camera {number} is not one of 0..{len(cameras) - 1}")
    text[CAMERA] = str(viewpoint_of(cameras[number], focus_of(splats).middle))
    return replace(info, text=text)


def with_opening_view(splats: SplatParams, info: SceneInfo) -> SceneInfo:
    """What is said of a scene, with the view that `evogs render` shows if it names no camera.

    Without numba, and of an empty scene, nothing is added.
    """
    known = default_viewpoint(info.text) is not None
    if known or not len(splats) or find_spec("numba") is None:
        return info
    from evogs_codec.render import cameras_around, up_of
    from evogs_codec.render.default_camera import viewpoint_of
    from evogs_codec.render.framing import focus_of
    from evogs_codec.render.front import most_detailed

    cameras = cameras_around(splats, up_of(splats, info).vector)
    front = cameras[most_detailed(splats, cameras)]
    return replace(
        info, text={**info.text, CAMERA: str(viewpoint_of(front, focus_of(splats).middle))}
    )
