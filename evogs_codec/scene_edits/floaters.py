"""Floaters: splats that are far from all others, as trainers leave them in empty space.

Two numbers are looked at: the mean distance d of a splat to the 16 nearest places where others
are, and d over the largest standard deviation of the splat, as the splats of a sky are far apart
and as large. A splat is a floater if the logarithms of both are more than a threshold above their
medians, in units of their spread, 1.4826 * median |deviation from the median|, which is the
standard deviation where logarithms are normal. Logarithms, because densities differ by factors.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from evogs_codec.model.splats import F64, SplatParams

__all__ = ["N_NEIGHBOURS", "THRESHOLD", "floaters"]

N_NEIGHBOURS = 16
THRESHOLD = 3.0
MAD_TO_DEVIATION = 1.4826
MIN_SPREAD = 0.1  # of logarithms: in a lattice all distances are the same
BLOCK = 1 << 16  # places whose neighbours are looked for at a time


def floaters(splats: SplatParams, threshold: float = THRESHOLD) -> npt.NDArray[np.bool_]:
    """(N,) True for floaters.

    Args:
        splats: N splats; those of fewer than 17 places are no floaters.
        threshold: spreads above the median.
    """
    # Places, not splats: a tree over many points at one place is searched point by point.
    places, of_splats = np.unique(splats.means, axis=0, return_inverse=True)
    if len(places) <= N_NEIGHBOURS:
        return np.zeros(len(splats), bool)
    distances = np.log(_distances(places.astype(np.float64))[of_splats])
    for_size = distances - splats.log_scales.max(1)
    found: npt.NDArray[np.bool_] = np.minimum(_excess(distances), _excess(for_size)) > threshold
    return found


def _excess(logs: F64) -> F64:
    """(N,) how many spreads each is above the median."""
    above: F64 = logs - np.median(logs)
    return above / max(MAD_TO_DEVIATION * float(np.median(np.abs(above))), MIN_SPREAD)


def _distances(places: F64) -> F64:
    """(P,) mean distance of each of P places to the nearest others, above 0."""
    tree = scipy.spatial.cKDTree(places)
    found = np.empty(len(places))
    for at in range(0, len(places), BLOCK):
        part = slice(at, at + BLOCK)
        nearest = tree.query(places[part], N_NEIGHBOURS + 1)[0]
        found[part] = nearest[:, 1:].mean(1)  # the first is the place itself
    return np.maximum(found, np.finfo(np.float64).tiny)
