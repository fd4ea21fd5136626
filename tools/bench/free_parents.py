"""The same pairs with free parents: moment matching, which no line holds, and no stream can store.

What `evogs_codec.lifting.lift` loses because a parent has to lie on the line through its children.
Letters: n slots of a level, D channels.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from evogs_codec import EvolutionTree, SplatParams
from evogs_codec.lifting.parents import MAX_OPACITY, TINY, Moments, cross_sections, merged, moments
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import Kind

__all__ = ["free_levels"]


def free_levels(tree: EvolutionTree) -> list[SplatParams]:
    """The levels of a lifted tree, the coarsest first, with the leaves of its last.

    A parent has the mean, covariance and mass of all leaves below it, and their colours by mass.
    """
    leaves = tree.leaves().channels().astype(np.float64)
    mass = moments(leaves)  # lifting writes rotations as (1, g)
    sh = leaves[11:]
    levels = [tree.leaves()]
    for step in reversed(tree.steps[1:]):
        if np.all(step.kinds == Kind.REFINE):
            continue
        if np.any(step.kinds != Kind.SPLIT) or step.n_adds:
            raise ValueError("a step of a lifted tree only splits or only refines")
        n = sh.shape[1] - len(step.slots)
        kept, c1, c2 = np.arange(n), step.slots.astype(np.int64), np.arange(n, sh.shape[1])
        first, second = mass.take(c1), mass.take(c2)
        parents = merged(first, second)
        share = first.mass / np.maximum(parents.mass, TINY)
        sh = np.concatenate([sh[:, kept], share * sh[:, c1] + (1 - share) * sh[:, c2]], axis=1)
        # Parents come after all slots and then take the place of their C1.
        row = kept.copy()
        row[c1] = n + np.arange(len(c1))
        mass = mass.take(kept).followed_by(parents).take(row)
        sh = sh[:, row]
        levels.append(_splats(mass, sh))
    return levels[::-1]


def _splats(m: Moments, sh: F64) -> SplatParams:
    """Gaussians that have these moments."""
    variances, axes = np.linalg.eigh(m.cov.transpose(2, 0, 1))
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]  # turned, not mirrored
    x, y, z, w = Rotation.from_matrix(axes).as_quat().T
    opacity = np.clip(m.mass / cross_sections(m.cov), 1e-12, MAX_OPACITY)
    return SplatParams.from_channels(
        np.concatenate(
            [
                m.mean,
                np.stack([w, x, y, z]),
                0.5 * np.log(np.maximum(variances.T, TINY)),
                np.log(opacity / (1 - opacity))[None],
                sh,
            ]
        )
    )
