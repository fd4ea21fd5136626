"""SH that many splats share, and trees that say so with a palette (spec 3.7).

Scenes that went through a codec with a palette of SH have a few ten thousand vectors of them for
hundreds of thousands of splats. As psi they would all differ.

Letters: N splats, C SH channels above band 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evogs_codec.packet_header import N_CORE
from evogs_codec.splats import F32, I64, SplatParams
from evogs_codec.tree import EvolutionTree, Palette

__all__ = ["shared_sh", "with_palette"]

MOST = 0.25  # of the splats, as many different vectors at most: else psi take fewer bytes


def shared_sh(splats: SplatParams) -> tuple[Palette, I64] | None:
    """The palette of splats and the pick (N,) of each; None if too few of them share their SH."""
    if not len(splats) or not splats.sh_degree:
        return None
    rest = np.ascontiguousarray(splats.sh[:, 1:]).reshape(len(splats), -1)
    keys = _keys(rest)
    order = np.argsort(keys, kind="stable")
    is_new = np.ones(len(keys), bool)
    is_new[1:] = keys[order[1:]] != keys[order[:-1]]
    if np.count_nonzero(is_new) > MOST * len(keys):
        return None
    entry = np.empty(len(keys), np.int64)
    entry[order] = np.cumsum(is_new) - 1
    entries = rest[order[is_new]]
    if not np.array_equal(entries[entry], rest):  # two vectors with one key
        return None
    # The pick 0 needs no entry.
    some = entries.any(1)
    number = np.where(some, np.cumsum(some), 0)
    return Palette(splats.sh_degree, np.ascontiguousarray(entries[some].T)), number[entry]


def _keys(rows: F32) -> I64:
    """(N,) a number for each row of bits; different ones for different rows, most likely."""
    factors = np.random.default_rng(0).integers(1 << 62, size=rows.shape[1]) * 2 + 1
    keys: I64 = (rows + np.float32(0)).view(np.int32).astype(np.int64) @ factors  # no -0
    return keys


def with_palette(tree: EvolutionTree, leaf_of: I64, palette: Palette, picks: I64) -> EvolutionTree:
    """A lifted tree whose SH above band 0 are those of the palette.

    Args:
        tree: with all SH; coarse splats then show those of the leaf that keeps their slot.
        leaf_of: (N,) splat that each slot is in the end.
        palette: of the splats.
        picks: (N,) of the splats.
    """
    steps, n = [], 0
    for step in tree.steps:
        new = leaf_of[n : n + step.n_new]
        steps.append(
            replace(
                step,
                psi=step.psi[:N_CORE],
                adds=step.adds[:N_CORE],
                picks=picks[new].astype(np.int32),
            )
        )
        n += step.n_new
    return EvolutionTree(0, tuple(steps), palette=palette)
