"""A tree in two steps: its roots, and then all leaves in their place at once.

Between the two there is nothing that could look worse than the roots. It takes about three times
the bytes, since leaves are not told from their parents.

Letters: D channels, K classes (spec 3.2), N leaves, R roots.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.model.splats import F32, I64
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = ["at_once"]


def at_once(
    tile: EvolutionTree, weights: Sequence[StepWeights | None], leaves: F32
) -> tuple[EvolutionTree, tuple[StepWeights | None, ...], I64 | None]:
    """An arranged tile in two steps; itself if it has no roots that become others.

    Args:
        tile: without a palette.
        weights: of its steps.
        leaves: (K, N) weights of its leaves.

    Returns:
        The tile, the weights of its steps, and (N,) the number that the slot of each leaf has in
        the tile as it was; None of a tile that is itself.
    """
    roots = list(takewhile(lambda step: step.level == 0 and not len(step.slots), tile.steps))
    if not roots or len(roots) == len(tile.steps) or tile.palette is not None:
        return tile, tuple(weights), None
    adds = np.concatenate([step.adds for step in roots], axis=1)
    of_roots = [one.new for one in weights[: len(roots)] if one is not None]
    (*_, last) = tile.states()
    order = np.flatnonzero(last.live)
    n = adds.shape[1]
    shown = Step(
        tile.n_levels - 1,
        np.arange(n, dtype=np.int32),
        np.full(n, Kind.DROP, np.uint8),
        adds[:, :0],
        np.empty((5, 0), np.float32),
        last.values[:, order].astype(np.float32),
    )
    own = (
        StepWeights(0, leaves[:, :0], np.concatenate(of_roots, axis=1)),
        StepWeights(shown.level, leaves[:, :0], leaves),
    )
    steps = (Step.of_adds(0, adds), shown)
    return EvolutionTree(tile.sh_degree, steps), own, order
