"""What each class of numbers of a tree is worth: the tree without it, against its own curve."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, encode
from evogs_codec.model.channels import CLASS_NAMES, GROUPS, channel_class
from evogs_codec.model.tree import Kind, Step
from tools.bench.coded.bd_rate import Curve, bytes_at, psnr_at
from tools.bench.paper.measured import Bench
from tools.bench.paper.runs import Run

__all__ = ["removals", "without", "worth"]

Rows = list[dict[str, Any]]
Again = Callable[[EvolutionTree], EvolutionTree]
OF_KINDS = {
    "": (Kind.SPLIT, Kind.REFINE),
    " in splits": (Kind.SPLIT,),
    " in refines": (Kind.REFINE,),
}


def without(tree: EvolutionTree) -> Iterator[tuple[str, EvolutionTree]]:
    """The whole tree, named "nothing", then the tree without each class of numbers that it has.

    Psi of a class become 0, of splits, of refines or of both; alphas of a group become the one in
    their middle, for a whole level; refines go.
    """
    yield "nothing", tree
    rows = np.array([channel_class(c) for c in range(len(tree.steps[0].adds))])
    for kind in range(rows.max() + 1):
        for where, of in OF_KINDS.items():
            steps = tuple(_without_psi(step, rows == kind, of) for step in tree.steps)
            if any((a.psi != b.psi).any() for a, b in zip(steps, tree.steps, strict=True)):
                yield f"psi of {CLASS_NAMES[kind]}{where}", replace(tree, steps=steps)
    for group, name in enumerate(GROUPS):
        steps = tuple(_with_one_alpha(tree, group))
        if any((a.alpha != b.alpha).any() for a, b in zip(steps, tree.steps, strict=True)):
            yield f"alpha of {name}", replace(tree, steps=steps)
    if any((step.kinds == Kind.REFINE).any() for step in tree.steps):
        yield "refines", replace(tree, steps=tuple(map(_without_refines, tree.steps)))


def _without_psi(step: Step, channels: npt.NDArray[np.bool_], of: tuple[int, ...]) -> Step:
    kinds = step.kinds[step.kinds != Kind.DROP]
    gone = channels[:, None] & np.isin(kinds, of)
    return replace(step, psi=np.where(gone, np.float32(0), step.psi))


def _with_one_alpha(tree: EvolutionTree, group: int) -> Iterator[Step]:
    """Steps whose alphas of a group are all the one in the middle of those of their level."""
    for step in tree.steps:
        alpha = step.alpha.copy()
        if alpha.size:
            of_level = [s.alpha[group] for s in tree.steps if s.level == step.level]
            ordered = np.sort(np.concatenate(of_level))
            alpha[group] = ordered[len(ordered) // 2]
        yield replace(step, alpha=alpha)


def _without_refines(step: Step) -> Step:
    stays = step.kinds != Kind.REFINE
    psi = step.psi[:, stays[step.kinds != Kind.DROP]]
    return replace(step, slots=step.slots[stays], kinds=step.kinds[stays], psi=psi)


def removals(bench: Bench, run: Run, again: Again, iterations: int) -> Rows:
    """A row for the whole tree of a run, then for each class that it is without.

    Each has bytes and PSNR of the last level: of the tree as it is, and as `again` trains it for
    more `iterations`.
    """
    rows: Rows = []
    for name, rest in without(run.tree()):

        def measured(_: Run, rest: EvolutionTree = rest) -> dict[str, Any]:
            last, after = rest.n_levels - 1, again(rest)
            return {
                "bytes": len(encode(rest)),
                "psnr": bench.views.psnr(rest.leaves(), last),
                "bytes_again": len(encode(after)),
                "psnr_again": bench.views.psnr(after.leaves(), last),
            }

        what = f"without {name}".replace(" ", "-")
        rows.append({"without": name} | bench.measure(run, what, measured, iterations))
    return rows


def worth(rows: Rows, curve: Curve) -> Rows:
    """What goes with each class, and what the curve of the method has for as many bytes or dB.

    Args:
        rows: as of `removals`.
        curve: bytes and PSNR of the method.

    Returns:
        A row for each class. What is compared with the curve was trained further, the whole tree
        too. "more bytes at equal PSNR" is above 0 where the bytes of the class are well spent; None
        where the curve does not rise, or does not come as low.
    """
    whole, *others = rows
    out: Rows = []
    for row in others:
        less, lost = (whole[k] - row[k] for k in ("bytes_again", "psnr_again"))
        along = more = at = None
        try:
            top = psnr_at(curve, whole["bytes"])
            along = top - psnr_at(curve, whole["bytes"] - less)
            at = bytes_at(curve, top - lost)
        except ValueError:
            pass
        if at is not None:
            more = 100 * ((whole["bytes"] - less) / at - 1)
        out.append(
            {
                "without": row["without"],
                "not trained again: kB less": (whole["bytes"] - row["bytes"]) / 1e3,
                "dB less": whole["psnr"] - row["psnr"],
                "trained again: kB less": less / 1e3,
                "then dB less": lost,
                "dB less by distortion": along,
                "more bytes at equal PSNR, %": more,
            }
        )
    return out
