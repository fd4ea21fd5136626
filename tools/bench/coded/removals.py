"""What each class of numbers of a tree is worth: the tree without it, against its own curve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from evogs_codec import EvolutionTree, encode
from evogs_codec.model.channels import CLASS_NAMES, GROUPS, channel_class
from evogs_codec.model.tree import Kind
from tools.bench.coded.bd_rate import Curve, psnr_at
from tools.bench.paper.runs import Views

__all__ = ["removals", "without", "worth"]

Rows = list[dict[str, Any]]


def without(tree: EvolutionTree) -> Iterator[tuple[str, EvolutionTree]]:
    """The tree without one class of numbers each, which all its splits and refines have.

    Psi of a class become 0, alphas of a group the one that the paper's symmetric trees have, and
    refines go.
    """
    kinds = np.array([channel_class(c) for c in range(len(tree.steps[0].adds))])
    for kind in range(kinds.max() + 1):
        rows = kinds == kind
        steps = [replace(s, psi=np.where(rows[:, None], np.float32(0), s.psi)) for s in tree.steps]
        yield f"psi of {CLASS_NAMES[kind]}", replace(tree, steps=tuple(steps))
    for group, name in enumerate(GROUPS):
        steps = []
        for step in tree.steps:
            alpha = step.alpha.copy()
            alpha[group] = 1
            steps.append(replace(step, alpha=alpha))
        yield f"alpha of {name}", replace(tree, steps=tuple(steps))
    steps = []
    for step in tree.steps:
        stays = step.kinds != Kind.REFINE
        psi = step.psi[:, stays[step.kinds != Kind.DROP]]
        steps.append(replace(step, slots=step.slots[stays], kinds=step.kinds[stays], psi=psi))
    yield "refines", replace(tree, steps=tuple(steps))


def removals(tree: EvolutionTree, views: Views) -> Rows:
    """A row for each class of numbers: bytes that go with it, and dB of the last level.

    Nothing is trained again.
    """
    last = tree.n_levels - 1
    whole = len(encode(tree)), views.psnr(tree.leaves(), last)
    rows: Rows = []
    for name, rest in without(tree):
        n_bytes = len(encode(rest))
        lost = whole[1] - views.psnr(rest.leaves(), last)
        rows.append({"without": name, "bytes": whole[0] - n_bytes, "lost": lost, "whole": whole[0]})
    return rows


def worth(rows: Rows, curve: Curve) -> Rows:
    """What as many bytes are worth on the curve of the method, beside what goes with a class.

    None where the curve does not rise.
    """
    out: Rows = []
    for row in rows:
        try:
            less = row["whole"] - row["bytes"]
            along = psnr_at(curve, row["whole"]) - psnr_at(curve, less)
        except ValueError:
            along = None
        out.append(
            {
                "without": row["without"],
                "kB less": row["bytes"] / 1e3,
                "dB less": row["lost"],
                "dB less by distortion": along,
            }
        )
    return out
