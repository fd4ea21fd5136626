"""SH that many splats share, and trees that say so with a palette (spec 12).

Scenes that went through a codec with a palette of SH have a few ten thousand vectors of them for
hundreds of thousands of splats. As psi they would all differ.

Letters: N splats, C SH channels above band 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.lifting.coarse_entries import N_SAMPLED, CoarseEntries
from evogs_codec.lifting.lift import Lifted
from evogs_codec.model.channels import N_CORE
from evogs_codec.model.palette import Palette
from evogs_codec.model.splats import F32, I64, SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = [
    "MAX_DISTINCT",
    "SH",
    "SharedSh",
    "coarse_sh",
    "in_palette",
    "keys_of",
    "shared_sh",
    "with_palette",
]

MAX_DISTINCT = 0.25  # of the splats, as many different vectors at most: else psi take fewer bytes
SH = slice(N_CORE, None)  # channels above band 0


@dataclass(frozen=True, eq=False)
class SharedSh:
    """The SH above band 0 of splats, each vector once.

    Attributes:
        keys: (n,) of the vectors (`keys_of`), rising.
        vectors: (n, C) float32, all different; 0 is not among them.
        vector_of: (N,) the number of the vector of each splat, from 1 on; 0 for one without SH.
    """

    keys: I64
    vectors: F32
    vector_of: I64

    @staticmethod
    def of(splats: SplatParams) -> SharedSh | None:
        """Of splats; None if two vectors have one key."""
        rest = np.ascontiguousarray(splats.sh[:, 1:]).reshape(len(splats), -1)
        keys, first, inverse = np.unique(keys_of(rest), return_index=True, return_inverse=True)
        vectors = rest[first] + np.float32(0)  # no -0
        if not np.array_equal(vectors[inverse], rest):
            return None
        some = vectors.any(axis=1)  # the pick 0 needs no entry
        number = np.where(some, np.cumsum(some), 0)
        return SharedSh(keys[some], vectors[some], number[inverse.ravel()])

    def palette(self, degree: int) -> Palette:
        """The vectors as entries."""
        return Palette(degree, np.ascontiguousarray(self.vectors.T))


def shared_sh(splats: SplatParams) -> tuple[Palette, I64] | None:
    """The palette of splats and the pick (N,) of each; None if too few of them share their SH."""
    if not len(splats) or not splats.sh_degree:
        return None
    found = SharedSh.of(splats)
    if found is None:
        return None
    n = len(found.keys) + bool((found.vector_of == 0).any())
    if n > MAX_DISTINCT * len(splats):
        return None
    return found.palette(splats.sh_degree), found.vector_of


def keys_of(rows: F32) -> I64:
    """(N,) a number for each row of bits; different ones for different rows, most likely."""
    factors = np.random.default_rng(0).integers(1 << 62, size=rows.shape[1]) * 2 + 1
    keys: I64 = (rows + np.float32(0)).view(np.int32).astype(np.int64) @ factors  # no -0
    return keys


def with_palette(lifted: Lifted, splats: SplatParams) -> EvolutionTree | None:
    """The lifted tree of splats with their SH above band 0 in a palette, where they share them.

    Coarse splats show one of a few entries made for them (`coarse_entries`).

    Returns:
        None if too few splats share their SH, or if none has any.
    """
    shared = shared_sh(splats)
    if shared is None or not shared[0].entries.size:
        return None
    own, picks = shared
    coarse = CoarseEntries.of(coarse_sh(lifted.tree), own.entries.shape[1])
    return in_palette(lifted, own, picks, coarse)


def in_palette(lifted: Lifted, own: Palette, picks: I64, coarse: CoarseEntries) -> EvolutionTree:
    """The lifted tree of splats with their SH above band 0 in a palette.

    Args:
        lifted: of N splats.
        own: their SH.
        picks: (N,) of these splats among them.
        coarse: entries for coarse splats, which come first in the palette.
    """
    tree = lifted.tree
    is_last = _last_written(tree)
    n_coarse = coarse.values.shape[1]
    final = np.where(picks > 0, picks + n_coarse, 0)[lifted.leaf_of].astype(np.int32)
    shown = np.zeros(len(final), np.int32)
    steps: list[Step] = []
    n = 0
    for k, (step, state) in enumerate(zip(tree.steps, tree.states(SH), strict=True)):
        changed = step.slots[step.kinds != Kind.DROP]
        written = np.concatenate([changed, n + np.arange(step.n_new)])
        is_final = is_last[written] <= k
        now = np.where(is_final, final[written], 0)
        now[~is_final] = coarse.cheapest(state.values[:, written[~is_final]])
        keeps = np.array_equal(now[: len(changed)], shown[changed])
        shown[written] = now
        steps.append(
            replace(
                step,
                psi=step.psi[:N_CORE],
                adds=step.adds[:N_CORE],
                picks=now[len(changed) :],
                changed_picks=now[:0] if keeps else now[: len(changed)],
            )
        )
        n += step.n_new
    entries = np.concatenate([coarse.values, own.entries], axis=1)
    return EvolutionTree(0, tuple(steps), palette=Palette(own.degree, entries, n_coarse))


def _last_written(tree: EvolutionTree) -> I64:
    """(n_slots,) the step that splits each slot last, or makes it if none does."""
    born = [np.full(step.n_new, k) for k, step in enumerate(tree.steps)]
    out = np.concatenate([np.empty(0, np.int64), *born])
    for k, step in enumerate(tree.steps):
        out[step.slots[step.kinds == Kind.SPLIT]] = k
    return out


def coarse_sh(tree: EvolutionTree) -> F32:
    """(C, up to about `N_SAMPLED`) SH of splats of a lifted tree that are not leaves."""
    is_last = _last_written(tree)
    parts = []
    for k, (step, state) in enumerate(zip(tree.steps, tree.states(SH), strict=True)):
        new = np.arange(state.values.shape[1] - step.n_new, state.values.shape[1])
        written = np.concatenate([step.slots[step.kinds != Kind.DROP], new])
        parts.append(state.values[:, written[is_last[written] > k]].astype(np.float32))
    x = np.concatenate(parts, axis=1)
    return x[:, :: max(1, x.shape[1] // N_SAMPLED)]
