"""The refinements of a tree: how their energy concentrates, and how each group is distributed.

Letters: D channels, P refinements (a column of psi each).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from evogs_codec import EvolutionTree
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS
from evogs_codec.model.splats import F64
from tools.bench.paper import plots
from tools.bench.paper.measured import Bench
from tools.bench.paper.report import Figure, Rows, Section, Table
from tools.bench.paper.runs import BUDGETS, TITLES

__all__ = ["concentration", "distribution", "refinements", "section"]

METHODS = ("evogs-sym", "evogs", "evogs-a", "evogs-b")
SHARES = (0.5, 0.8, 0.9, 0.95, 0.99)  # of the energy
N_POINTS = 101
N_BINS = 81
WIDEST = 0.995  # of the values are in the histogram


def section(bench: Bench) -> Section:
    """Energy and distribution, of the first seed of each tree."""
    rows: Rows = []
    spreads: Rows = []
    panels: dict[str, dict[str, Any]] = {}
    histograms: dict[str, dict[str, Any]] = {}
    for budget in BUDGETS:
        for method in METHODS:
            run = bench.first(budget, method)
            if run is None:
                continue
            name = {"budget": budget, "method": TITLES[method]}
            label = f"{TITLES[method]}, {budget}"
            found = bench.measure(run, "energy", lambda r: concentration(r.tree()))
            rows += [name | {"of": of} | found[of]["needed"] for of in ("refinements", "numbers")]
            for of in ("refinements", "numbers"):
                line = np.linspace(0, 100, N_POINTS).tolist(), found[of]["curve"]
                panels.setdefault(f"largest {of}", {})[label] = line
            if method not in ("evogs", "evogs-sym"):
                continue
            found = bench.measure(run, "distribution", lambda r: distribution(r.tree()))
            spreads += [name | {"group": group} | found[group]["spread"] for group in GROUPS]
            for group in GROUPS:
                line = found[group]["centres"], found[group]["density"]
                histograms.setdefault(group, {})[label] = line
    text = (
        "Psi of all splits and refines above level 0, as trained: of a tree in integers, multiples "
        "of its quanta. "
        "Refinements are sorted by the norm of psi, in the raw units of the groups; numbers are "
        "its channels one by one."
    )
    title = "Energy and distribution of psi"
    if not rows:
        return Section(title, f"{text}\n\nNo run of a tree yet.")
    return Section(
        title,
        text,
        [
            Table("energy", "Part of all, in %, that carries a part of the energy", rows),
            Table("distribution", "Psi per group", spreads),
        ],
        [
            Figure(
                "energy",
                "Cumulative energy of psi",
                lambda: plots.lines(panels, "part of all, %", "part of the energy, %"),
            ),
            Figure(
                "distribution",
                "Distribution of psi",
                lambda: plots.lines(histograms, "psi", "density", logarithmic=True),
            ),
        ],
    )


def refinements(tree: EvolutionTree) -> F64:
    """(D, P) psi above level 0."""
    psi = [step.psi for step in tree.steps if step.level]
    return np.concatenate([*psi, tree.steps[0].psi[:, :0]], axis=1).astype(np.float64)


def concentration(tree: EvolutionTree) -> dict[str, Any]:
    """Cumulative energy over the largest refinements, and over the largest numbers, in %."""
    squares = np.square(refinements(tree))
    return {"refinements": _cumulative(squares.sum(0)), "numbers": _cumulative(squares.ravel())}


def distribution(tree: EvolutionTree) -> dict[str, Any]:
    """A histogram and the spread of each group."""
    psi = refinements(tree)
    out = {}
    for group, channels in zip(GROUPS, GROUP_CHANNELS, strict=True):
        values = psi[channels].ravel()
        if not len(values):
            values = np.zeros(1)
        edge = float(np.quantile(np.abs(values), WIDEST)) or 1.0
        density, edges = np.histogram(values, N_BINS, (-edge, edge), density=True)
        points = np.quantile(values, (0.05, 0.25, 0.5, 0.75, 0.95))
        names = ("5th percentile", "25th", "median", "75th", "95th")
        out[group] = {
            "centres": ((edges[1:] + edges[:-1]) / 2).tolist(),
            "density": density.tolist(),
            "spread": {"deviation": float(values.std())}
            | dict(zip(names, points.tolist(), strict=True)),
        }
    return out


def _cumulative(energies: F64) -> dict[str, Any]:
    falling = np.sort(energies)[::-1]
    total = np.concatenate([[0.0], np.cumsum(falling)])
    part = total / (total[-1] or 1.0)
    at = np.linspace(0, len(energies), N_POINTS)
    needed = [int(np.searchsorted(part, share)) / max(len(energies), 1) for share in SHARES]
    return {
        "curve": (100 * np.interp(at, np.arange(len(part)), part)).tolist(),
        "needed": {f"for {s:.0%}, %": 100 * n for s, n in zip(SHARES, needed, strict=True)},
    }
