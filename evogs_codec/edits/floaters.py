"""Floaters: splats that are far from all others, as trainers leave them in empty space.

Two numbers are looked at: the mean distance d of a splat to its 16 nearest neighbours, and d over
the largest standard deviation of the splat, as the splats of a sky are far apart and as large. A
splat is a floater if the logarithms of both are more than a threshold above their medians, in
units of their spread, 1.4826 * median |deviation from the median|, which is the standard deviation
where logarithms are normal. Logarithms, because densities of one scene differ by factors.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.spatial

from evogs_codec.model.splats import F64, SplatParams

__all__ = ["N_NEIGHBOURS", "THRESHOLD", "floaters"]

N_NEIGHBOURS = 16
THRESHOLD = 3.0
MAD_TO_DEVIATION = 1.4826
LEAST_SPREAD = 0.1  # of logarithms: in a lattice all distances are the same
BLOCK = 1 << 16  # splats whose neighbours are looked for at a time


def floaters(splats: SplatParams, threshold: float = THRESHOLD) -> npt.NDArray[np.bool_]:
    """(N,) True for floaters.

    Args:
        splats: N splats; a scene of fewer than 17 has no floaters.
        threshold: spreads above the median.
    """
    if len(splats) <= N_NEIGHBOURS:
        return np.zeros(len(splats), bool)
    distances = np.log(np.maximum(_distances(splats), np.finfo(np.float64).tiny))
    for_size = distances - splats.log_scales.max(1)
    found: npt.NDArray[np.bool_] = np.minimum(_excess(distances), _excess(for_size)) > threshold
    return found


def _excess(logs: F64) -> F64:
    """(N,) how many spreads each is above the median."""
    above: F64 = logs - np.median(logs)
    return above / max(MAD_TO_DEVIATION * float(np.median(np.abs(above))), LEAST_SPREAD)


def _distances(splats: SplatParams) -> F64:
    """(N,) mean distance of each splat to its nearest neighbours."""
    points = splats.means.astype(np.float64)
    tree = scipy.spatial.cKDTree(points)
    found = np.empty(len(points))
    for at in range(0, len(points), BLOCK):
        part = slice(at, at + BLOCK)
        # The nearest of a point is the point itself, or one at the same place.
        found[part] = tree.query(points[part], N_NEIGHBOURS + 1)[0][:, 1:].mean(1)
    return found
