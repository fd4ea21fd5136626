"""What the paper claims, and what the runs say: one row each."""

from __future__ import annotations

from typing import Any

from reference_trainer.bench import compression
from reference_trainer.bench.measured import Bench
from reference_trainer.bench.quality import means
from reference_trainer.bench.report import Rows, Section, Table
from reference_trainer.bench.runs import BUDGETS, TITLES

__all__ = ["rows", "section"]


def section(bench: Bench) -> Section:
    """The first thing that a reader wants."""
    found = rows(bench)
    text = (
        "What the paper says of EvoGS, and the means over the seeds of these runs. The bars are "
        "ours; the paper's own figures are averages over its data sets."
    )
    if not found:
        return Section("The paper's claims", f"{text}\n\nNo pair of runs to compare yet.")
    return Section("The paper's claims", text, [Table("claims", "Claims", found)])


def rows(bench: Bench) -> Rows:
    """Every claim that the runs can speak to."""
    at = {(r["budget"], r["method"], r["level"]): r for r in means(bench)}
    last = len(bench.views.pyramid) - 1
    out: Rows = []

    def claim(text: str, budget: str, measured: float, bar: float, paper: str, least: bool) -> None:
        met = measured >= bar if least else measured <= bar
        out.append(
            {
                "claim": text,
                "budget": budget,
                "measured": measured,
                "bar": f"{'at least' if least else 'at most'} {bar:g}",
                "met": "yes" if met else "no",
                "paper": paper,
            }
        )

    def pair(budget: str, level: int, method: str) -> tuple[Any, Any] | None:
        keys = [(budget, TITLES[name], level) for name in ("evogs", method)]
        return (at[keys[0]], at[keys[1]]) if all(key in at for key in keys) else None

    for budget in BUDGETS:
        for level in range(1, last + 1):
            if found := pair(budget, level, "lapis"):
                gain = found[0]["PSNR, dB"] - found[1]["PSNR, dB"]
                paper = {1: "+0.40", 2: "+0.74", 3: "+0.19"}.get(level, "") if last == 3 else ""
                text = f"PSNR over LapisGS at L{level}, dB"
                claim(text, budget, gain, 0.0, paper, least=True)
        if budget == "thresholds" and (found := pair(budget, last, "lapis")):
            for size, bar, paper in (("storage", 60.0, "47"), ("memory", 50.0, "18")):
                part = 100 * found[0][f"{size}, MB"] / found[1][f"{size}, MB"]
                text = f"{size} at L{last}, % of LapisGS"
                claim(text, budget, part, bar, paper, least=False)
        if (own := at.get((budget, TITLES["evogs"], last))) is not None:
            text = f"transparent splats at L{last}, %"
            claim(text, budget, own["transparent, %"], 25.0, "24.92", least=False)
        if found := pair(budget, last, "evogs-sym"):
            gain = found[0]["PSNR, dB"] - found[1]["PSNR, dB"]
            claim(f"PSNR over symmetric at L{last}, dB", budget, gain, 0.5, "+1.01", least=True)
    for row in compression.rows(bench):
        if (row["method"], row["level"]) != (TITLES["evogs"], last) or row["coding"] != "our codec":
            continue
        text = f"encoded, times smaller than raw at L{last}"
        claim(text, row["budget"], row["smaller, times"], 8.7, "3.8", least=True)
        text = f"lost by encoding at L{last}, dB"
        claim(text, row["budget"], row["lost, dB"], 0.1, "0.10", least=False)
    return out
