"""Which leaves of a tile come together: the parts of a layer, the most important leaves first.

Each part is a step of its own, and has about as many bytes as the others. Letters: K classes (spec
3.2), N leaves of a tile.
"""

from __future__ import annotations

import numpy as np

from evogs_codec.model.splats import F32, I64

__all__ = ["MAX_PARTS", "first_ancestors", "most_late_parts", "parts_of_leaves"]

MAX_PARTS, MIN_LEAVES = 16, 2048  # parts of a layer of a tile at most, leaves of each at least
# A part of a late level takes another step, which makes room for its splats: so there are fewer. Of
# one tile of two layers at most, of more layers, of all tiles together, and of each tile at least:
MAX_OF_TWO_LAYERS, MAX_OF_MORE_LAYERS, MAX_OF_ALL_TILES, MIN_OF_TILE = 10, 8, 16, 4
# Bits of a number of a leaf of mean weight, and at least, about.
MEAN_BITS, MIN_BITS = 4.0, 0.25
# Leaves of neighbouring ancestors are in the same part, since siblings need each other: so many at
# least, and so many families of them in a tile at most.
MIN_FAMILY, MAX_FAMILIES = 256, 256


def most_late_parts(n_layers: int, n_tiles: int) -> int:
    """Parts, at most, of each of so many tiles whose last level is late (`late_level`)."""
    most = MAX_OF_TWO_LAYERS if n_layers == 2 else MAX_OF_MORE_LAYERS
    return min(most, max(MIN_OF_TILE, MAX_OF_ALL_TILES // n_tiles))


def first_ancestors(born_from: I64) -> I64:
    """(n,) the first ancestor of each slot, which an add made."""
    ancestors = np.where(born_from < 0, np.arange(len(born_from)), born_from)
    while (born_from[ancestors] >= 0).any():
        ancestors = ancestors[ancestors]  # twice as far back each time
    return ancestors


def parts_of_leaves(weights: F32, ancestors: I64, most: int) -> list[I64]:
    """Rows of leaves with weights (K, N) for at most this many parts, the most important first.

    `ancestors` (N,) are their first ones. Leaves of one ancestor are in the same part, and so are
    those of ancestors that are neighbours.
    """
    n = weights.shape[1]
    if not n:
        return [np.empty(0, np.int64)]
    order = np.argsort(ancestors, kind="stable")
    begins = np.flatnonzero(np.diff(ancestors[order], prepend=-1))  # of the leaves of an ancestor
    starts = begins[
        np.flatnonzero(np.diff(begins // max(MIN_FAMILY, n // MAX_FAMILIES), prepend=-1))
    ]
    means = np.maximum(weights.mean(axis=1, keepdims=True), np.float32(1e-30))
    relative = (weights / means)[:, order]
    of_families = np.add.reduceat(relative.mean(axis=0), starts)
    of_families /= np.diff(np.append(starts, n))
    n_parts = min(most, max(1, n // MIN_LEAVES))
    families = np.split(order, starts[1:])
    first = np.argsort(-of_families, kind="stable")
    # A step half as large, for a weight four times as high, takes a bit more of each channel.
    of_leaves = MEAN_BITS + np.log2(np.maximum(relative, np.float32(1e-6))).mean(axis=0) / 2
    bits = np.add.reduceat(np.maximum(of_leaves, MIN_BITS), starts)[first]
    middles = np.cumsum(bits) - bits / 2
    part_of = (middles * n_parts / bits.sum()).astype(np.int64)
    return [
        np.sort(np.concatenate([families[k] for k in part]))
        for part in np.split(first, np.flatnonzero(np.diff(part_of)) + 1)
    ]
