"""`evogs encode --report`: the page that says what was kept and what it cost."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from evogs_codec.cli.looking import fitted
from evogs_codec.cli.terminal import progress_bar
from evogs_codec.common.printable import shown
from evogs_codec.common.version import __version__
from evogs_codec.io.files import write_atomic
from evogs_codec.io.interchange.scene_files import size_of_scene
from evogs_codec.model.splats import SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Up

__all__ = ["write_report"]


def write_report(
    args: argparse.Namespace, scene: SplatParams, data: bytes, up: Up | None, notes: list[str]
) -> None:
    """Write the page of `--report`, if there is to be one.

    Args:
        args: of `evogs encode`.
        scene: N splats that were encoded.
        data: the stream.
        up: of the default views, if it was found out.
        notes: warnings so far.
    """
    if args.page is None:
        return
    if not len(scene):
        notes = [*notes, "there is no splat to look at"]
    from evogs_codec.comparison.report import Encoded, report_page

    source, name = args.input.name, args.output.name
    of = Encoded(source, size_of_scene(args.input), scene, name, data, notes)
    cameras, views = _cameras(args, scene, up)
    with progress_bar() as progress:
        page = report_page(
            of,
            cameras,
            views=views,
            command=args.command,
            made_with=f"evogs {__version__}: evogs encode {source} {name} --report",
            progress=progress,
        )
    write_atomic(args.page, page)


def _cameras(
    args: argparse.Namespace, scene: SplatParams, up: Up | None
) -> tuple[list[Camera], str]:
    """Those that the stream was judged by, and what they are."""
    from evogs_codec.render import Camera, cameras_around, load_cameras
    from evogs_codec.render.viewpoints import SIZE

    if args.camera is not None:
        found = [fitted(camera, SIZE) for camera in load_cameras(args.camera)]
        return found, f"views of {shown(args.camera.name)}"
    if not len(scene):
        return [Camera.look_at((0, -1, 0), (0, 0, 0), width=SIZE, height=SIZE, fov_x=1.0)], "view"
    said = "" if up is None else f", {up}"
    return cameras_around(scene, None if up is None else up.vector), f"views on a circle{said}"
