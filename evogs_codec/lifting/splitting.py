"""Splitting: the steps that make children of parents, none of which looks worse than the parents.

Letters: D channels, S pairs of children.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evogs_codec.lifting.parents import MENDED
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.hiding import hiding
from evogs_codec.model.splats import F32, F64, I64
from evogs_codec.model.tree import Step, alpha_channels

__all__ = ["alpha_of", "split_steps"]

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

    Where alpha of scale and of opacity are `MENDED`, the parent is split into itself, the C2, and a
    C1 that is not seen, and both are refined: pictures of the state between the two steps are those
    of the parents. Of other pairs on no line the C2 alone is refined, which costs less.

    Args:
        level: of the steps.
        slots: (S,) of the parents, then of the C1s.
        n_before: slots before the split; the C2s take those after them.
        parents: (D, S).
        c1: (D, S) children that take the slots of the parents.
        c2: (D, S) children that take new slots.
        alpha: (5, S) of the splits.
    """
    # As exact as a step is.
    psi = (c1 - parents).astype(np.float32).astype(np.float64)
    alpha = alpha.astype(np.float64)  # a copy
    off = np.abs(c2 - (parents - alpha_channels(alpha, len(c2)) * psi))
    largest = np.maximum(np.maximum(np.abs(parents), np.abs(c1)), np.abs(c2))
    is_off = (alpha[2] == MENDED) | np.any(off > ROUNDING * largest, axis=0)
    rows = np.flatnonzero((alpha[2:4] == MENDED).all(axis=0))
    psi[:, rows] = 0
    psi[_OPACITY, rows] = hiding(parents[_OPACITY, rows])
    alpha[3, rows] = 0
    split = Step.of_splits(level, slots, psi, alpha)
    yield split
    seconds = np.flatnonzero(is_off)
    if len(seconds):
        hidden = parents[:, rows] + split.psi[:, rows]
        second = parents - alpha_channels(split.alpha, len(c2)) * split.psi
        refined = np.concatenate([c1[:, rows] - hidden, (c2 - second)[:, seconds]], axis=1)
        yield Step.of_refines(level, np.append(slots[rows], n_before + seconds), refined)


def alpha_of(split: Step) -> F32:
    """(5, S) alpha that `split_steps` had for a step of splits that it made."""
    alpha = split.alpha.copy()
    still = ~np.delete(split.psi, _OPACITY, axis=0).any(axis=0)
    alpha[3, still & (alpha[2] == MENDED) & (alpha[3] == 0)] = MENDED
    return alpha
