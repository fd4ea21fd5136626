"""The command line: `evogs encode | decode | lift | info | validate | extract`.

Other packages add commands through the entry-point group `evogs.commands`; each entry is a
function that takes the sub-parsers. Exit codes: 0 done, 1 the input is bad or a file cannot be
used, 2 usage, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from evogs_codec import registry
from evogs_codec.cut import Cut
from evogs_codec.decode import Decoded, decode, replay
from evogs_codec.directory import Directory, SceneInfo, read_directory
from evogs_codec.encode import Progress, encode
from evogs_codec.errors import InputError, StreamError
from evogs_codec.extract import choose_cut, extract
from evogs_codec.files import write_atomic
from evogs_codec.interchange import read_tree, write_tree
from evogs_codec.lifting import lift
from evogs_codec.ply import drop_non_finite, read_ply, write_ply
from evogs_codec.settings import PRESETS, Settings
from evogs_codec.splats import SplatParams
from evogs_codec.stats import bytes_by_group, levels

__all__ = ["main"]

DEFAULT_LEVELS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    parser = _parser()
    args = parser.parse_args(arguments)
    try:
        with _plain_warnings():
            return int(args.run(args) or 0)
    except StreamError as error:
        return _fail(f"{args.input}: {error}")
    except InputError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f"{error.filename or args.input}: {error.strerror or error}")
    except ValueError as error:
        return _fail(f"{args.input}: {error}")
    except MemoryError:
        return _fail(f"{args.input}: not enough memory")
    except KeyboardInterrupt:
        _fail("interrupted")
        return 130  # 128 + SIGINT, as shells have it


def _fail(message: str) -> int:
    print(f"evogs: {message}", file=sys.stderr)
    return 1


def _version() -> str:
    try:
        return version("evogs")
    except PackageNotFoundError:  # run from a checkout
        return "(not installed)"


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Warnings as one line each on standard error."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:  # noqa: ANN401
        print(f"evogs: warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        warnings.simplefilter("always", UserWarning)
        yield


# --- commands ------------------------------------------------------------------------------------


def run_encode(args: argparse.Namespace) -> None:
    """`evogs encode`."""
    is_scene = _is_ply(args.input)
    settings = _settings(args, "scene" if is_scene else "trained")
    info = _scene_info(args)
    with _progress() as progress:
        if is_scene:
            splats = _read_splats(args.input, drop_invalid=args.drop_invalid)
            tree = lift(splats, args.levels, progress=lambda part: progress("lift", part))
        else:
            tree = read_tree(args.input)
        data = encode(tree, settings, n_tiles=args.tiles, info=info, progress=progress)
    write_atomic(args.output, data)
    directory = read_directory(memoryview(data))
    n = tree.n_leaves
    figures = {
        "output": str(args.output),
        "splats": n,
        "bytes": len(data),
        "bytes_per_splat": round(len(data) / max(n, 1), 3),
        "levels": _level_figures(directory),
    }
    if args.json:
        print(json.dumps(figures))
        return
    print(f"{args.output}: {n:,} splats, {len(data):,} bytes, {len(data) / max(n, 1):.2f} a splat")
    _print_levels(directory)


def run_decode(args: argparse.Namespace) -> None:
    """`evogs decode`."""
    data = _read(args.input)
    if args.partial:
        decoded = _decode_partial(data, args)
    else:
        decoded = decode(data, lambda directory: _cut(directory, args), verify=args.verify)
    degree = args.sh_degree
    splats = decoded.leaves(
        sh_degree=degree if degree is None else min(degree, decoded.directory.sh_degree)
    )
    write_ply(args.output, splats, comments=_comments(decoded.directory))
    print(f"{args.output}: {len(splats):,} splats, SH degree {splats.sh_degree}")


def _decode_partial(data: memoryview, args: argparse.Namespace) -> Decoded:
    directory = read_directory(data)
    ends = directory.offsets + directory.packets["size"]
    there = Cut.of_complete(directory, ends <= len(data))
    asked = _cut(directory, args)
    decoded = replay(directory, data, Cut(np.minimum(there.steps, asked.steps)))
    if len(data) < directory.size:
        part = 100 * len(data) / directory.size
        print(f"evogs: {args.input}: {part:.1f} % of the file is there", file=sys.stderr)
    return decoded


def run_lift(args: argparse.Namespace) -> None:
    """`evogs lift`."""
    with _progress() as progress:
        splats = _read_splats(args.input, drop_invalid=args.drop_invalid)
        tree = lift(splats, args.levels, progress=lambda part: progress("lift", part))
    write_tree(args.output, tree)
    print(f"{args.output}: {tree.n_leaves:,} splats, {tree.n_levels} levels")


def run_info(args: argparse.Namespace) -> None:
    """`evogs info`."""
    data = _read(args.input)
    directory = read_directory(data)
    groups = bytes_by_group(directory, data) if len(data) >= directory.size else {}
    if args.json:
        print(json.dumps(_info(directory, len(data), groups), indent=2))
        return
    info = _info(directory, len(data), groups)
    for key in ("tier", "sh_degree", "tiles", "packets", "size", "grid_exponents"):
        print(f"{key:>18}  {info[key]}")
    for key, value in info["scene"].items():
        print(f"{key:>18}  {_shown(str(value))}")
    if len(data) < directory.size:
        print(f"{'truncated':>18}  {len(data):,} of {directory.size:,} bytes are there")
    _print_levels(directory)
    n = max(info["levels"][-1]["n_leaves"], 1)
    print(f"\n{'part':>15} {'bytes':>12} {'a splat':>8} {'share':>7} {'over order-0':>13}")
    for name, part in groups.items():
        over = f"{100 * (part.n_bytes / part.entropy - 1):+.1f} %" if part.entropy else ""
        share = 100 * part.n_bytes / directory.size
        print(
            f"{name:>15} {part.n_bytes:>12,.0f} {part.n_bytes / n:>8.3f} {share:>5.1f} % {over:>13}"
        )


def run_validate(args: argparse.Namespace) -> int:
    """`evogs validate`."""
    try:
        decoded = decode(_read(args.input), verify=True)
    except StreamError as error:
        if not args.json:
            raise
        report = {
            "valid": False,
            "fault": error.fault.name,
            "offset": error.offset,
            "section": error.section,
            "detail": error.detail,
        }
        print(json.dumps(report))
        return 1
    n_digests = len(decoded.directory.digests)
    if args.json:
        print(json.dumps({"valid": True, "splats": decoded.n_leaves, "digests": n_digests}))
    else:
        print(f"{args.input}: valid, {decoded.n_leaves:,} splats, {n_digests} digests match")
    return 0


def run_extract(args: argparse.Namespace) -> None:
    """`evogs extract`."""
    data = _read(args.input)
    directory = read_directory(data)
    smaller = extract(data, _cut(directory, args), box=args.box)
    write_atomic(args.output, smaller)
    print(f"{args.output}: {len(smaller):,} bytes of {directory.size:,}")


# --- parts of commands ---------------------------------------------------------------------------


def _read(path: Path) -> memoryview:
    return memoryview(path.read_bytes())


def _is_ply(path: Path) -> bool:
    """Not a `.tree.npz`, judged by the file's first bytes."""
    with path.open("rb") as file:
        return file.read(2) != b"PK"


def _read_splats(path: Path, *, drop_invalid: bool) -> SplatParams:
    splats, n_invalid = drop_non_finite(read_ply(path))
    if n_invalid and not drop_invalid:
        raise InputError(
            f"{path}: {n_invalid:,} of {n_invalid + len(splats):,} splats have a NaN or an infinite"
            " number: use --drop-invalid to leave them out"
        )
    if n_invalid:
        warnings.warn(f"{n_invalid:,} splats with NaN or infinite numbers left out", stacklevel=1)
    return splats


def _settings(args: argparse.Namespace, default: str) -> Settings:
    settings = PRESETS["near-lossless" if args.near_lossless else args.preset or default]
    if args.bits:
        settings = replace(settings, range_bits=args.bits)
    if args.finer:
        settings = settings.finer(args.finer)
    return replace(settings, effort=args.effort)


def _scene_info(args: argparse.Namespace) -> SceneInfo:
    text = {key: getattr(args, key) for key in registry.TEXT_OPTIONS if getattr(args, key)}
    text["generator"] = f"evogs {_version()}"
    return SceneInfo(
        coordinate_system=registry.COORDINATE_SYSTEMS.index(args.coordinate_system),
        up_axis=registry.UP_AXES.index(args.up_axis),
        unit=registry.UNITS.index(args.unit),
        colour_space=registry.COLOUR_SPACES.index(args.colour_space),
        antialiased=args.antialiased,
        text=text,
    )


def _cut(directory: Directory, args: argparse.Namespace) -> Cut:
    degree = args.sh_degree
    if degree is not None:
        degree = min(degree, directory.sh_degree)
    return choose_cut(
        directory, level=args.level, sh_degree=degree, box=args.box, max_bytes=args.max_bytes
    )


def _comments(directory: Directory) -> list[str]:
    """Metadata as comments of a .ply, which are ASCII without control characters."""
    lines = [f"{key}: {_shown(value)}" for key, value in directory.info.text.items()]
    return [line.encode("ascii", "backslashreplace").decode("ascii") for line in lines]


def _shown(text: str) -> str:
    """Text of a stranger for a terminal: what is not printable is escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _level_figures(directory: Directory) -> list[dict[str, Any]]:
    """Figures per level for JSON, which has no NaN: an unknown error is null."""
    figures = [asdict(level) for level in levels(directory)]
    return [{k: v if v == v else None for k, v in level.items()} for level in figures]


def _info(directory: Directory, size: int, groups: dict[str, Any]) -> dict[str, Any]:
    scene = directory.info
    return {
        "tier": directory.tier,
        "sh_degree": directory.sh_degree,
        "tiles": len(directory.tiles),
        "packets": len(directory.packets),
        "size": directory.size,
        "bytes_present": size,
        "grid_exponents": list(directory.grid_exponents),
        "scene": {
            "coordinate_system": registry.name(
                registry.COORDINATE_SYSTEMS, scene.coordinate_system
            ),
            "up_axis": registry.name(registry.UP_AXES, scene.up_axis),
            "unit": registry.name(registry.UNITS, scene.unit),
            "colour_space": registry.name(registry.COLOUR_SPACES, scene.colour_space),
            "antialiased": scene.antialiased,
            **scene.text,
        },
        "levels": _level_figures(directory),
        "groups": {name: asdict(part) for name, part in groups.items()},
        "digests": len(directory.digests),
    }


def _print_levels(directory: Directory) -> None:
    print(f"\n{'level':>6} {'splats':>10} {'bytes':>12} {'so far':>12} {'':>7} {'error':>9}")
    so_far = directory.data_offset
    for level in levels(directory):
        so_far += level.n_bytes
        part = 100 * so_far / directory.size
        bar = "#" * round(part / 5)
        print(
            f"{level.level:>6} {level.n_leaves:>10,} {level.n_bytes:>12,} {so_far:>12,}"
            f" {part:>5.1f} % {level.error:>9.3g}  {bar}"
        )


@contextmanager
def _progress() -> Iterator[Progress]:
    """A bar on standard error for what takes over two seconds, if that is a terminal."""
    with tqdm(total=100, delay=2, disable=None, leave=False, bar_format="{l_bar}{bar}") as bar:

        def report(stage: str, part: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.n = round(100 * part)
            bar.refresh()

        yield report


# --- arguments -----------------------------------------------------------------------------------


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evogs",
        description="Progressive streams of 3D Gaussian Splatting scenes.",
        epilog="Each command has examples: evogs encode --help",
    )
    parser.add_argument("--version", action="version", version=f"evogs {_version()}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_encode(commands)
    _add_decode(commands)
    _add_lift(commands)
    _add_info(commands)
    _add_validate(commands)
    _add_extract(commands)
    for entry in entry_points(group="evogs.commands"):
        entry.load()(commands)
    return parser


Commands = Any  # argparse's sub-parsers have no public type


def _command(
    commands: Commands,
    name: str,
    run: Any,  # noqa: ANN401
    help_: str,
    examples: str,
) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=help_,
        description=help_,
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    # Before Python 3.14 argparse takes -1e3 for an option.
    parser._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
    return parser


def _add_encode(commands: Commands) -> None:
    parser = _command(
        commands,
        "encode",
        run_encode,
        "Encode a .ply scene or a .tree.npz tree.",
        "  evogs encode scene.ply scene.evogs\n"
        "  evogs encode scene.ply scene.evogs --levels 6 --title Bonsai --licence CC-BY-4.0\n"
        "  evogs encode lego.tree.npz lego.evogs --finer 2\n"
        "  evogs encode lego.tree.npz exact.evogs --near-lossless",
    )
    parser.add_argument("input", type=Path, metavar="IN", help="a 3DGS .ply or a .tree.npz")
    parser.add_argument("output", type=Path, metavar="OUT.evogs")
    _add_lift_options(parser)
    accuracy = parser.add_mutually_exclusive_group()
    accuracy.add_argument(
        "--preset",
        choices=[name for name in PRESETS if name != "near-lossless"],
        help="scene: accuracy of SPZ version 4 (default for .ply); trained: default for .tree.npz;"
        " paper: the paper's pipeline, for comparison",
    )
    accuracy.add_argument(
        "--bits",
        type=_number(int, 2, 16),
        metavar="B",
        help="instead of a preset: B bits over the range of each level's refinements, closed loop",
    )
    accuracy.add_argument(
        "--near-lossless",
        action="store_true",
        help="every number within a grid unit of a 24-bit grid",
    )
    parser.add_argument(
        "--finer", type=_number(float, 1e-3, 1e6), metavar="F", help="divide all steps by F"
    )
    parser.add_argument(
        "--tiles",
        type=_number(int, 1, 65536),
        metavar="N",
        help="spatial tiles (default: 1 below 200,000 splats)",
    )
    parser.add_argument(
        "--effort",
        type=_number(int, 1, 22),
        default=19,
        metavar="Z",
        help="Zstandard level, 1..22 (default: 19)",
    )
    for key in registry.TEXT_OPTIONS:
        parser.add_argument(f"--{key}", metavar="TEXT", help="metadata")
    for option, names in (
        ("--coordinate-system", registry.COORDINATE_SYSTEMS),
        ("--up-axis", registry.UP_AXES),
        ("--unit", registry.UNITS),
        ("--colour-space", registry.COLOUR_SPACES),
    ):
        parser.add_argument(option, choices=names, default=names[0], help="metadata")
    parser.add_argument(
        "--antialiased", action="store_true", help="the scene was trained with antialiasing"
    )
    parser.add_argument("--json", action="store_true", help="print figures as JSON")


def _add_decode(commands: Commands) -> None:
    parser = _command(
        commands,
        "decode",
        run_decode,
        "Decode a stream, or a part of it, to a .ply.",
        "  evogs decode scene.evogs scene.ply\n"
        "  evogs decode scene.evogs coarse.ply --level 1 --sh-degree 0\n"
        "  evogs decode scene.evogs corner.ply --box 0 0 0 1 1 1\n"
        "  evogs decode download.evogs.part so-far.ply --partial",
    )
    parser.add_argument("input", type=Path, metavar="IN.evogs")
    parser.add_argument("output", type=Path, metavar="OUT.ply")
    _add_cut_options(parser)
    parser.add_argument("--partial", action="store_true", help="take what a cut-short file has")
    parser.add_argument("--verify", action="store_true", help="check digests of the integers")


def _add_lift(commands: Commands) -> None:
    parser = _command(
        commands,
        "lift",
        run_lift,
        "Build the tree under a .ply scene, uncompressed.",
        "  evogs lift scene.ply scene.tree.npz\n"
        "  evogs encode scene.tree.npz scene.evogs --preset scene",
    )
    parser.add_argument("input", type=Path, metavar="IN.ply")
    parser.add_argument("output", type=Path, metavar="OUT.tree.npz")
    _add_lift_options(parser)


def _add_info(commands: Commands) -> None:
    parser = _command(
        commands,
        "info",
        run_info,
        "Say what is in a stream: header, levels, bytes per group.",
        "  evogs info scene.evogs\n  evogs info scene.evogs --json",
    )
    parser.add_argument("input", type=Path, metavar="IN.evogs")
    parser.add_argument("--json", action="store_true")


def _add_validate(commands: Commands) -> None:
    parser = _command(
        commands,
        "validate",
        run_validate,
        "Check a stream in every respect; exit 0 if valid, 1 with the fault if not.",
        "  evogs validate scene.evogs\n  evogs validate scene.evogs --json",
    )
    parser.add_argument("input", type=Path, metavar="IN.evogs")
    parser.add_argument("--json", action="store_true")


def _add_extract(commands: Commands) -> None:
    parser = _command(
        commands,
        "extract",
        run_extract,
        "Make a smaller stream by moving packets, without decoding.",
        "  evogs extract scene.evogs small.evogs --level 2\n"
        "  evogs extract scene.evogs small.evogs --max-bytes 500000\n"
        "  evogs extract scene.evogs corner.evogs --box 0 0 0 1 1 1 --sh-degree 0",
    )
    parser.add_argument("input", type=Path, metavar="IN.evogs")
    parser.add_argument("output", type=Path, metavar="OUT.evogs")
    _add_cut_options(parser)


def _add_lift_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--levels",
        type=_number(int, 1, 64),
        default=DEFAULT_LEVELS,
        metavar="N",
        help=f"levels of a lifted scene (default: {DEFAULT_LEVELS})",
    )
    parser.add_argument(
        "--drop-invalid", action="store_true", help="leave out splats with NaN or infinite numbers"
    )


def _add_cut_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--level", type=_number(int, 0, 63), metavar="K", help="stop at level K")
    parser.add_argument(
        "--max-bytes",
        type=_number(int, 0, 1 << 62),
        metavar="N",
        help="the longest prefix whose extracted file has at most N bytes",
    )
    parser.add_argument(
        "--box",
        type=_number(float, -1e30, 1e30),
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="only tiles that meet this box, in scene units",
    )
    parser.add_argument(
        "--sh-degree", type=_number(int, 0, 3), metavar="D", help="no SH bands above D"
    )


def _number(kind: type, low: float, high: float) -> Any:  # noqa: ANN401
    """An argparse type for numbers of a range."""

    def parse(text: str) -> Any:  # noqa: ANN401
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not in {low}..{high}")
        return value

    parse.__name__ = kind.__name__
    return parse


if __name__ == "__main__":
    sys.exit(main())
