"""Warns of leaves whose numbers are of steps coarser than was asked for.

A grid has a coarsest and a finest step, and integers have 24 bits, so some steps of a stream may be
coarser. What a step is off, a refine after it corrects. A split does not: both children lie on a
line through their parent.

Letters: K classes (spec 3.2), n slots.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import repeat

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.grids import AccuracyWarning, coarse_step, too_coarse
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.model.arithmetic import Quantiser
from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS, group_of_class
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = ["warn_of_coarse_leaves"]

Flags = npt.NDArray[np.bool_]
FIRST_ABOVE = 5  # the class of SH band 1, which a palette has


def warn_of_coarse_leaves(
    tiles: Sequence[EvolutionTree],
    quantisers: Sequence[Sequence[Quantiser]],
    exponents: Sequence[int],
    steps: F64,
    weights: Sequence[Sequence[StepWeights | None]] | None = None,
) -> None:
    """Warn where leaves, or entries of a palette, have numbers of steps that are too coarse.

    Args:
        tiles: that were quantised.
        quantisers: of the stream: row 0 of adds, 1 + level of psi.
        exponents: of its grids.
        steps: (rows, K) asked for.
        weights: of each tile and step, as of `quantise`.
    """
    units = [2.0 ** -exponents[group_of_class(kind)] for kind in range(steps.shape[1])]
    n_classes = len(quantisers[0])  # a stream may have fewer bands
    units, asked = units[:n_classes], steps[:, :n_classes]
    got = np.array([[q.step for q in row] for row in quantisers]) * np.array(units)
    coarse = too_coarse(got, asked, np.array(units))
    if not coarse.any():
        return
    is_shown = np.zeros(n_classes, bool)
    for tile, own in zip(tiles, weights or repeat(None), strict=False):
        is_shown |= _in_leaves(tile, coarse, own)
    if tiles[0].palette is not None:
        is_shown[FIRST_ABOVE:] |= coarse[0, FIRST_ABOVE:]
    ratios = np.where(coarse & is_shown, got / asked, 0.0)
    for group in range(N_GROUPS):
        of_group = ratios[:, group : group + 1 if group < N_GROUPS - 1 else None]
        row, kind = np.unravel_index(of_group.argmax(), of_group.shape)
        if of_group[row, kind]:
            place = row, group + kind
            said = coarse_step(group, float(got[place]), float(asked[place]))
            warnings.warn(said, AccuracyWarning, stacklevel=3)


def _in_leaves(
    tile: EvolutionTree, coarse: Flags, weights: Sequence[StepWeights | None] | None
) -> Flags:
    """(K,) whether a leaf has a number of a step (rows, K) that is too coarse."""
    _, live = tile.lineage()
    found, n = np.zeros((coarse.shape[1], len(live)), bool), 0
    for number, step in enumerate(tile.steps):
        row, n_splits = coarse[1 + step.level][:, None], step.alpha.shape[1]
        parents = step.slots[step.kinds == Kind.SPLIT]
        refined = step.slots[step.kinds == Kind.REFINE]
        is_kept = weights is not None and weights[number] is None
        corrects = np.zeros(len(row), bool) if is_kept else _corrects(step, len(row))
        found[:, refined] &= ~corrects[:, None]
        found[:, refined] |= row
        found[:, parents] |= row
        found[:, n : n + n_splits] = found[:, parents]
        found[:, n + n_splits : n + step.n_new] = coarse[0][:, None]
        n += step.n_new
    return np.array(found[:, live].any(axis=1), bool)


def _corrects(step: Step, n_classes: int) -> Flags:
    """(K,) whether refines of a step correct what its slots are off: none of other groups does."""
    is_of_all = step.alpha.shape[1] > 0 or not step.psi.any()
    corrects: Flags = np.array([is_of_all or step.psi[part].any() for part in GROUP_CHANNELS])
    kinds = [group_of_class(kind) for kind in range(n_classes)]
    of_classes: Flags = corrects[kinds]
    return of_classes
