"""Quality against bytes: a stream cut at 20 places, in several orders and codings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from evogs_codec import (
    PRESETS,
    EvolutionTree,
    SplatParams,
    choose_cut,
    decode,
    encode,
    extract,
    read_directory,
)
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.measured_gains import N_ORDERING_VIEWS
from evogs_codec.model.splats import I64
from evogs_codec.model.tree import Slots
from evogs_codec.render import cameras_around
from evogs_codec.render.viewpoints import SIZE
from evogs_codec.render.views import Views
from tools.bench.paper import plots
from tools.bench.paper.measured import Bench
from tools.bench.paper.orders import Records, by_energy, by_opacity, reordered
from tools.bench.paper.report import Figure, Rows, Section, Table
from tools.bench.paper.runs import BUDGETS, TITLES, Run

__all__ = ["CODINGS", "ORDERS", "curve", "raw_cuts", "rows", "section", "stream_name", "summary"]

N_CUTS = 20
ORDERS = {
    "energy": ("evogs", "by the norm of psi"),
    "packets": ("evogs", "in our packet order"),
    "opacity": ("lapis", "by opacity"),
}
CODINGS = {
    "raw": "raw",
    "paper": "--preset paper",
    "trained": "--preset trained, or a tree's integers",
}
Cut = tuple[int, int, SplatParams]  # its number, from 1; bytes; leaves


def section(bench: Bench) -> Section:
    """Curves of every budget that has runs."""
    found = rows(bench)
    text = (
        f"A stream of level 0 to the last, cut at each {100 // N_CUTS} % of its bytes, drawn at "
        f"full size on {bench.views.most} held-out views or fewer. Levels come one after the "
        "other; in a level EvoGS sends the records of the largest psi first, no child before its "
        "parent, or packets as our encoder orders them; LapisGS sends what makes the most opaque "
        "splats first. Raw streams are cut between records, coded ones between packets as `evogs "
        "extract --max-bytes` does, whose bytes are those of the smaller file. A coded stream in "
        "the paper's orders has a step for every part of it, which costs some bytes."
    )
    if not found:
        return Section("Quality against bytes", f"{text}\n\nNo run of EvoGS or LapisGS yet.")
    figures = [
        Figure(
            f"streaming-{budget}",
            f"Quality against bytes, {budget}",
            partial(plots.curves, [row for row in found if row["budget"] == budget]),
        )
        for budget in BUDGETS
        if any(row["budget"] == budget for row in found)
    ]
    tables = [
        Table("streaming-summary", "Of the curves", summary(found)),
        Table("streaming", "All cuts; on the page four of each curve", found, _quarters(found)),
    ]
    return Section("Quality against bytes", text, tables, figures)


def rows(bench: Bench) -> Rows:
    """A row for every budget, order, coding and cut."""
    out: Rows = []
    for budget in BUDGETS:
        for order, (method, _) in ORDERS.items():
            run = bench.first(budget, method)
            for coding in CODINGS if run else ():
                assert run is not None
                out += _measured(bench, run, order, coding)
    return out


def stream_name(order: str) -> str:
    """The method and how its records are sent."""
    method, words = ORDERS[order]
    return f"{TITLES[method]} {words}"


def curve(
    tree: EvolutionTree, order: str, coding: str, decibels: Callable[[SplatParams], float]
) -> list[dict[str, int | float]]:
    """Bytes, splats and dB at the cuts of a stream of an order and a coding."""
    cuts = raw_cuts(tree, order) if coding == "raw" else _coded_cuts(tree, order, coding)
    return [
        {"cut": k, "bytes": n_bytes, "splats": len(splats), "PSNR, dB": decibels(splats)}
        for k, n_bytes, splats in cuts
    ]


def raw_cuts(tree: EvolutionTree, order: str) -> Iterator[Cut]:
    """Bytes and leaves at each cut of the uncompressed records."""
    arranged, records, sequence = _in_order(tree, order)
    ends, n_bytes = _ends(records, sequence)
    cut, counts = reordered(arranged, records, sequence, ends)
    states = cut.states()
    applied, state = 0, Slots(np.zeros((len(tree.steps[0].psi), 0)), np.zeros(0, bool))
    for k, (count, size) in enumerate(zip(counts, n_bytes, strict=True)):
        for _ in range(count - applied):
            state = next(states)
        applied = count
        yield k + 1, size, state.splats()


def summary(cuts: Rows) -> Rows:
    """What the curves are worth: one row each.

    Those of a budget and coding are averaged over the bytes that all of them have cuts at; a stream
    that is complete stays as it is.
    """
    curves: dict[tuple[str, str], dict[str, Rows]] = {}
    for row in cuts:
        together = curves.setdefault((row["budget"], row["coding"]), {})
        together.setdefault(row["stream"], []).append(row)
    out: Rows = []
    for (budget, coding), together in curves.items():
        low = max(found[0]["bytes"] for found in together.values())
        high = max(found[-1]["bytes"] for found in together.values())
        out += [
            {"budget": budget, "coding": coding, "stream": stream} | _worth(found, low, high)
            for stream, found in together.items()
        ]
    return out


def _worth(found: Rows, low: int, high: int) -> dict[str, float]:
    """Of one curve; the mean is over the bytes from `low` to `high`, straight between cuts."""
    n_bytes = [row["bytes"] for row in found]
    quality = [row["PSNR, dB"] for row in found]
    rises = np.diff(quality)
    between = np.interp(np.linspace(low, high, 1001), n_bytes, quality)
    return {
        "total MB": n_bytes[-1] / 1e6,
        "last, dB": quality[-1],
        "largest jump, dB": float(rises.max(initial=0.0)),
        "deepest fall, dB": float((-rises).max(initial=0.0)),
        "cuts that do not fall, %": 100 * float(np.mean([True, *(rises >= 0)])),
        "mean over bytes, dB": float(between.mean()),
    }


def _measured(bench: Bench, run: Run, order: str, coding: str) -> Rows:
    """The rows of a curve."""
    last = len(bench.views.pyramid) - 1

    def measure(run: Run) -> list[dict[str, int | float]]:
        def decibels(splats: SplatParams) -> float:
            return bench.views.psnr(splats, last, bench.views.most)

        return curve(run.tree(), order, coding, decibels)

    found = bench.measure(run, f"streaming-{order}-{coding}", measure, PRESETS.get(coding))
    names = {
        "budget": run.budget,
        "stream": stream_name(order),
        "coding": CODINGS[coding],
    }
    return [names | row for row in found]


def _in_order(tree: EvolutionTree, order: str) -> tuple[EvolutionTree, Records, I64]:
    """A tree with its records and the order in which they are sent."""
    if order == "packets":
        (tree,) = arrange(tree, 1)
        records = Records.of(tree)
        return tree, records, np.arange(len(records.step))
    records = Records.of(tree)
    return tree, records, by_energy(records) if order == "energy" else by_opacity(records)


def _ends(records: Records, sequence: I64) -> tuple[list[int], list[int]]:
    """Where the cuts are in the sequence, and the bytes before each."""
    sizes = np.cumsum(records.n_bytes[sequence])
    total = int(sizes[-1])
    wanted = [total * k // N_CUTS for k in range(1, N_CUTS)]
    ends = [*np.searchsorted(sizes, wanted, side="right").tolist(), len(sequence)]
    return ends, [int(sizes[end - 1]) if end else 0 for end in ends]


def _coded_cuts(tree: EvolutionTree, order: str, coding: str) -> Iterator[Cut]:
    """Bytes and leaves at each cut of a stream of a preset, first packets at least."""
    leaves = tree.leaves()
    pictures = Views(leaves, cameras_around(leaves, "z", SIZE, n=N_ORDERING_VIEWS))
    if order != "packets":
        arranged, records, sequence = _in_order(tree, order)
        arranged, _ = reordered(arranged, records, sequence, _ends(records, sequence)[0])
        tree = replace(arranged, quanta=tree.quanta)
    settings = None if coding == "trained" and tree.quanta else PRESETS[coding]
    data = encode(tree, settings, views=pictures)
    directory = read_directory(data)
    for k in range(1, N_CUTS + 1):
        try:
            cut = choose_cut(directory, max_bytes=len(data) * k // N_CUTS)
        except ValueError:  # not even one packet fits
            continue
        yield k, len(extract(data, cut)), decode(data, cut).leaves()


def _quarters(cuts: Rows) -> Rows:
    """One row for each curve: dB at a quarter, half, three quarters and all of its bytes."""
    names = ("budget", "coding", "stream")
    out: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in cuts:
        own = out.setdefault(tuple(row[n] for n in names), {n: row[n] for n in names})
        if row["cut"] % (N_CUTS // 4) == 0:
            own[f"at {100 * row['cut'] // N_CUTS} %, dB"] = row["PSNR, dB"]
    return list(out.values())
