"""The paper's design space: options A to D with the same schedule, and parents for children."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, Kind, SplatParams
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS
from reference_trainer.evaluate import storage
from tools.bench.paper.measured import Bench
from tools.bench.paper.report import Rows, Section, Table
from tools.bench.paper.runs import Run

__all__ = ["OPTIONS", "section", "with_parents"]

MIXED = "evogs-mixed"  # no option of the paper: its runs are shown where they are there
OPTIONS = {
    "evogs-a": "A: independent children",
    "evogs-b": "B: independent residuals",
    "evogs-sym": "C: symmetric",
    "evogs": "D: asymmetric",
    MIXED: "M: mixed, D with parents refined",
}


def section(bench: Bench) -> Section:
    """A row for every option and level, at the equal budget."""
    rows: Rows = []
    missing = []
    for method, option in OPTIONS.items():
        run = bench.first("equal", method)
        if run is None:
            if method != MIXED:
                missing.append(option)
            continue
        found = bench.measure(run, "options", partial(_levels, bench))
        rows += [{"option": option} | row for row in found]
    text = (
        "First seed of each, at the equal budget, all from the same level 0. Numbers a split are "
        "those stored at a level over its splits, those of refines and pruned siblings included. "
        "Parents for children: every pair of leaves that a split of this level made is replaced by "
        "its parent, as a client draws it that has not received the split yet. The level before is "
        "drawn at the size of this one."
    )
    if missing:
        text += f"\n\nNot there yet: {', '.join(missing)}."
    tables = [Table("options", "Options A to D", rows)] if rows else []
    return Section("The design space: options A to D", text, tables)


def with_parents(tree: EvolutionTree, level: int) -> tuple[SplatParams, int]:
    """The leaves of a level, each pair that a split of it made replaced by its parent; the pairs.

    A pair is two leaves that no later record has split or dropped.
    """
    made = np.full(sum(step.n_new for step in tree.steps), -1, np.int64)
    d = len(tree.steps[0].psi)
    values, live = np.zeros((d, 0)), np.zeros(0, bool)
    parents: list[npt.NDArray[np.float64]] = [np.zeros((d, 0))]
    n_splits = 0
    for step, state in zip(tree.steps, tree.states(), strict=True):
        if step.level > level:
            break
        if step.level == level:
            slots = step.slots[step.kinds == Kind.SPLIT]
            number = n_splits + np.arange(len(slots))
            parents.append(values[:, slots])
            made[slots] = number
            made[len(live) : len(live) + len(slots)] = number
            n_splits += len(slots)
        values, live = state.values.copy(), state.live.copy()
    made = made[: len(live)]
    children = live & (made >= 0)
    pairs = np.bincount(made[children], minlength=n_splits) == 2
    replaced = children.copy()
    replaced[children] = pairs[made[children]]
    whole = np.concatenate([values[:, live & ~replaced], np.concatenate(parents, 1)[:, pairs]], 1)
    return SplatParams.from_channels(whole), int(pairs.sum())


def _levels(bench: Bench, run: Run) -> list[dict[str, Any]]:
    tree = run.tree()
    rows = []
    for level in range(1, len(bench.views.pyramid)):
        steps = [step for step in tree.steps if step.level == level]
        kinds = np.concatenate([step.kinds for step in steps])
        n_splits = int(np.count_nonzero(kinds == Kind.SPLIT))
        numbers = (storage(tree, run.method, level) - storage(tree, run.method, level - 1)) / 4
        parents, n_pairs = with_parents(tree, level)
        quality = run.levels[level]["psnr"]
        instead = bench.views.psnr(parents, level)
        psi = np.concatenate([step.psi for step in steps], axis=1).astype(np.float64)
        energy = {
            f"energy, {group}": float(np.square(psi[part]).sum() / max(n_splits, 1))
            for group, part in zip(GROUPS, GROUP_CHANNELS, strict=True)
        }
        rows.append(
            {
                "level": level,
                "splits": n_splits,
                "numbers a split": numbers / max(n_splits, 1),
                "PSNR, dB": quality,
                "pairs": n_pairs,
                "parents for children, dB": instead,
                "lost by it, dB": quality - instead,
                "level before, dB": bench.views.psnr(tree.leaves(level - 1), level),
                "energy of psi a split": sum(energy.values()),
            }
            | energy
        )
    return rows
