"""Tables of what runs measured themselves: quality, sizes, transparent splats (tables 1 to 4)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from tools.bench.paper import plots
from tools.bench.paper.lpips import Lpips
from tools.bench.paper.measured import Bench
from tools.bench.paper.report import Figure, Rows, Section, Table, pivot
from tools.bench.paper.runs import BUDGETS, TITLES, Run

__all__ = ["ablation", "means", "quality", "transparency"]


def quality(bench: Bench, lpips: Lpips) -> Section:
    """Table 1: all methods at all levels."""
    rows = means(bench, lpips)
    text = (
        "Means over the held-out views, then over seeds; each level at the size of its own "
        "photographs, of which the first are an eighth as large. Storage is what a client must "
        "have for a level: numbers times four bytes, without compression. Memory is that of the "
        "splats drawn. Monolithic stores a model per level, Single one in all. " + lpips.says
    )
    if not rows:
        return Section("Quality, storage and memory", f"{text}\n\nNo run yet.")
    metrics = ["PSNR, dB", "SSIM", *(["LPIPS"] if lpips.measure else [])]
    tables, figures = [], []
    for budget, title in BUDGETS.items():
        own = [row for row in rows if row["budget"] == budget]
        if not own:
            continue
        kept = [{k: v for k, v in row.items() if k != "budget"} for row in own]
        same = ("method", "seeds", "level")
        tables += [
            Table(
                f"quality-{budget}",
                f"{title}: quality",
                own,
                pivot([{k: r[k] for k in (*same, *metrics)} for r in kept], "level", metrics),
            ),
            Table(
                f"sizes-{budget}",
                f"{title}: storage and memory",
                [{k: r[k] for k in (*same, *SIZES, "splats")} for r in kept],
                pivot([{k: r[k] for k in (*same, *SIZES)} for r in kept], "level", SIZES),
            ),
        ]
        figures.append(
            Figure(
                f"quality-{budget}",
                f"{title}: quality against storage",
                partial(plots.scatter, own),
            )
        )
    return Section("Quality, storage and memory", text, tables, figures)


SIZES = ["storage, MB", "memory, MB"]


def means(bench: Bench, lpips: Lpips | None = None) -> Rows:
    """A row for every budget, method and level: means over seeds."""
    rows: Rows = []
    for budget in BUDGETS:
        for method, title in TITLES.items():
            runs = bench.of(budget, method)
            for level in range(len(bench.views.pyramid) if runs else 0):
                found = [run.levels[level] for run in runs]
                row: dict[str, Any] = {
                    "budget": budget,
                    "method": title,
                    "seeds": len(runs),
                    "level": level,
                    "PSNR, dB": _mean(found, "psnr"),
                    "SSIM": _mean(found, "ssim"),
                }
                if lpips is not None and lpips.measure:
                    row["LPIPS"] = float(np.mean([lpips.of(bench, run)[level] for run in runs]))
                row |= {
                    "storage, MB": _mean(found, "storage_bytes") / 1e6,
                    "memory, MB": _mean(found, "footprint_bytes") / 1e6,
                    "splats": round(_mean(found, "splats")),
                    "transparent, %": 100 * _mean(found, "transparent"),
                    "PSNR least, dB": min(row["psnr"] for row in found),
                    "PSNR most, dB": max(row["psnr"] for row in found),
                }
                rows.append(row)
    return rows


def ablation(bench: Bench) -> Section:
    """Table 2: the symmetric tree against the asymmetric one."""
    rows: Rows = []
    for budget in BUDGETS:
        pair = [bench.of(budget, method) for method in ("evogs-sym", "evogs")]
        if not all(pair):
            continue
        for level in range(len(bench.views.pyramid)):
            symmetric, asymmetric = ([run.levels[level] for run in runs] for runs in pair)
            quality = [_mean(found, "psnr") for found in (symmetric, asymmetric)]
            sizes = [_mean(found, "storage_bytes") / 1e6 for found in (symmetric, asymmetric)]
            rows.append(
                {
                    "budget": budget,
                    "level": level,
                    "symmetric, dB": quality[0],
                    "asymmetric, dB": quality[1],
                    "gain, dB": quality[1] - quality[0],
                    "symmetric, MB": sizes[0],
                    "asymmetric, MB": sizes[1],
                    "more stored, %": 100 * (sizes[1] / sizes[0] - 1),
                    "seeds": min(len(runs) for runs in pair),
                }
            )
    title = "Symmetric against asymmetric"
    if not rows:
        return Section(title, "Needs runs of `evogs` and `evogs-sym` at the same budget.")
    text = "Means over seeds. Symmetric is alpha = 1 for every group of every split."
    return Section(title, text, [Table("ablation", "Both trees", rows)])


def transparency(bench: Bench) -> Section:
    """Tables 3 and 4: splats below an opacity of 0.005, in all and by layer."""
    rows, layers, heights = [], [], {}
    for budget in BUDGETS:
        panel = {}
        for method, title in TITLES.items():
            runs = bench.of(budget, method)
            if not runs:
                continue
            n = len(bench.views.pyramid)
            shares = [
                100 * _mean([run.levels[level] for run in runs], "transparent")
                for level in range(n)
            ]
            panel[title] = shares
            rows.append(
                {"budget": budget, "method": title, "seeds": len(runs)}
                | {f"L{level}, %": share for level, share in enumerate(shares)}
            )
            layers += [_by_layer(budget, title, runs, level, n) for level in range(n)]
        if panel:
            heights[BUDGETS[budget]] = panel
    title = "Transparent splats"
    if not rows:
        return Section(title, "No run yet.")
    text = (
        "Splats drawn whose opacity after activation is below 0.005. The layer of a splat of a "
        "tree is the level at which its slot was made; the first child of a split keeps its "
        "parent's."
    )
    own = [row for row in layers if row["method"] in ("LapisGS", "EvoGS", "EvoGS symmetric")]
    return Section(
        title,
        text,
        [
            Table("transparent", "Of all splats drawn", rows),
            Table("transparent-by-layer", "By layer", layers, own),
        ],
        [
            Figure(
                "transparent", "Transparent splats", partial(plots.bars, heights, "transparent, %")
            )
        ],
    )


def _by_layer(budget: str, title: str, runs: list[Run], level: int, n: int) -> dict[str, Any]:
    row: dict[str, Any] = {"budget": budget, "method": title, "level": level}
    for layer in range(n):
        found = [
            run.levels[level]["transparent_by_layer"][str(layer)]
            for run in runs
            if str(layer) in run.levels[level]["transparent_by_layer"]
        ]
        row[f"layer {layer}, %"] = 100 * float(np.mean(found)) if found else None
    return row


def _mean(rows: Rows, key: str) -> float:
    return float(np.mean([row[key] for row in rows]))
