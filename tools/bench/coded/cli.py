"""`python -m tools.bench.coded`: train trees at several distortions, and compare coded bytes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from evogs_codec import InputError
from evogs_codec.cli.commands import run as run_command
from reference_trainer.cli import config_of, finer_than, pyramid_of
from reference_trainer.config import METHODS, PRESETS
from tools.bench.again import command_again

__all__ = ["DEFAULTS", "main", "parse", "run_coded"]

COMMAND = "python -m tools.bench.coded"
OWN = "evogs-mixed"
TREES = ("evogs-mixed", "evogs", "evogs-a")
DEFAULTS: dict[str, Any] = {
    "size": 200,
    "preset": "two-cores",
    "levels": None,
    "iterations": None,
    "max_splats": None,
    "methods": [*TREES, "lapis"],
    "distortions": [0.02, 0.07, 0.25],
    "seed": 0,
    "background": "white",
    "test_every": 8,
    "again": 300,
    "next_size": 0,
    "as_published": False,
}
EXAMPLES = f"""examples:
  {COMMAND} --data lego --out build/coded --size 200 --levels 3
  {COMMAND} --data photos --out build/coded --preset quick --size 200 --methods evogs-mixed evogs

Interrupted, it goes on where it was.
"""


def main() -> int:
    """Run the benchmark with the arguments of the process; returns the exit code."""
    return run_command(parse())


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of the benchmark.

    Raises:
        SystemExit: they were misused, or asked for help.
    """
    parser = argparse.ArgumentParser(
        prog=COMMAND,
        description="PSNR against coded bytes at every level: trees trained in integers at several"
        " distortions, layers and single models encoded at several accuracies.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(
        run=run_coded, method="evogs", integers=None, distortion=None, sh_degree=None, **DEFAULTS
    )
    parser.add_argument(
        "--data", dest="input", type=Path, required=True, metavar="D", help="photographs"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="for all it makes")
    parser.add_argument("--methods", nargs="+", choices=METHODS, help="what is compared")
    parser.add_argument(
        "--distortions",
        nargs="+",
        type=float,
        metavar="PART",
        help="points of the curves of trees (default: 0.02 0.07 0.25)",
    )
    parser.add_argument("--size", type=int, help="longer side at the last level")
    parser.add_argument("--preset", choices=list(PRESETS))
    parser.add_argument("--levels", type=int, metavar="N")
    parser.add_argument("--iterations", type=int, nargs="+", metavar="N", help="of each level")
    parser.add_argument("--max-splats", type=int, nargs="+", metavar="N", help="of each level")
    parser.add_argument(
        "--again",
        type=int,
        metavar="N",
        help="iterations of each level after a class of numbers was taken away (default: 300)",
    )
    parser.add_argument("--next-size", type=int, metavar="N", help="as of `evogs train`")
    parser.add_argument("--as-published", action="store_true", help="as of `evogs train`")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--background", choices=["white", "black"])
    parser.add_argument("--test-every", type=int, metavar="N")
    return parser.parse_args(arguments)


def run_coded(args: argparse.Namespace) -> None:
    """Train what is missing, measure, and write the page."""
    for library in ("torch", "numba", "matplotlib"):
        if find_spec(library) is None:
            raise InputError(f"the benchmark needs {library}: pip install -e '.[train,bench]'")
    from reference_trainer.data import load_views
    from reference_trainer.models.backends import backend_for
    from reference_trainer.queue import run_job
    from tools.bench.coded.curves import coded_levels, curve_jobs, curve_of
    from tools.bench.coded.page import write_page
    from tools.bench.coded.removals import removals, worth
    from tools.bench.coded.sizes import at_the_next_size
    from tools.bench.coded.trained_again import trained_again
    from tools.bench.paper.measured import Bench
    from tools.bench.paper.runs import Views, read_run

    config = config_of(args)
    data = load_views(
        args.input, background=args.background, test_every=args.test_every, size=args.size
    )
    finer = finer_than(data, args) if config.shifts else None
    views = Views(pyramid_of(data, config.n_levels), 8)
    folder: Path = args.out / "runs"
    bench = Bench([], views, args.out / "measurements", lambda text: print(text, file=sys.stderr))
    of = OWN if OWN in args.methods else args.methods[0]
    middle = sorted(args.distortions)[len(args.distortions) // 2]
    rows: list[dict[str, Any]] = []
    needed: list[dict[str, Any]] = []
    sizes: list[dict[str, Any]] = []
    for job in curve_jobs(config, args.methods, args.distortions):
        print(job.name, file=sys.stderr)
        run_job(job, data, folder, args.device, finer)
        if job.name == "level0":
            continue
        run = read_run(folder / job.name / "result.json", "coded")
        views.check(run)
        found = bench.measure(run, "coded", lambda run: coded_levels(views, run))
        distortion = job.config.integers.distortion if job.config.integers.part else None
        own = {"method": run.method, "distortion": distortion, "seconds": run.seconds}
        rows += [own | row for row in found]
        if distortion == middle:
            found = bench.measure(run, "sizes", lambda run: at_the_next_size(run.tree(), views))
            sizes += [{"method": run.method} | row for row in found]
        if (run.method, distortion) == (of, middle):
            again = partial(
                trained_again,
                config=job.config,
                views=views,
                finer=finer,
                iterations=args.again,
                backend=backend_for(args.device),
            )
            needed = removals(bench, run, again, args.again)
    needed = worth(needed, curve_of(rows, of, config.n_levels - 1))
    page = args.out / "coded.md"
    write_page(page, rows, command_again(COMMAND, args, DEFAULTS), of, needed, sizes)
    print(f"{page}: {len(args.methods)} methods")
