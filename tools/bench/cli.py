"""The options of `python -m tools.bench`.

The libraries that measuring needs are imported when the command runs.
"""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

from evogs_codec import InputError
from evogs_codec.cli.commands import run as run_command
from tools.bench.parts import PARTS
from tools.bench.run import run

__all__ = ["main"]

ROOT = Path(__file__).resolve().parent.parent.parent
NEED_GSPLY = {"scene", "rate", "first", "stream", "effort"}  # tables that measure SPZ
EXAMPLE = "example: --ply scene.ply --tree lego.tree.npz --photos lego --only rate surface"


def main() -> int:
    """Run the benchmarks that were asked for; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench", description=__doc__, epilog=EXAMPLE
    )
    add_options(parser)
    parser.set_defaults(run=_run)
    return run_command(parser.parse_args())


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is measured, and where the results go."""
    parser.add_argument(
        "--ply", type=Path, help="a scene (default: the one of evogs_codec.render.demo_scene)"
    )
    parser.add_argument("--tree", type=Path, help="a trained .tree.npz (default: none)")
    parser.add_argument("--photos", type=Path, help="NeRF-synthetic folder of the tree")
    parser.add_argument("--runs", type=Path, help="runs of tools.bench.paper (default: none)")
    parser.add_argument(
        "--splat-transform", metavar="CMD", help="how to start it: adds SOG and decimation"
    )
    parser.add_argument("--up", default="z", help="up axis of the scene, as -y (default: z)")
    parser.add_argument(
        "--before",
        type=Path,
        metavar="CHECKOUT",
        help="a checkout that `worst` and `before` measure too",
    )
    parser.add_argument(
        "--tries", type=int, default=0, metavar="N", help="shapes that `worst` tries per command"
    )
    parser.add_argument(
        "--rows", metavar="WORD", nargs="+", default=(), help="commands of `worst`, such as feed"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the results")
    parser.add_argument("--only", choices=PARTS, nargs="+", default=PARTS, help="some tables")


def _run(args: argparse.Namespace) -> int:
    others = ("gsply",) if NEED_GSPLY & set(args.only) else ()
    for library in ("numba", "PIL", *others):
        if find_spec(library) is None:
            raise InputError(f"the figures need {library}: pip install -e '.[render,bench]'")
    if args.rows and args.out.resolve() == (ROOT / "docs").resolve():
        raise InputError("--rows makes a part of a table: name another folder with --out")
    return run(args)
