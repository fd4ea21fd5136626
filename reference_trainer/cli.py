"""`evogs train`: photographs with cameras become an evolution tree.

torch and numba are extras: they are imported when the command runs, so that all others work
without.
"""

from __future__ import annotations

import argparse
import json
import os
import warnings
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evogs_codec import InputError
from evogs_codec.cli.argument_types import number
from evogs_codec.cli.common_options import add_output
from evogs_codec.format.write_directory import MAX_LEVELS
from evogs_codec.io.files import PICTURE, TREE, FileKind, check_target, same_file, write_atomic
from evogs_codec.io.tree_npz import read_tree, write_tree
from reference_trainer.config import MAX_SHIFTED, METHODS, PRESETS, Config

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["config_of", "finer_than", "pyramid_of", "register", "run_train"]

RESULT = FileKind("result of a run", (b'{\n "config"',))
Commands = Any  # argparse's sub-parsers have no public type
EXAMPLES = """examples:
  evogs train lego lego.tree.npz --size 400
  evogs train lego lego.tree.npz --preset quick --size 200
  evogs train lego layers.tree.npz --method lapis --checkpoint work --resume
  evogs train lego small.tree.npz --distortion 0.2  # a smaller stream, less sharp
  evogs train lego lego.tree.npz --levels 2 --iterations 7000 3000 --max-splats 4000 12000

afterwards: evogs encode lego.tree.npz lego.evogs
"""


def register(commands: Commands) -> None:
    """Add the command to `evogs` (entry point of the group `evogs.commands`)."""
    help_ = "Train an evolution tree, or a baseline of the paper, on photographs with cameras."
    parser = commands.add_parser(
        "train",
        help=help_,
        description=help_,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run_train)
    parser.add_argument(
        "input", type=Path, metavar="DATASET", help="folder of photographs (docs/datasets.md)"
    )
    add_output(parser, "OUT.tree.npz", TREE)
    parser.add_argument(
        "--preset",
        choices=list(PRESETS),
        default="two-cores",
        help="iterations, sizes and rates (default: two-cores)",
    )
    parser.add_argument(
        "--method", choices=METHODS, default="evogs", help="what to train (default: evogs)"
    )
    parser.add_argument(
        "--levels",
        type=number(int, 1, MAX_LEVELS),
        metavar="N",
        help="number of levels (default: as in the preset, whose first N are taken)",
    )
    parser.add_argument(
        "--iterations", type=int, nargs="+", metavar="N", help="iterations of each level"
    )
    parser.add_argument(
        "--max-splats", type=int, nargs="+", metavar="N", help="largest number of splats per level"
    )
    parser.add_argument("--sh-degree", type=int, choices=range(4), help="degree of the SH")
    parser.add_argument(
        "--integers",
        type=float,
        metavar="PART",
        help="after each level, train on in the integers of the codec for this fraction of its"
        " iterations; 0 trains in floats only (default: 0.15, 0.1 with --preset paper)",
    )
    parser.add_argument(
        "--distortion",
        type=float,
        metavar="PART",
        help="squared error that rounding to integers may add, as a fraction of the error of the"
        " rendered views, before training reduces it (default: 0.07); more makes smaller streams",
    )
    parser.add_argument(
        "--next-size",
        type=int,
        default=0,
        metavar="N",
        help="train each level on photographs of the size of the next level, too: on one after N of"
        " its own size. It loses less when drawn there, and is less sharp at its own size"
        " (default: 0, none)",
    )
    parser.add_argument(
        "--as-published",
        action="store_true",
        help="the loss of 3DGS, photographs on one grid of pixels, and splits by gradients alone,"
        " as the paper is compared (default: more SSIM, grids that are shifted by half a pixel,"
        " too, and large splats first)",
    )
    parser.add_argument(
        "--seed", type=number(int, 0, 1 << 62), default=0, help="seed of everything random"
    )
    parser.add_argument("--device", default="cpu", help="cpu (default), or cuda with gsplat")
    parser.add_argument(
        "--size",
        type=int,
        metavar="PIXELS",
        help="longer side of the photographs at the last level",
    )
    parser.add_argument(
        "--background",
        choices=["white", "black"],
        default="white",
        help="behind transparent photographs (default: white)",
    )
    parser.add_argument(
        "--test-every",
        type=int,
        default=8,
        metavar="N",
        help="hold out every Nth view (default: 8)",
    )
    parser.add_argument(
        "--base",
        type=Path,
        metavar="FILE.tree.npz",
        help="take level 0 from this tree instead of training it",
    )
    parser.add_argument(
        "--checkpoint",
        type=Path,
        metavar="DIR",
        help="write checkpoints, a log, results and views here",
    )
    parser.add_argument(
        "--sheet",
        type=Path,
        metavar="FILE.png",
        help="held-out views: the photograph, then each level (default: beside OUT.tree.npz)",
    )
    parser.add_argument("--resume", action="store_true", help="continue from the checkpoint")
    parser.add_argument("--quiet", action="store_true", help="show no progress bar")


def run_train(args: argparse.Namespace) -> None:
    """`evogs train`."""
    for library in ("torch", "numba"):
        if find_spec(library) is None:
            raise InputError(f"training needs {library}: pip install -e '.[train]'")
    from evogs_codec.common.heap import keep_freed_memory
    from reference_trainer.data import load_views
    from reference_trainer.evaluate import evaluate
    from reference_trainer.held_out import at_full_size, write_sheet
    from reference_trainer.models.backends import backend_for
    from reference_trainer.run import is_unfinished, run
    from reference_trainer.runtime.progress import Progress
    from reference_trainer.train import NotFiniteError

    if args.resume and args.checkpoint is None:
        raise ValueError("--resume needs --checkpoint")
    config = config_of(args)
    if isinstance(args.output, Path):
        _check_beside_photographs(args.output, TREE, args)
    sheet = _sheet(args)
    if args.checkpoint is not None:
        _check_checkpoint(args, config.n_levels)
    keep_freed_memory()
    backend = backend_for(args.device)
    data = load_views(
        args.input, background=args.background, test_every=args.test_every, size=args.size
    )
    pyramid = pyramid_of(data, config.n_levels)
    base = None if args.base is None else read_tree(args.base)
    finer = finer_than(data, args) if config.shifts else None
    folder: Path | None = args.checkpoint
    log = None
    if folder is not None:
        begins = not (args.resume or args.force)
        if begins and is_unfinished(folder, config, pyramid, base=base, finer=finer):
            said = "has this run, stopped before its end: --resume goes on, --force begins again"
            raise InputError(f"{folder}: {said}")
        folder.mkdir(parents=True, exist_ok=True)
        log = folder / "log.csv"
    progress = Progress(log, shows_bar=not args.quiet)
    try:
        tree = run(
            config,
            pyramid,
            backend,
            folder=folder,
            resume=args.resume,
            base=base,
            finer=finer,
            progress=progress,
        )
    except NotFiniteError as error:
        raise InputError(f"{error}; the last checkpoint is from before") from error
    write_tree(args.output, tree, made_by=args.command)
    pictures = None if folder is None else folder / "pictures"
    rows = evaluate(tree, config.method, pyramid, pictures, made_by=args.command)
    if folder is not None:
        report = {
            "config": config.as_dict(),
            "refines_save": progress.refines_save,
            "levels": rows,
        }
        write_atomic(folder / "result.json", (json.dumps(report, indent=1) + "\n").encode())
    for row in rows:
        print(
            f"L{row['level']}: {row['width']} x {row['height']}, {row['psnr']:.2f} dB, "
            f"SSIM {row['ssim']:.4f}, {row['splats']:,} splats, {row['storage_bytes']:,} bytes"
        )
    views = "held-out views" if data.test else "training views"
    worth = " / ".join(f"{x:.2f}" for x in at_full_size(tree, data, config.n_levels))
    print(f"levels drawn at full size, {views}: {worth} dB")
    if sheet is not None:
        write_sheet(sheet, tree, data, config.n_levels, made_by=args.command)
        print(f"{sheet}: {views}, photograph and levels")


def _sheet(args: argparse.Namespace) -> Path | None:
    """Where the sheet goes; None where the tree goes to a store and no file is named."""
    path: Path | None = args.sheet
    if path is None:
        if not isinstance(args.output, Path):
            return None
        path = args.output.with_name(args.output.name.removesuffix(".tree.npz") + ".png")
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: the sheet is a PNG; name a file that ends with .png")
    sources = [source for source in (args.base, args.output) if isinstance(source, Path)]
    check_target(path, PICTURE, command=args.command, sources=sources, force=args.force)
    _check_beside_photographs(path, PICTURE, args)
    return path


def _check_beside_photographs(path: Path, kind: FileKind, args: argparse.Namespace) -> None:
    """Refuse to replace a file in the folder of the photographs that is not ours; `--force` too."""
    pairs = (
        (Path(args.input).resolve(), path.resolve()),
        (_named(args.input), _named(path)),  # by a link in the folder
    )
    if any(folder in place.parents for folder, place in pairs):
        try:
            check_target(path, kind, command=args.command)
        except InputError as error:
            raise InputError(f"{path}: is beside the photographs; name another file") from error


def _named(path: str | Path) -> Path:
    """The path in full, with its links as they are."""
    return Path(os.path.normpath(Path(path).absolute()))


def _check_checkpoint(args: argparse.Namespace, n_levels: int) -> None:
    """Refuse a folder for checkpoints where something else would be overwritten."""
    from reference_trainer.runtime import checkpoint
    from reference_trainer.runtime.progress import LOG

    folder: Path = args.checkpoint
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder for --checkpoint")
    kinds = {checkpoint.FILE: checkpoint.KIND, "log.csv": LOG, "result.json": RESULT}
    for level in range(n_levels):
        kinds |= {f"pictures/L{level}{ending}.png": PICTURE for ending in ("", "-photograph")}
    for place in (folder, folder / "pictures"):
        if same_file(place, args.input):
            raise InputError(f"{place}: has the photographs; name another --checkpoint")
    sources = [path for path in (args.base, args.output) if path is not None]
    for name, kind in kinds.items():
        if (folder / name).exists():
            _check_beside_photographs(folder / name, kind, args)
            check_target(
                folder / name, kind, command=args.command, sources=sources, force=args.force
            )


def config_of(args: argparse.Namespace) -> Config:
    """The preset, changed as the flags say."""
    config = replace(
        PRESETS[args.preset], method=args.method, seed=args.seed, next_size=args.next_size
    )
    n = args.levels or config.n_levels
    if n > config.n_levels and not (args.iterations and args.max_splats):
        raise ValueError(f"{n} levels: name --iterations and --max-splats of each")
    config = replace(
        config,
        iterations=_per_level("--iterations", args.iterations, config.iterations, n),
        max_splats=_per_level("--max-splats", args.max_splats, config.max_splats, n),
    )
    given = {"part": args.integers, "distortion": args.distortion}
    integers = {name: value for name, value in given.items() if value is not None}
    config = replace(config, integers=replace(config.integers, **integers))
    if args.as_published:
        config = config.as_published()
    return config if args.sh_degree is None else replace(config, sh_degree=args.sh_degree)


def _per_level(
    flag: str, given: list[int] | None, default: tuple[int, ...], n: int
) -> tuple[int, ...]:
    """One number for each level; the same one for all if one is given."""
    if given is None:
        return default[:n]
    numbers = given * n if len(given) == 1 else given
    if len(numbers) != n:
        raise ValueError(f"{flag} has {len(numbers)} numbers for {n} levels")
    return tuple(numbers)


def pyramid_of(data: Dataset, n_levels: int) -> tuple[Dataset, ...]:
    """The data at 1/2^(n-1), ..., 1/2, 1 of its size."""
    from reference_trainer.data import at_scale

    return tuple(
        replace(
            data,
            train=tuple(at_scale(view, factor) for view in data.train),
            test=tuple(at_scale(view, factor) for view in data.test),
        )
        for factor in (2**k for k in reversed(range(n_levels)))
    )


def finer_than(data: Dataset, args: argparse.Namespace) -> Dataset | None:
    """The photographs to train on at twice the size of `data`, for `Config.shifts`.

    None where they have no such size, or are too many for that.
    """
    from reference_trainer.data import load_views

    n_numbers = sum(view.image.size for view in data.train)
    if args.size is None or n_numbers > MAX_SHIFTED:
        return None
    with warnings.catch_warnings():  # `data` was loaded with the same
        warnings.simplefilter("ignore")
        found = load_views(
            args.input, background=args.background, test_every=args.test_every, size=2 * args.size
        )
    return replace(found, test=())
