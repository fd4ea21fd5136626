"""`python -m tools.bench.paper`: train the systems of the paper and write its tables and figures.

The libraries that training needs are imported when the command runs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evogs_codec import InputError
from evogs_codec.cli.commands import run as run_command
from evogs_codec.io.json_files import read_json
from reference_trainer.cli import config_of, pyramid_of
from reference_trainer.config import METHODS, PRESETS
from tools.bench.again import command_again

if TYPE_CHECKING:
    from reference_trainer.data import Dataset
    from reference_trainer.queue import Job

__all__ = ["main", "parse", "run_paper"]

COMMAND = "python -m tools.bench.paper"
BUDGETS = ("equal", "thresholds")
SYSTEMS = [name for name in METHODS if name != "evogs-mixed"]  # those of the paper
# Of the flags that change the numbers, with what they are if they are not given.
DEFAULTS: dict[str, Any] = {
    "size": 400,
    "preset": "two-cores",
    "methods": SYSTEMS,
    "seeds": [0, 1],
    "budgets": list(BUDGETS),
    "levels": None,
    "iterations": None,
    "max_splats": None,
    "sh_degree": None,
    "integers": None,
    "distortion": None,
    "device": "cpu",
    "background": "white",
    "test_every": 8,
    "cut_views": 8,
}
EXAMPLES = f"""examples:
  {COMMAND} --data lego --out build/lego --size 400
  {COMMAND} --data lego --out build/lego --size 400 --no-train     what is there so far
  {COMMAND} --data photos --out build/quick --preset quick --size 128 --seeds 0

Interrupted, it goes on where it was: finished runs and measurements are not repeated.
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
        description="Train all systems of the paper on photographs, and write its tables and"
        " figures.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(
        run=run_paper, method="evogs", seed=0, next_size=0, as_published=True, **DEFAULTS
    )
    parser.add_argument(
        "--data", dest="input", type=Path, required=True, metavar="D", help="photographs"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="for all it makes")
    parser.add_argument("--runs", type=Path, metavar="DIR", help="of the queue (default: OUT/runs)")
    parser.add_argument(
        "--report", type=Path, metavar="FILE.md", help="the page (default: OUT/paper.md)"
    )
    parser.add_argument("--no-train", action="store_true", help="report on the runs that are there")
    parser.add_argument("--size", type=int, help="longer side at the last level (default: 400)")
    parser.add_argument("--preset", choices=list(PRESETS), help="default: two-cores")
    parser.add_argument("--methods", nargs="+", choices=METHODS, help="default: those of the paper")
    parser.add_argument("--seeds", nargs="+", type=int, help="default: 0 1")
    parser.add_argument("--budgets", nargs="+", choices=BUDGETS, help="default: both")
    parser.add_argument("--levels", type=int, metavar="N", help="how many; the coarsest go first")
    parser.add_argument("--iterations", type=int, nargs="+", metavar="N", help="of each level")
    parser.add_argument("--max-splats", type=int, nargs="+", metavar="N", help="of each level")
    parser.add_argument("--sh-degree", type=int, choices=range(4))
    parser.add_argument("--integers", type=float, metavar="PART", help="as of `evogs train`")
    parser.add_argument("--distortion", type=float, metavar="PART", help="as of `evogs train`")
    parser.add_argument("--device", help="cpu, or cuda with gsplat installed (default: cpu)")
    parser.add_argument("--background", choices=["white", "black"], help="default: white")
    parser.add_argument("--test-every", type=int, metavar="N", help="views held out (default: 8)")
    parser.add_argument(
        "--cut-views", type=int, metavar="N", help="views a cut is measured on (default: 8)"
    )
    return parser.parse_args(arguments)


def run_paper(args: argparse.Namespace) -> None:
    """Train what is missing, measure, and write the page."""
    for library in ("torch", "numba", "matplotlib"):
        if find_spec(library) is None:
            raise InputError(f"the benchmark needs {library}: pip install -e '.[train,bench]'")
    from reference_trainer.data import load_views
    from reference_trainer.queue import jobs
    from tools.bench.paper.measured import Bench
    from tools.bench.paper.paper import write_paper
    from tools.bench.paper.runs import Views, find_runs

    config = config_of(args)
    folder: Path = args.runs or args.out / "runs"
    report: Path = args.report or args.out / "paper.md"
    queue = list(jobs(config, args.methods, args.seeds, args.budgets))
    data = load_views(
        args.input, background=args.background, test_every=args.test_every, size=args.size
    )
    if not args.no_train:
        _train(queue, data, folder, args.device)
    views = Views(pyramid_of(data, config.n_levels), args.cut_views)
    wanted = {job.name for job in queue if job.name != "level0"}
    runs = [run for run in find_runs(folder) if run.folder.name in wanted]
    for run in runs:
        views.check(run)
    missing = [
        job.name
        for job in queue
        if job.name in wanted and job.name not in {run.folder.name for run in runs}
    ]
    bench = Bench(runs, views, args.out / "measurements", lambda text: print(text, file=sys.stderr))
    write_paper(bench, report, command_again(COMMAND, args, DEFAULTS), missing)
    print(f"{report}: {len(runs)} of {len(wanted)} runs")


def _train(queue: list[Job], data: Dataset, folder: Path, device: str) -> None:
    """All runs that have no result yet."""
    from reference_trainer.queue import run_job
    from reference_trainer.train import NotFiniteError

    for number, job in enumerate(queue):
        result = folder / job.name / "result.json"
        if result.exists():
            found = read_json(result)
            config = found.get("config") if isinstance(found, dict) else None
            if config != json.loads(json.dumps(job.config.as_dict())):
                raise InputError(
                    f"{result}: is of another configuration; give its flags, --no-train, or "
                    "another --out"
                )
            continue
        print(f"[{number + 1}/{len(queue)}] {job.name}", file=sys.stderr)
        try:
            run_job(job, data, folder, device)
        except NotFiniteError as error:
            raise InputError(f"{job.name}: {error}") from error
