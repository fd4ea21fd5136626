"""Splitting: the steps that make children of parents, none of which looks worse than the parents.

Letters: D channels, S pairs of children.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from evogs_codec.common.parallel import parallel_map
from evogs_codec.lifting.compiled.dispatch import compiled_for
from evogs_codec.lifting.parents import OFF_LINE
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.hiding import hiding
from evogs_codec.model.splats import F32, F64, I64
from evogs_codec.model.tree import Step, alpha_channels

__all__ = ["alpha_of", "split_nodes", "split_steps"]

# Of a number: what it may be off after a split without a refine; a few roundings to float32.
ROUNDING = 2.0**-21

_OPACITY = GROUP_CHANNELS[3]


def split_steps(
    level: int,
    slots: I64,
    n_before: int,
    parents: F64,
    c1: F64,
    c2: F64,
    alpha: F32 | F64,
) -> Iterator[Step]:
    """A split, and where children are on no line with their parent a refine.

    Where alpha of scale and of opacity are `OFF_LINE`, the parent is split into itself, the C2, and
    a C1 that is not seen, and both are refined: pictures of the state between the two steps are
    those of the parents. Of other pairs on no line the C2 alone is refined, which costs less.

    Args:
        level: of the steps.
        slots: (S,) of the parents, then of the C1s.
        n_before: slots before the split; the C2s take those after them.
        parents: (D, S).
        c1: (D, S) children that take the slots of the parents.
        c2: (D, S) children that take new slots.
        alpha: (5, S) of the splits.
    """
    n = len(slots)
    values, nodes = np.concatenate([parents, c1, c2], axis=1), np.arange(n)
    yield from split_nodes(level, slots, n_before, values, (nodes, n + nodes, 2 * n + nodes), alpha)


def split_nodes(
    level: int,
    slots: I64,
    n_before: int,
    values: F64,
    nodes: tuple[I64, I64, I64],
    alpha: F32 | F64,
) -> Iterator[Step]:
    """`split_steps` of the columns of `values` (D, T): of parents, C1s and C2s, each (S,)."""
    parent, c1, c2 = nodes
    alpha = alpha.astype(np.float64)  # a copy
    psi = np.empty((len(values), len(slots)), np.float32)  # as exact as a step is
    is_off = alpha[2] == OFF_LINE
    group_of = np.repeat(np.arange(len(GROUP_CHANNELS)), _sizes_of_groups(len(values)))
    loops = compiled_for(len(slots))
    split_of = _split if loops is None else loops.raising.split

    def fill(channel: int) -> npt.NDArray[np.bool_]:
        rows, found = slice(channel, channel + 1), np.zeros(len(slots), bool)
        groups = group_of[rows]
        split_of(values[rows], parent, c1, c2, alpha, groups, ROUNDING, psi[rows], found)
        return found

    for found in parallel_map(fill, range(len(values)), n_splats=len(slots)):
        is_off |= found
    rows = np.flatnonzero((alpha[2:4] == OFF_LINE).all(axis=0))
    psi[:, rows] = 0
    psi[_OPACITY, rows] = hiding(values[_OPACITY, parent[rows]])
    alpha[3, rows] = 0
    split = Step.of_splits(level, slots, psi, alpha)
    yield split
    seconds = np.flatnonzero(is_off)
    if len(seconds):
        hidden = values[:, parent[rows]] + split.psi[:, rows]
        steps = alpha_channels(split.alpha[:, seconds], len(values)) * split.psi[:, seconds]
        second = values[:, parent[seconds]] - steps
        refined = [values[:, c1[rows]] - hidden, values[:, c2[seconds]] - second]
        slots_of_both = np.append(slots[rows], n_before + seconds)
        yield Step.of_refines(level, slots_of_both, np.concatenate(refined, axis=1))


def _split(
    values: F64,
    parent: I64,
    c1: I64,
    c2: I64,
    alpha: F64,
    group_of: I64,
    rounding: float,
    psi: F32,
    is_off: npt.NDArray[np.bool_],
) -> None:
    """`raising.split` in numpy."""
    for row, to, group in zip(values, psi, group_of, strict=True):
        p, a, b = row[parent], row[c1], row[c2]
        to[:] = a - p
        off = np.abs(b - (p - alpha[group] * to))
        is_off |= off > rounding * np.maximum(np.maximum(np.abs(p), np.abs(a)), np.abs(b))


def _sizes_of_groups(d: int) -> list[int]:
    return [len(range(d)[channels]) for channels in GROUP_CHANNELS]


def alpha_of(split: Step) -> F32:
    """(5, S) alpha that `split_steps` had for a step of splits that it made."""
    alpha = split.alpha.copy()
    still = ~np.delete(split.psi, _OPACITY, axis=0).any(axis=0)
    alpha[3, still & (alpha[2] == OFF_LINE) & (alpha[3] == 0)] = OFF_LINE
    return alpha
