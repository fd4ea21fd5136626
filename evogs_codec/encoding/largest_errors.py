"""How far the leaves of a stream are from those of the tree that it is of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evogs_codec.decoding.decode import decode
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import EvolutionTree

__all__ = ["largest_errors"]


def largest_errors(tiles: Sequence[EvolutionTree], data: bytes, sh_degree: int) -> F64:
    """(5,) largest error of the leaves of a stream, per group, in the units of the group."""
    leaves = [tile.leaves().channels() for tile in tiles if tile.steps]
    if not leaves:
        return np.zeros(len(GROUPS))
    right = np.concatenate(leaves, axis=1)
    found = decode(data).leaves(sh_degree=sh_degree).channels()
    off = np.abs(found.astype(np.float64) - right)
    return np.array([off[part].max(initial=0.0) for part in GROUP_CHANNELS])
