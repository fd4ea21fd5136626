"""What the paper claims, and what the runs say: one row each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tools.bench.paper import compression
from tools.bench.paper.measured import Bench
from tools.bench.paper.quality import means
from tools.bench.paper.report import Rows, Section, Table
from tools.bench.paper.runs import BUDGETS, TITLES
from tools.bench.paper.streaming import CODINGS, stream_name, summary
from tools.bench.paper.streaming import rows as rows_of_curves

__all__ = ["rows", "section"]

LEAST, MOST = "at least", "at most"
# Budgets of EvoGS and of LapisGS. The last pair is what someone chooses between who has a budget.
PAIRS = (*((budget, budget) for budget in BUDGETS), ("equal", "thresholds"))
PAPER_GAINS = ("", "+0.40", "+0.74", "+0.19")  # its table 1, of four levels


def section(bench: Bench) -> Section:
    """The first thing that a reader wants."""
    found = rows(bench)
    text = (
        "What the paper says of EvoGS, and the means over the seeds of these runs. The bars are "
        "ours. The paper's figures against LapisGS are of its Blender scenes, the others averages "
        "over all its data sets; its curves have no figures."
    )
    if not found:
        return Section("The paper's claims", f"{text}\n\nNo pair of runs to compare yet.")
    return Section("The paper's claims", text, [Table("claims", "Claims", found)])


def rows(bench: Bench) -> Rows:
    """Every claim that the runs can speak to."""
    return [*_of_runs(bench), *_of_streams(bench), *_of_curves(bench)]


def _of_runs(bench: Bench) -> Iterator[dict[str, Any]]:
    """EvoGS against LapisGS and the symmetric tree."""
    at = {(row["budget"], row["method"], row["level"]): row for row in means(bench)}
    last = len(bench.views.pyramid) - 1

    def levels(method: str, budget: str) -> list[dict[str, Any] | None]:
        return [at.get((budget, TITLES[method], level)) for level in range(last + 1)]

    for budget, others in PAIRS:
        name = budget if budget == others else f"{budget}, LapisGS by {others}"
        own, lapis = levels("evogs", budget), levels("lapis", others)
        for level, (a, b) in enumerate(zip(own, lapis, strict=True)):
            if level and a and b:
                gain = a["PSNR, dB"] - b["PSNR, dB"]
                paper = PAPER_GAINS[level] if last == len(PAPER_GAINS) - 1 else ""
                yield _claim(f"PSNR over LapisGS at L{level}, dB", name, gain, LEAST, 0.0, paper)
        a, b = own[last], lapis[last]
        if others == "thresholds" and a and b:
            for size, bar, paper in (("storage", 60.0, "47"), ("memory", 50.0, "18")):
                part = 100 * a[f"{size}, MB"] / b[f"{size}, MB"]
                yield _claim(f"{size} at L{last}, % of LapisGS", name, part, MOST, bar, paper)
    for budget in BUDGETS:
        a, b = levels("evogs", budget)[last], levels("evogs-sym", budget)[last]
        if a:
            share = a["transparent, %"]
            yield _claim(f"transparent splats at L{last}, %", budget, share, MOST, 25.0, "24.92")
        if a and b:
            gain = a["PSNR, dB"] - b["PSNR, dB"]
            yield _claim(f"PSNR over symmetric at L{last}, dB", budget, gain, LEAST, 0.5, "+1.01")


def _of_streams(bench: Bench) -> Iterator[dict[str, Any]]:
    """What our codec makes of EvoGS."""
    for row in compression.rows(bench):
        level, budget = row["level"], row["budget"]
        how = {compression.AIMED: "", compression.PRESET: ", --preset trained"}.get(row["coding"])
        if how is None or row["method"] != TITLES["evogs"] or level != len(bench.views.pyramid) - 1:
            continue
        text = f"encoded{how}: times smaller than raw at L{level}"
        yield _claim(text, budget, row["smaller, times"], LEAST, 8.7, "3.8")
        run = bench.first(budget, "evogs")
        of = " of the tree in integers" if run is not None and run.tree().quanta else ""
        text = f"encoded{how}: lost at L{level}{of}, dB"
        yield _claim(text, budget, row["lost, dB"], MOST, 0.1, "0.10")


def _of_curves(bench: Bench) -> Iterator[dict[str, Any]]:
    """Raw streams of EvoGS and LapisGS in the paper's orders."""
    raw = [row for row in summary(rows_of_curves(bench)) if row["coding"] == CODINGS["raw"]]
    at = {(row["budget"], row["stream"]): row for row in raw}
    for budget in BUDGETS:
        own, lapis = (at.get((budget, stream_name(order))) for order in ("energy", "opacity"))
        if own and lapis:
            jump = 100 * own["largest jump, dB"] / max(lapis["largest jump, dB"], 1e-9)
            yield _claim("largest jump of a raw stream, % of LapisGS", budget, jump, MOST, 100.0)
            gain = own["mean over bytes, dB"] - lapis["mean over bytes, dB"]
            yield _claim("raw PSNR over LapisGS, mean over bytes, dB", budget, gain, LEAST, 0.0)


def _claim(
    text: str, budget: str, measured: float, side: str, bar: float, paper: str = ""
) -> dict[str, Any]:
    met = measured >= bar if side == LEAST else measured <= bar
    return {
        "claim": text,
        "budget": budget,
        "measured": measured,
        "bar": f"{side} {bar:g}",
        "met": "yes" if met else "no",
        "paper": paper,
    }
