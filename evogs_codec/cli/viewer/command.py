"""`evogs view`: look at a scene in a browser."""

from __future__ import annotations

import argparse
import re
import tempfile
import webbrowser
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote

from evogs_codec.cli.argument_types import number
from evogs_codec.cli.encode_and_lift import encode_file
from evogs_codec.cli.terminal import complain, progress_bar
from evogs_codec.cli.viewer.scenes import Folder, NoScenes, OneFile, Scenes
from evogs_codec.cli.viewer.server import LOOPBACK, SCENE_PATH, Server, address_of, page_files
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.files import KIND_BYTES, STREAM, kind_of

__all__ = ["add_view"]

HELP = "Look at a scene in a browser, which shows it while it arrives."
EXAMPLES = """examples:
  evogs view scene.evogs
  evogs view scene.ply                      # encoded first, to a temporary file
  evogs view scenes/                        # a list of the streams in a folder
  evogs view https://example.org/scene.evogs
  evogs view scene.evogs --no-browser --host 0.0.0.0 --port 8000    # for other machines, too"""
URL = re.compile(r"https?://", re.IGNORECASE)


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
        "scene", metavar="FILE|FOLDER|URL", help="a stream, a 3DGS .ply, a .tree.npz, or streams"
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
    parser.set_defaults(run=run_view)


def run_view(args: argparse.Namespace) -> None:
    """`evogs view`: serves until it is interrupted."""
    page = page_files()
    if "index.html" not in page:
        raise InputError("the page of the viewer is not there: `make web` builds it")
    with ExitStack() as stack:
        scenes, start = _scenes(args.scene, stack)
        server = stack.enter_context(Server((args.host, args.port), page, scenes))
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


def _scenes(given: str, stack: ExitStack) -> tuple[Scenes, str]:
    """What to serve, and what to open of it: an address without that of the server."""
    if URL.match(given):
        return NoScenes(), f"?src={quote(given, safe='')}"
    path = Path(given)
    if path.is_dir():
        folder = Folder(path)
        names = folder.names()
        if not names:
            raise InputError(f"{path}: no .evogs file is in this folder")
        return folder, address_of(names[0]) if len(names) == 1 else SCENE_PATH.removeprefix("/")
    with path.open("rb") as file:
        is_stream = kind_of(file.read(KIND_BYTES)) is STREAM
    if not is_stream:
        path = _encoded(path, stack)
    return OneFile(path, path.name), address_of(path.name)


def _encoded(path: Path, stack: ExitStack) -> Path:
    """The stream of a scene or of a tree, in a folder that goes with the command."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="evogs-view-")))
    with progress_bar() as progress:
        data = encode_file(path, progress)
    stream = folder / f"{path.name.removesuffix('.ply').removesuffix('.tree.npz')}.evogs"
    stream.write_bytes(data)
    print(f"{shown(path)}: encoded, {len(data):,} bytes")
    return stream
