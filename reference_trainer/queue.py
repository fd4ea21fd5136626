"""Many runs, one after the other, from one shared level 0: `python -m reference_trainer.queue`.

A run that has its `result.json` is not run again; one that was interrupted goes on from its
checkpoint. Each run has a folder of its own: `tree.tree.npz`, `result.json`, `log.csv`, pictures.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numba

from evogs_codec import InputError
from evogs_codec.common.heap import keep_freed_memory
from evogs_codec.common.printable import MAX_LINE, shown
from evogs_codec.io.files import write_atomic
from evogs_codec.io.tree_npz import read_tree, write_tree
from reference_trainer.cli import pyramid_of
from reference_trainer.config import METHODS, PRESETS, Config, FrontierGrowth, Integers
from reference_trainer.evaluate import evaluate
from reference_trainer.models.backends import backend_for
from reference_trainer.run import run
from reference_trainer.runtime.checkpoint import FILE
from reference_trainer.runtime.hardware import machine
from reference_trainer.runtime.progress import Progress

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["Job", "jobs", "main", "run_job"]

UNBOUNDED = 400_000  # splats of a level that grows by thresholds; memory has an end
SEEDED = ("evogs", "evogs-sym", "lapis")  # methods that run with every seed
LAYERED = ("evogs", "lapis", "l3gs")  # methods whose growth by thresholds is compared
THRESHOLD = 8e-5  # of a tree: 3DGS has 2e-4, and densifies every 100 iterations
BUDGETS = ("equal", "thresholds")


@dataclass(frozen=True)
class Job:
    """A run of the queue.

    Attributes:
        name: of its folder.
        config: of the run.
        n_scales: resolutions of the pyramid; a run without them all has the coarsest.
        shares: whether level 0 is the shared one.
    """

    name: str
    config: Config
    n_scales: int
    shares: bool


def main(argv: list[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m reference_trainer.queue", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of photographs")
    parser.add_argument("--out", type=Path, required=True, help="folder for the runs")
    parser.add_argument("--preset", choices=list(PRESETS), default="two-cores")
    parser.add_argument("--iterations", nargs="+", type=int, help="of each level")
    parser.add_argument("--max-splats", nargs="+", type=int, help="of each level")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--budgets", nargs="+", choices=BUDGETS, default=list(BUDGETS))
    parser.add_argument("--size", type=int, default=400, help="longer side at the last level")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--list", action="store_true", help="only say what would run")
    args = parser.parse_args(argv)
    config = PRESETS[args.preset].as_published()
    config = replace(
        config,
        iterations=tuple(args.iterations or config.iterations),
        max_splats=tuple(args.max_splats or config.max_splats),
    )
    queue = list(jobs(config, args.methods, args.seeds, args.budgets))
    if args.list:
        for job in queue:
            state = "done" if (args.out / job.name / "result.json").exists() else "to do"
            print(f"{job.name}: {state}")
        return
    from reference_trainer.data import load_views

    try:
        data = load_views(args.data, size=args.size)
        for number, job in enumerate(queue):
            print(f"[{number + 1}/{len(queue)}] {job.name}", flush=True)
            run_job(job, data, args.out, args.device)
    except InputError as error:
        parser.exit(1, f"{shown(error, MAX_LINE)}\n")


def jobs(config: Config, methods: list[str], seeds: list[int], budgets: list[str]) -> Iterator[Job]:
    """The shared level 0, then every method once, then some with the other seeds.

    Integers are of trees alone, so that all trees are compared with the same baselines.
    """
    layered = replace(config, integers=Integers())
    first = replace(layered, iterations=config.iterations[:1], max_splats=config.max_splats[:1])
    yield Job("level0", replace(first, method="mono"), config.n_levels, shares=False)
    for number, seed in enumerate(seeds):
        for budget in budgets:
            for method in methods:
                if method not in (LAYERED if budget == "thresholds" else METHODS):
                    continue
                if number and (method not in SEEDED or budget == "thresholds"):
                    continue
                is_tree = method.startswith("evogs")
                changed = replace(config if is_tree else layered, method=method, seed=seed)
                if budget == "thresholds":
                    changed = _by_thresholds(changed)
                else:  # trees fill the budget whatever the gradients are
                    full = replace(changed.frontier, threshold=0.0)
                    changed = replace(changed, frontier=full)
                shares = is_tree or method == "lapis"
                yield Job(f"{budget}-{method}-{seed}", changed, config.n_levels, shares)


def _by_thresholds(config: Config) -> Config:
    """Growth by thresholds, of baselines the published ones, where `config` fills a budget.

    Shorter levels densify less often than published ones, which keeps layers small. As often as
    published they explode: at 100 pixels LapisGS had 206,184 splats after 337 iterations. A tree
    splits in as many rounds as published, five, in the same part of a level; by the threshold of
    clouds it would end with a sixth of the splats of LapisGS, by this one with under a half.
    """
    published = FrontierGrowth()
    return replace(
        config,
        max_splats=tuple(UNBOUNDED for _ in config.max_splats),
        frontier=replace(
            config.frontier, threshold=THRESHOLD, rounds=published.rounds, stop=published.stop
        ),
        equal_buckets=True,
    )


def run_job(job: Job, data: Dataset, out: Path, device: str, finer: Dataset | None = None) -> None:
    """Run a job, or the rest of it, unless its result is there; `finer` is as of `run`."""
    folder = out / job.name
    result = folder / "result.json"
    if result.exists():
        return
    keep_freed_memory()
    folder.mkdir(parents=True, exist_ok=True)
    scales = pyramid_of(data, job.n_scales)
    pyramid, more = scales[: job.config.n_levels], scales[job.config.n_levels :]
    finer = next(iter(more), finer) if job.config.shifts else None
    base = read_tree(out / "level0" / "tree.tree.npz") if job.shares else None
    progress = Progress(folder / "log.csv", shows_bar=True)
    tree = run(
        job.config,
        pyramid,
        backend_for(device),
        folder=folder,
        resume=True,
        base=base,
        finer=finer,
        progress=progress,
    )
    write_tree(folder / "tree.tree.npz", tree)
    report = {
        "name": job.name,
        "config": job.config.as_dict(),
        "data": {"name": data.name, "train": len(data.train), "test": len(data.test)},
        "seconds": round(progress.seconds, 3),
        "machine": machine(device),
        "threads": numba.get_num_threads(),
        "refines_save": progress.refines_save,
        "levels": evaluate(tree, job.config.method, pyramid, folder / "pictures"),
    }
    write_atomic(result, (json.dumps(report, indent=1) + "\n").encode())
    (folder / FILE).unlink(missing_ok=True)


if __name__ == "__main__":
    main()
