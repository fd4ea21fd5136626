"""The page: every section of the paper's experiments, from the runs that there are."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tools.bench.paper import claims, compression, foveal, options, plots, psi, quality, streaming
from tools.bench.paper.lpips import find_lpips
from tools.bench.paper.measured import Bench
from tools.bench.paper.report import Figure, Rows, Section, Table, write_report
from tools.bench.paper.runs import BUDGETS, TITLES

__all__ = ["sections", "write_paper"]

SAMPLED = ("mono", "lapis", "l3gs", "evogs-sym", "evogs")


def write_paper(bench: Bench, path: Path, command: str, missing: Sequence[str]) -> None:
    """Measure what was not measured before, and write the page, its tables and figures."""
    data = bench.views.pyramid[-1]
    camera = bench.views.held_out(len(bench.views.pyramid) - 1)[0].camera
    held_out = f"{len(data.test)} held out" if data.test else "none held out: measured on these"
    in_integers = any(run.config.get("integers", {}).get("part", 0.0) for run in bench.runs)
    numbers = "trained in integers" if in_integers else "in floats"
    head = (
        f"# The paper's comparison, {camera.width} pixels, {numbers}\n\n"
        f"Made by `{command}`: the photographs of `{data.name}`, {camera.width} x {camera.height} "
        f"at the last of {len(bench.views.pyramid)} levels, {len(data.train)} to train on and "
        f"{held_out}. Every number is in a CSV file beside this page."
    )
    write_report(path, head, sections(bench, missing))


def sections(bench: Bench, missing: Sequence[str]) -> list[Section]:
    """The page without its head; `missing` names runs that were asked for and are not there."""
    return [
        _runs(bench, missing),
        claims.section(bench),
        quality.quality(bench, find_lpips()),
        quality.ablation(bench),
        options.section(bench),
        quality.transparency(bench),
        compression.section(bench),
        psi.section(bench),
        streaming.section(bench),
        foveal.section(bench),
        _samples(bench),
    ]


def _runs(bench: Bench, missing: Sequence[str]) -> Section:
    """What was trained, and what was not."""
    rows: Rows = [
        {
            "run": run.folder.name,
            "seconds": round(run.seconds),
            "on": run.machine,
            "iterations": " ".join(str(n) for n in run.config["iterations"]),
            "more in integers, %": 100 * run.config.get("integers", {}).get("part", 0.0),
            "most splats": " ".join(str(n) for n in run.config["max_splats"]),
            "SH degree": run.config["sh_degree"],
        }
        for run in bench.runs
    ]
    text = "All runs that were asked for are here."
    if missing:
        text = f"Not trained yet: {', '.join(missing)}. Tables leave them out."
    return Section("Runs", text, [Table("runs", "Finished", rows)] if rows else [])


def _samples(bench: Bench) -> Section:
    """The first held-out view of every level, side by side."""
    names = [f"L{level}" for level in range(len(bench.views.pyramid))]
    figures = []
    for budget, title in BUDGETS.items():
        runs = [run for method in SAMPLED if (run := bench.first(budget, method)) is not None]
        if not runs:
            continue
        pictures = [run.folder / "pictures" for run in runs]
        columns: dict[str, list[Path | None]] = {
            "photograph": [_there(pictures[0] / f"{name}-photograph.png") for name in names]
        }
        for run, folder in zip(runs, pictures, strict=True):
            columns[TITLES[run.method]] = [_there(folder / f"{name}.png") for name in names]
        figures.append(
            Figure(
                f"samples-{budget}",
                f"{title}: renders",
                partial(plots.grid_of_pictures, columns, names),
            )
        )
    text = "The first held-out view, at the size of each level; first seeds."
    return Section("Renders", text if figures else f"{text}\n\nNo run yet.", figures=figures)


def _there(path: Path) -> Path | None:
    return path if path.exists() else None
