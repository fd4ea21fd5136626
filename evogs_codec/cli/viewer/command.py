"""`evogs view` and `evogs export-html`: look at a scene in a browser."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote

from evogs_codec.cli.argument_types import number, path_or_url
from evogs_codec.cli.common_options import SCENES_IN, add_effort, add_output
from evogs_codec.cli.remote_files import fetched
from evogs_codec.cli.terminal import complain
from evogs_codec.cli.tilesets import is_tileset
from evogs_codec.cli.viewer.given import (
    folder_of_streams,
    is_of_web,
    is_stream,
    newly_encoded,
    stream_of,
)
from evogs_codec.cli.viewer.scenes import NoScenes, OneFile, Scenes, TilesetFolder
from evogs_codec.cli.viewer.server import LOOPBACK, SCENE_PATH, Server, address_of, page_files
from evogs_codec.cli.viewer.standalone import one_page
from evogs_codec.cli.viewer.upright import shown_axis
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.format.directory import read_directory
from evogs_codec.io.files import PAGE, write_atomic
from evogs_codec.io.interchange.scene_files import scene_format
from evogs_codec.stores.urls import Url, is_url
from evogs_codec.tileset import Place, Tileset

__all__ = ["add_export", "add_view"]

HELP = "Look at a scene in a browser, which shows it while it arrives."
EXAMPLES = """examples:
  evogs view scene.evogs
  evogs view scene.ply                      # encoded first, to a temporary file; also .spz, .sog
  evogs view scene.ply --effort default     # encoded as by `evogs encode`, in about twice the time
  evogs view scenes/                        # a list of the streams in a folder
  evogs view city/tileset.json              # a tileset, file by file
  evogs view https://example.org/scene.evogs
  evogs view s3://bucket/scene.evogs        # fetched first, to a temporary file
  evogs view scene.evogs --no-browser --host 0.0.0.0 --port 8000    # for other machines, too"""
EXPORT_HELP = "Write a page that holds a scene and its viewer, and needs no server."
EXPORT_EXAMPLES = """examples:
  evogs export-html scene.evogs scene.html   # open it in a browser, send it, put it anywhere
  evogs export-html scene.ply scene.html     # encoded first; also .spz, .sog, .splat, .glb
  evogs export-html scene.ply scene.html --effort default    # as by `evogs encode`: closer"""


def add_view(commands: Any) -> None:  # noqa: ANN401 - argparse's sub-parsers have no public type
    """Add the command to `evogs`."""
    parser = commands.add_parser(
        "view",
        help=HELP,
        description=HELP,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scene",
        metavar="FILE|FOLDER|URL",
        help=f"a stream, {SCENES_IN}, a .tree.npz, streams, or a tileset",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="the address to listen on (default: 127.0.0.1, which only this machine reaches)",
    )
    parser.add_argument(
        "--port",
        type=number(int, 0, 65535),
        default=0,
        help="the port to listen on (default: one that is free)",
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    add_effort(parser, "fast")
    parser.set_defaults(run=run_view)


def add_export(commands: Any) -> None:  # noqa: ANN401 - argparse's sub-parsers have no public type
    """Add the command to `evogs`."""
    parser = commands.add_parser(
        "export-html",
        help=EXPORT_HELP,
        description=EXPORT_HELP,
        epilog=EXPORT_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scene",
        type=lambda given: given if is_of_web(given) else path_or_url(given),
        metavar="FILE|FOLDER|URL",
        help=f"a stream, {SCENES_IN}, a .tree.npz, or a folder with one stream",
    )
    add_output(parser, "OUT.html", PAGE)
    add_effort(parser, "fast")
    parser.set_defaults(run=run_export)


def run_view(args: argparse.Namespace) -> None:
    """`evogs view`: serves until it is interrupted."""
    page = _built_page()
    with ExitStack() as stack:
        # A port that is taken is told before a scene is encoded.
        server = stack.enter_context(_listening(args.host, args.port, page))
        server.scenes, start = _scenes(args.scene, args.effort, stack)
        if args.host not in LOOPBACK:
            complain(f"everyone who reaches {args.host} can read what is served")
        address = server.url + start
        print(f"{address}\nCtrl-C ends it", flush=True)
        if not args.no_browser:
            webbrowser.open(address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print(flush=True)


def run_export(args: argparse.Namespace) -> None:
    """`evogs export-html`."""
    page = _built_page()
    name, data = stream_of(args.scene, args.effort)
    read_directory(data)  # a page with what is no stream would be of no use
    exported = one_page(page, name, data, shown_axis(data))
    write_atomic(args.output, exported)
    print(f"{shown(args.output)}: {len(exported):,} bytes, for a stream of {len(data):,}")


def _listening(host: str, port: int, page: dict[str, bytes]) -> Server:
    """A server that has no scenes yet."""
    try:
        return Server((host, port), page, NoScenes())
    except OSError as error:
        reason = error.strerror or error
        advice = "; choose another port, or leave --port out" if port else ""
        raise InputError(f"cannot listen on {host}, port {port}: {reason}{advice}") from error


def _built_page() -> dict[str, bytes]:
    page = page_files()
    if "index.html" not in page:
        raise InputError("the page of the viewer is not there: `make web` builds it")
    return page


def _scenes(given: str, effort: str | int | None, stack: ExitStack) -> tuple[Scenes, str]:
    """What to serve, and what to open of it: an address without that of the server."""
    if is_of_web(given):
        return NoScenes(), f"?src={quote(given, safe='')}"
    path = fetched(Url.parse(given), stack) if is_url(given) else Path(given)
    of_sog = scene_format(path) == "sog"
    if not of_sog and is_tileset(path) and not is_url(given):
        with Place(path) as place:
            files = Tileset(place).files()
        root = path / "tileset.json" if path.is_dir() else path
        return TilesetFolder(root, files), address_of(root.name)
    if not of_sog and path.is_dir():
        folder, names = folder_of_streams(path)
        return folder, address_of(names[0]) if len(names) == 1 else SCENE_PATH.removeprefix("/")
    if of_sog or not is_stream(path):
        path = _encoded(path, effort, stack)
    axis = shown_axis(path.read_bytes())
    return OneFile(path, path.name), address_of(path.name) + ("" if axis is None else f"&up={axis}")


def _encoded(path: Path, effort: str | int | None, stack: ExitStack) -> Path:
    """The stream of a scene or of a tree, in a folder that goes with the command."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="evogs-view-")))
    name, data = newly_encoded(path, effort)
    stream = folder / name
    stream.write_bytes(data)
    return stream
