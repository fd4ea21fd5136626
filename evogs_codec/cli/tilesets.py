"""`evogs tileset`, and what other commands do with a tileset."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from evogs_codec.cli.argument_types import number, path_or_url
from evogs_codec.cli.common_options import SCENES_IN, add_effort
from evogs_codec.cli.encode_and_lift import scene_info
from evogs_codec.cli.large_scenes import add_engine, engine_of, files_of
from evogs_codec.cli.looking import axis_or_cameras, up_asked
from evogs_codec.cli.options import Commands, add_metadata, command_parser
from evogs_codec.cli.reports import fetched_text
from evogs_codec.cli.terminal import complain, progress_bar
from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.interchange.scene_files import write_scene
from evogs_codec.jobs import JobOptions
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.stores.remote_file import RemoteFile
from evogs_codec.tileset import TilesetOptions, write_tileset
from evogs_codec.tileset.check import check_tileset
from evogs_codec.tileset.places import Place
from evogs_codec.tileset.read import Tile, Tileset
from evogs_codec.tileset.take import take
from evogs_codec.tileset.write import N_LEVELS, check_folder

__all__ = [
    "add_tileset",
    "decode_tileset",
    "info_tileset",
    "is_tileset",
    "validate_tileset",
]

OF_STREAMS = ("level", "max_bytes", "partial", "verify", "limits")  # options for one file


def add_tileset(commands: Commands) -> None:
    """Add the command to `evogs`."""
    parser = command_parser(
        commands,
        "tileset",
        run_tileset,
        "Make a folder of a large scene: an OGC 3D Tiles tileset, whose files are streams.",
        "  evogs tileset city.ply city\n"
        "  evogs tileset north.ply south.ply city --workers 8 --up z\n"
        "  evogs tileset scans city --crs EPSG:32632 --unit metre\n"
        "  evogs tileset city.ply city --resume",
    )
    parser.add_argument(
        "input", type=path_or_url, metavar="IN", help=f"{SCENES_IN}; or a folder of them"
    )
    parser.add_argument(
        "others", type=path_or_url, nargs="*", metavar="IN", help="other parts of the same scene"
    )
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="to make; it is not there, or empty"
    )
    parser.add_argument(
        "--per-file",
        type=number(int, 1, 1 << 22),
        default=TilesetOptions.per_file,
        metavar="N",
        help="splats of a file, about (default: %(default)s)",
    )
    parser.add_argument(
        "--overview",
        type=number(int, 1, 1 << 20),
        default=TilesetOptions.overview,
        metavar="N",
        help="splats of the overview of several files, at most (default: %(default)s)",
    )
    parser.add_argument(
        "--content",
        choices=("evogs", "glb"),
        default=TilesetOptions.content,
        help="streams (default), or glTF with KHR_gaussian_splatting for clients that know no"
        " streams: one level, several times as large",
    )
    parser.add_argument(
        "--crs", metavar="TEXT", help="of the positions: an EPSG code (EPSG:4978), or WKT"
    )
    parser.add_argument(
        "--transform",
        type=number(float, -1e30, 1e30),
        nargs=16,
        metavar="M",
        help="matrix, row by row, from the positions to those of the CRS, where z is up (default:"
        " the turn that brings what is up to z, and the unit to metres)",
    )
    parser.add_argument(
        "--levels",
        type=number(int, 1, 64),
        default=N_LEVELS,
        metavar="N",
        help="of the tree of each file (default: %(default)s)",
    )
    add_effort(parser)
    parser.add_argument(
        "--up",
        type=axis_or_cameras,
        metavar="AXIS|CAMERAS",
        help="what is up: x, y, z, -x, -y or -z, or as the cameras of a file were held (default:"
        " what the file says, or else what the splats show)",
    )
    parser.add_argument(
        "--drop-invalid", action="store_true", help="drop splats that have a NaN or an infinity"
    )
    add_metadata(parser)
    add_engine(parser.add_argument_group("jobs", "The files are the same wherever jobs run."))
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run_tileset(args: argparse.Namespace) -> None:
    """`evogs tileset`."""
    check_folder(args.folder)
    engine = engine_of(args)
    files = files_of([args.input, *args.others])
    info = scene_info(args, SplatFiles(files).info)
    asked = up_asked(args)
    job = JobOptions(
        levels=args.levels,
        up=None if asked is None else asked.vector,
        effort=args.effort or JobOptions.effort,
        drop_invalid=args.drop_invalid,
        info=info,
    )
    transform = None if args.transform is None else tuple(args.transform)
    options = TilesetOptions(args.per_file, args.overview, job, args.crs, transform, args.content)
    with progress_bar() as progress:
        root, found_up = write_tileset(
            files, args.folder, options, engine=engine, resume=args.resume, progress=progress
        )
    nodes = list(root.all())
    n_json = sum(path.stat().st_size for path in args.folder.rglob("*.json"))
    n_bytes = n_json + sum(node.n_bytes for node in nodes)
    if args.json:
        found = {
            "folder": str(args.folder),
            "splats": root.weight,
            "files": len(nodes),
            "bytes": n_bytes,
            "json_bytes": n_json,
        }
        print(json.dumps(found))
        return
    each = n_bytes / max(root.weight, 1)
    said = "1 file" if len(nodes) == 1 else f"{len(nodes):,} files"
    print(
        f"{shown(args.folder)}: {root.weight:,} splats in {said}, {n_bytes:,} bytes,"
        f" {each:.2f} a splat"
    )
    print(f"views: {asked or found_up}")


def is_tileset(given: object) -> bool:
    """Whether a path, or a URL that is read, names a tileset."""
    if isinstance(given, RemoteFile):
        return given.url.path.lower().endswith(".json")
    if not isinstance(given, Path):
        return False
    return (given / "tileset.json").is_file() or given.suffix.lower() == ".json"


def info_tileset(args: argparse.Namespace) -> None:
    """`evogs info` of a tileset: its tree."""
    with Place(args.input) as place:
        tileset = Tileset(place)
        tiles = list(tileset.all())
        contents = [tile for tile in tiles if tile.name is not None]
        found: dict[str, Any] = {
            "splats": tileset.extras.get("splats"),
            "files": len(contents),
            "bytes": sum(tile.n_bytes or 0 for tile in contents),
            "json_files": tileset.n_json_files,
            "json_bytes": tileset.n_json,
            "crs": tileset.extras.get("crs"),
            "origin": tileset.extras.get("origin"),
            "depth": 1 + max(tile.depth for tile in tiles),
        }
        if place.is_remote:
            found |= {"bytes_fetched": place.n_fetched, "requests": place.n_requests}
        if args.json:
            found["tiles"] = [_figures(tile) for tile in tiles]
            print(json.dumps(found, indent=2))
            return
        print(
            f"{shown(place)}: {len(contents):,} files, {found['bytes']:,} bytes,"
            f" {found['json_bytes']:,} bytes of JSON in {found['json_files']:,}"
        )
        if isinstance(found["crs"], str):
            print(f"crs: {shown(found['crs'])}")
        print(f"\n{'splats':>12} {'bytes':>14} {'error':>10}  file")
        for tile in tiles:
            indent = "  " * tile.depth
            numbers = f"{tile.n_splats or 0:12,} {tile.n_bytes or 0:14,} {tile.error:10.4g}"
            print(f"{numbers}  {indent}{shown(tile.name or '-')}")


def validate_tileset(args: argparse.Namespace) -> int:
    """`evogs validate` of a tileset: of all its files."""
    with Place(args.input) as place, progress_bar() as progress:
        found = check_tileset(Tileset(place), progress)
    if args.json:
        said = {
            "valid": not found.problems,
            "files": found.n_files,
            "splats": found.n_leaf_splats,
            "digests": found.n_digests,
            "problems": found.problems,
        }
        print(json.dumps(said))
    elif found.problems:
        for problem in found.problems:
            complain(f"{place}: {problem}")
    else:
        print(
            f"{shown(place)}: valid, {found.n_leaf_splats:,} splats in {found.n_files:,} files,"
            f" {found.n_digests:,} digests match"
        )
    return 1 if found.problems else 0


def decode_tileset(args: argparse.Namespace) -> None:
    """`evogs decode` of a tileset."""
    given = [f"--{name.replace('_', '-')}" for name in OF_STREAMS if getattr(args, name)]
    if given:
        raise InputError(f"{', '.join(given)} is for one stream: of a tileset --box, --max-splats")
    with Place(args.input) as place, progress_bar() as progress:
        output = args.output
        if isinstance(output, Path) and output.exists() and place.holds(output):
            raise InputError(f"{output}: is in the folder of the tileset; name another output")
        found = take(
            Tileset(place),
            box=args.box,
            max_splats=args.max_splats,
            sh_degree=args.sh_degree,
            progress=progress,
        )
        if place.is_remote:
            complain(f"{place}: fetched {fetched_text(place.n_fetched, place.n_requests)}")
    degree = write_scene(args.output, found.splats, found.info, made_by=args.command)
    read = f"{found.n_bytes:,} bytes of {found.n_files:,} files"
    print(f"{shown(args.output)}: {len(found.splats):,} splats, SH degree {degree}, from {read}")
    if found.origin.any():
        x, y, z = found.origin.tolist()
        print(f"positions are from {x:.15g} {y:.15g} {z:.15g}, where float32 keeps them")


def _figures(tile: Tile) -> dict[str, Any]:
    box = tile.box_in_scene
    return {
        "file": tile.name,
        "depth": tile.depth,
        "error": tile.error,
        "splats": tile.n_splats,
        "bytes": tile.n_bytes,
        "box": [*box.low, *box.high],
    }
