"""The command line: `evogs encode | decode | lift | info | validate | extract`.

Other packages add commands through the entry-point group `evogs.commands`; each entry is a
function that takes the sub-parsers. Exit codes: 0 done, 1 the input is bad or a file cannot be
used, 2 usage, 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path

import numpy as np
from tqdm import tqdm

from evogs_codec import options, registry
from evogs_codec.aiming import Aim
from evogs_codec.cut import Cut
from evogs_codec.decode import Decoded, decode, decode_leaves, replay
from evogs_codec.directory import Directory, SceneInfo, read_directory
from evogs_codec.drawn import ORDERING_VIEWS, Pictures
from evogs_codec.encode import Progress, encode
from evogs_codec.errors import InputError, StreamError
from evogs_codec.extract import choose_cut, extract
from evogs_codec.files import check_target, write_atomic
from evogs_codec.interchange import read_tree, write_tree
from evogs_codec.lifting import lift
from evogs_codec.omissions import omissions
from evogs_codec.ply import drop_non_finite, read_ply, write_ply
from evogs_codec.reports import comments_of, info_of, level_figures, print_info, print_levels
from evogs_codec.settings import PRESETS, TREE_PSNR, Settings
from evogs_codec.splats import SplatParams
from evogs_codec.stats import bytes_by_group
from evogs_codec.tree import EvolutionTree

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    parser = _parser()
    args = parser.parse_args(arguments)
    try:
        with _plain_warnings():
            if "output" in args:
                check_target(args.output)
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evogs",
        description="Progressive streams of 3D Gaussian Splatting scenes.",
        epilog="Each command has examples: evogs encode --help",
    )
    parser.add_argument("--version", action="version", version=f"evogs {_version()}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    options.add_encode(commands, run_encode)
    options.add_decode(commands, run_decode)
    options.add_lift(commands, run_lift)
    options.add_info(commands, run_info)
    options.add_validate(commands, run_validate)
    options.add_extract(commands, run_extract)
    for entry in entry_points(group="evogs.commands"):
        entry.load()(commands)
    return parser


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

    def show(message: Warning | str, *_: object, **__: object) -> None:
        print(f"evogs: warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        warnings.simplefilter("always", UserWarning)
        yield


# --- commands ------------------------------------------------------------------------------------


def run_encode(args: argparse.Namespace) -> None:
    """`evogs encode`."""
    is_scene = _is_ply(args.input)
    if args.finer and (args.target_psnr or args.target_bytes or args.max_error):
        raise InputError("--finer does not go with a target: the target decides how fine steps are")
    if args.polish and not (args.target_psnr or args.target_bytes):
        raise InputError("--polish needs --target-psnr or --target-bytes")
    settings = _settings(args, "scene" if is_scene else "trained")
    info = _scene_info(args)
    with _progress() as progress:
        if is_scene:
            splats = _read_splats(args.input, drop_invalid=args.drop_invalid)
            tree = _lifted(splats, args, progress)
        elif args.refine:
            raise InputError("--refine is for .ply scenes: a tree has its levels")
        else:
            tree = read_tree(args.input)
        data = _encoded(tree, settings, info, args, progress)
    write_atomic(args.output, data)
    directory = read_directory(memoryview(data))
    n = tree.n_leaves
    figures = {
        "output": str(args.output),
        "splats": n,
        "bytes": len(data),
        "bytes_per_splat": round(len(data) / max(n, 1), 3),
        "levels": level_figures(directory),
    }
    if args.json:
        print(json.dumps(figures))
        return
    print(f"{args.output}: {n:,} splats, {len(data):,} bytes, {len(data) / max(n, 1):.2f} a splat")
    print_levels(directory)


def run_decode(args: argparse.Namespace) -> None:
    """`evogs decode`."""
    data = _read(args.input)
    directory = read_directory(data)
    degree = args.sh_degree
    if degree is not None:
        degree = min(degree, directory.sh_degree)
    if args.partial:
        splats = _decode_partial(data, args).leaves(sh_degree=degree)
    else:
        with _progress() as progress:
            splats = decode_leaves(
                data,
                _cut(directory, args),
                sh_degree=degree,
                verify=args.verify,
                progress=lambda part: progress("decode", part),
            )
    write_ply(args.output, splats, comments=comments_of(directory))
    print(f"{args.output}: {len(splats):,} splats, SH degree {splats.sh_degree}")


def _decode_partial(data: memoryview, args: argparse.Namespace) -> Decoded:
    directory = read_directory(data)
    ends = directory.offsets + directory.packets["size"]
    there = Cut.of_complete(directory, ends <= len(data))
    asked = _cut(directory, args)
    cut = Cut(np.minimum(there.steps, asked.steps))
    decoded = replay(directory, data, cut, verify=args.verify)
    if len(data) < directory.size:
        part = 100 * len(data) / directory.size
        print(f"evogs: {args.input}: {part:.1f} % of the file is there", file=sys.stderr)
    return decoded


def run_lift(args: argparse.Namespace) -> None:
    """`evogs lift`."""
    with _progress() as progress:
        splats = _read_splats(args.input, drop_invalid=args.drop_invalid)
        tree = _lifted(splats, args, progress)
    write_tree(args.output, tree)
    print(f"{args.output}: {tree.n_leaves:,} splats, {tree.n_levels} levels")


def run_info(args: argparse.Namespace) -> None:
    """`evogs info`."""
    data = _read(args.input)
    directory = read_directory(data)
    whole = len(data) >= directory.size
    groups = bytes_by_group(directory, data) if whole else {}
    left_out = omissions(directory, data) if whole else []
    info = info_of(directory, len(data), groups, left_out)
    if args.json:
        print(json.dumps(info, indent=2))
    else:
        print_info(directory, info, groups)


def run_validate(args: argparse.Namespace) -> int:
    """`evogs validate`."""
    try:
        data = _read(args.input)
        with _progress() as progress:
            decoded = decode(data, verify=True, progress=lambda part: progress("validate", part))
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


def _lifted(splats: SplatParams, args: argparse.Namespace, progress: Progress) -> EvolutionTree:
    """Its coarse levels refined, if that is asked for."""
    tree = lift(splats, args.levels, progress=lambda part: progress("lift", part))
    if not args.refine:
        return tree
    refiners = entry_points(group="evogs.refiners")
    if not refiners:
        raise InputError("--refine draws pictures: pip install 'evogs[render]'")
    for entry in refiners:
        refine = entry.load()
        tree = refine(
            tree, args.camera, args.up, args.refine, lambda part: progress("refine", part)
        )
    return tree


def _settings(args: argparse.Namespace, default: str) -> Settings:
    settings = PRESETS["near-lossless" if args.near_lossless else args.preset or default]
    if args.bits:
        settings = replace(settings, range_bits=args.bits)
    if args.finer:
        settings = settings.finer(args.finer)
    return replace(settings, effort=args.effort)


def _encoded(
    tree: EvolutionTree,
    settings: Settings,
    info: SceneInfo,
    args: argparse.Namespace,
    progress: Progress,
) -> bytes:
    """At a target, if there is one."""
    aim = Aim(tree, settings, n_tiles=args.tiles, info=info, progress=progress)
    if args.max_error:
        errors: dict[str, float] = {}
        for given in sorted(args.max_error, key=len, reverse=True):  # one for all groups first
            errors |= given
        return aim.within(errors)
    if args.target_psnr is None and args.target_bytes is None:
        if _is_open(args) and tree.quanta:
            settings = replace(Settings.of_quanta(tree.quanta), effort=args.effort)
        elif _is_open(args) and not _is_ply(args.input) and tree.n_leaves:
            nearest = _as_near_as_pictures_tell(aim, args)
            if nearest is not None:
                return nearest
        pictures = _pictures(tree, args, ORDERING_VIEWS) if tree.n_leaves else None
        return encode(
            tree, settings, n_tiles=args.tiles, info=info, pictures=pictures, progress=progress
        )
    if not tree.n_leaves:
        raise InputError("a scene without splats has nothing to aim at")
    aim = replace(aim, pictures=_pictures(tree, args), polish=args.polish or 0)
    if aim.pictures is None and (args.polish or args.target_bytes is None):
        option = "--polish" if args.polish else "--target-psnr"
        raise InputError(f"{option} draws pictures: pip install 'evogs[render]'")
    if args.polish and tree.n_levels < 2:
        warnings.warn("--polish changes nothing: the tree has one level", stacklevel=1)
    if args.target_bytes is not None:
        return aim.at_bytes(args.target_bytes)
    return aim.at_psnr(args.target_psnr)


def _is_open(args: argparse.Namespace) -> bool:
    """Whether no option says how fine steps are; targets are asked for before."""
    return not (args.preset or args.bits or args.near_lossless or args.finer)


def _as_near_as_pictures_tell(aim: Aim, args: argparse.Namespace) -> bytes | None:
    """At `TREE_PSNR`; None if nothing can draw the tree, or if pictures tell too little of it."""
    pictures = _pictures(aim.tree, args)
    instead = "encoded with --preset trained instead"
    if pictures is None:
        warnings.warn(
            f"no pictures to aim at: pip install 'evogs[render]'; {instead}", stacklevel=1
        )
        return None
    try:
        return replace(aim, pictures=pictures).at_psnr(TREE_PSNR)
    except InputError as error:  # of a few splats, or none that is seen
        warnings.warn(f"{error}; {instead}", stacklevel=1)
        return None


def _pictures(
    tree: EvolutionTree, args: argparse.Namespace, n_views: int | None = None
) -> Pictures | None:
    """Of the leaves, where something can draw them."""
    for entry in entry_points(group="evogs.pictures"):
        draw = entry.load()
        found: Pictures | None = draw(
            tree.leaves(), args.camera, args.up, n_views, polish=bool(args.polish)
        )
        return found
    return None


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


@contextmanager
def _progress() -> Iterator[Progress]:
    """A bar on standard error for what takes over two seconds, if that is a terminal."""
    with tqdm(total=100, delay=2, disable=None, leave=False, bar_format="{l_bar}{bar}") as bar:

        def report(stage: str, part: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.n = round(100 * part)
            bar.refresh()

        yield report


if __name__ == "__main__":
    sys.exit(main())
