"""`evogs encode` of scenes that are larger than memory, or of several files as one."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from evogs_codec.cli.argument_types import number
from evogs_codec.cli.looking import up_asked
from evogs_codec.common.printable import shown
from evogs_codec.common.progress import Progress
from evogs_codec.errors import InputError
from evogs_codec.io.files import same_file
from evogs_codec.io.interchange.scene_files import is_named_as_scene, scene_format
from evogs_codec.io.ply import PlyBlocks
from evogs_codec.jobs import Engine, JobOptions, encode_files
from evogs_codec.jobs.blocks import SplatFiles
from evogs_codec.model.scene_info import SceneInfo

if TYPE_CHECKING:
    from evogs_codec.render import Up

__all__ = [
    "LARGE",
    "add_engine",
    "add_large_options",
    "encode_large",
    "engine_of",
    "files_of",
    "wants_jobs",
]

LARGE = 1_000_000  # splats: beyond, a scene takes over 1 GiB to encode in one piece
ENGINES = ("processes", "serial", "dask")
# What needs the whole scene at once: names of the options.
WHOLE = (
    *("preset", "bits", "near_lossless", "finer", "max_error", "target_psnr", "target_bytes"),
    *("polish", "refine", "camera", "view", "tiles"),
)


def add_large_options(parser: argparse.ArgumentParser) -> None:
    """The options that ask for jobs."""
    group = parser.add_argument_group(
        "large scenes",
        f"A .ply of more than {LARGE:,} splats, a folder of scenes, or several of them are encoded"
        " tile by tile, each in a process of its own, with about 450 MB for each process whatever"
        " the size. The stream is the same for any number of processes.",
    )
    add_engine(group)
    group.add_argument(
        "--scratch",
        type=Path,
        metavar="FOLDER",
        help="for what is in work, up to 1.5 times the input (default: OUT.evogs.parts)",
    )


def add_engine(group: argparse._ArgumentGroup) -> None:
    """Where jobs run, and whether a run is resumed."""
    group.add_argument(
        "--workers", type=number(int, 1, 1024), metavar="N", help="processes (default: processors)"
    )
    group.add_argument(
        "--engine",
        choices=ENGINES,
        help="processes of this machine (default), serial, or dask: a Dask cluster",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of Dask, for instance tcp://10.0.0.5:8786; its workers must see the scratch folder"
        " (default: a cluster on this machine)",
    )
    group.add_argument(
        "--resume", action="store_true", help="go on where a run that failed has stopped"
    )


def wants_jobs(args: argparse.Namespace) -> bool:
    """Whether a scene is to be encoded tile by tile.

    Raises:
        InputError: the options ask for that, and others do not allow it.
    """
    asked = bool(
        args.others or args.workers or args.engine or args.scheduler or args.scratch or args.resume
    )
    is_folder = args.input.is_dir() and scene_format(args.input) is None
    values = {name: getattr(args, name) for name in WHOLE}
    given = [name for name, value in values.items() if value is not None and value is not False]
    whole = [f"--{name.replace('_', '-')}" for name in given]
    whole += ["--report"] if args.page is not None else []
    if (asked or is_folder) and whole:
        raise InputError(f"{', '.join(whole)} needs the whole scene at once, in one file")
    return asked or is_folder or (not whole and _is_large(args.input))


def encode_large(
    args: argparse.Namespace, info_of: Callable[[SceneInfo], SceneInfo], progress: Progress
) -> Up:
    """Write the stream of all input files.

    Args:
        args: of `evogs encode`.
        info_of: the metadata, from what the first file says.
        progress: called with a stage and the part of it that is done.

    Returns:
        What was up in the views.

    Raises:
        InputError, OSError: as `encode_files`.
    """
    engine = engine_of(args)
    files = files_of([args.input, *args.others])
    if any(same_file(args.output, path) for path in files):
        raise InputError(f"{args.output}: is one of the inputs; name another output")
    info = info_of(SplatFiles(files).info)
    up = up_asked(args)
    options = JobOptions(
        levels=args.levels,
        layers=args.layers,
        up=None if up is None else up.vector,
        effort=args.effort or JobOptions.effort,
        drop_invalid=args.drop_invalid,
        palette="never" if args.no_palette else "auto",
        info=info,
    )
    found = encode_files(
        files,
        args.output,
        options,
        engine=engine,
        scratch=args.scratch,
        resume=args.resume,
        progress=progress,
    )
    return up or found


def engine_of(args: argparse.Namespace) -> Engine:
    """Where the jobs of a command run.

    Raises:
        InputError: the options do not go together.
    """
    if args.scheduler and args.engine not in (None, "dask"):
        raise InputError("--scheduler is for --engine dask")
    return Engine(
        args.engine or ("dask" if args.scheduler else "processes"), args.workers, args.scheduler
    )


def _is_large(path: Path) -> bool:
    if path.is_dir() or scene_format(path) != "ply":
        return False
    blocks = PlyBlocks.of(path)
    return blocks is not None and blocks.n > LARGE


def files_of(paths: Sequence[Path]) -> list[Path]:
    """The scenes of these paths; of a folder, those directly in it.

    Files of a folder that are named as scenes and are none are left out with a warning: a copy that
    was interrupted is a part of the scene that is missing.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir() or scene_format(path) is not None:
            found.append(path)
            continue
        inside = sorted(path.iterdir())
        scenes = [one for one in inside if one.is_file() and scene_format(one)]
        if not scenes:
            raise InputError(f"{path}: no scene is in this folder")
        others = set(inside) - set(scenes)
        left = sorted(one for one in others if is_named_as_scene(one) and not one.is_dir())
        if left:
            said = f"{len(left):,} files named as scenes are none and are left out"
            warnings.warn(f"{path}: {said}, first {shown(left[0].name)}", stacklevel=2)
        found += scenes
    return found
