"""Table 5: trees and layers as they are, with the paper's compression, and in our streams."""

from __future__ import annotations

from functools import partial
from typing import Any

from evogs_codec import (
    PRESETS,
    Cut,
    InputError,
    decode,
    encode,
    extract,
    read_directory,
)
from evogs_codec.encoding.measured_gains import N_ORDERING_VIEWS
from evogs_codec.encoding.settings import TREE_PSNR
from evogs_codec.render import cameras_around
from evogs_codec.render.viewpoints import SIZE
from evogs_codec.render.views import Views
from tools.bench.paper.measured import Bench
from tools.bench.paper.report import Rows, Section, Table, pivot
from tools.bench.paper.runs import BUDGETS, TITLES, Run
from tools.bench.subjects import aim_of

__all__ = ["AIMED", "PRESET", "compressed", "rows", "section"]

METHODS = ("lapis", "l3gs", "evogs-sym", "evogs", "evogs-mixed")
AIMED = "our codec"  # as `evogs encode` has it by default
PRESET = "--preset trained"
NAMES = {"raw": "raw", "paper": "--preset paper", "trained": PRESET, "aimed": AIMED}
AIMED_METHODS = ("lapis", "evogs")


def section(bench: Bench) -> Section:
    """A row for every run, level and coding."""
    found = rows(bench)
    text = (
        "First seed of each. Coded bytes of a level are those of `evogs extract --level`; PSNR is "
        "of what it decodes to, on all held-out views. `--preset paper` is 8 bits by range and "
        "Zstandard; our codec is `evogs encode` without options: a tree that was trained in "
        f"integers keeps them, others are aimed at {TREE_PSNR:g} dB of the last level against the "
        "trained splats."
    )
    title = "Compressibility"
    if not found:
        return Section(title, f"{text}\n\nNo run of a layered method yet.")
    last = max(row["level"] for row in found)
    values = ["PSNR, dB", "size, MB"]
    names = ("budget", "method", "coding", "level")
    by_level = pivot([{k: row[k] for k in (*names, *values)} for row in found], "level", values)
    ends = [row for row in found if row["level"] == last]
    tables = [
        Table("compression", "All levels", found, by_level),
        Table("compression-last", f"L{last}", ends),
    ]
    return Section(title, text, tables)


def rows(bench: Bench) -> Rows:
    """A row for every budget, method, coding and level."""
    out: Rows = []
    for budget in BUDGETS:
        for method in METHODS:
            run = bench.first(budget, method)
            if run is None:
                continue
            name = {"budget": budget, "method": TITLES[method]}
            by_coding: dict[str, list[dict[str, Any]]] = {
                "raw": [{"bytes": row["storage_bytes"], "psnr": row["psnr"]} for row in run.levels]
            }
            in_integers = bool(run.tree().quanta)
            for preset in ("paper",) if in_integers else ("paper", "trained"):
                by_coding[preset] = bench.measure(
                    run,
                    f"compression-{preset}",
                    partial(compressed, bench, preset),
                    PRESETS[preset],
                )
            if in_integers or method in AIMED_METHODS:
                what = "compression-aimed"
                by_coding["aimed"] = bench.measure(run, what, partial(aimed, bench), TREE_PSNR)
            for coding, levels in by_coding.items():
                for level, row in enumerate(levels):
                    raw = run.levels[level]
                    out.append(
                        name
                        | {
                            "coding": NAMES[coding],
                            "level": level,
                            "size, MB": row["bytes"] / 1e6,
                            "bytes a leaf": row["bytes"] / max(raw["splats"], 1),
                            "PSNR, dB": row["psnr"],
                            "smaller, times": raw["storage_bytes"] / row["bytes"],
                            "lost, dB": raw["psnr"] - row["psnr"],
                        }
                    )
    return out


def compressed(bench: Bench, preset: str, run: Run) -> list[dict[str, Any]]:
    """Bytes and PSNR of each level of a stream."""
    return _levels(bench, encode(run.tree(), PRESETS[preset]))


def aimed(bench: Bench, run: Run) -> list[dict[str, Any]]:
    """As `compressed`, in the integers of the tree, or aimed at a PSNR if that can be met."""
    tree = run.tree()
    leaves = tree.leaves()
    if tree.quanta:
        few = Views(leaves, cameras_around(leaves, "z", SIZE, n=N_ORDERING_VIEWS))
        return _levels(bench, encode(tree, views=few))
    aim = aim_of(tree, PRESETS["trained"], Views(leaves, cameras_around(leaves, "z", SIZE)))
    try:
        return _levels(bench, aim.at_psnr(TREE_PSNR))
    except InputError:
        return []


def _levels(bench: Bench, data: bytes) -> list[dict[str, Any]]:
    directory = read_directory(data)
    found = []
    for level in range(len(bench.views.pyramid)):
        cut = Cut.of_level(directory, min(level, directory.n_levels - 1))
        leaves = decode(data, cut).leaves(sh_degree=directory.sh_degree)
        n_bytes = len(extract(data, cut))
        found.append({"bytes": n_bytes, "psnr": bench.views.psnr(leaves, level)})
    return found
