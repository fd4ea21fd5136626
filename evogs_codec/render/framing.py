"""What of a scene a picture is framed on: the splats that matter, whatever lies around them.

That is where most of a scene is, or the detail in its middle: an object in a landscape.

Also how near splats are drawn, and on what background.

Letters: N splats.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.render.harmonics import C0
from evogs_codec.render.options import DEFAULT, Options

__all__ = [
    "BLACK",
    "Bulk",
    "background_for",
    "bulk_of",
    "focus_of",
    "options_for",
    "weighted_quantiles",
    "worth",
]

BULK = (20, 80)  # percentiles of the positions: what is far away does not decide the distance
REACH = 1.5  # diagonals of the bulk; what is farther from its middle, along an axis, is an outlier
MAX_WEIGHED = 100_000  # splats that are weighed, evenly taken
N_TURNS = 3  # each frames what is near the bulk of the one before
LARGE_PERCENTILE = 90  # percentile of the areas; a larger splat counts as one of this size
# The bulk of what matters is taken where its middle or its size are so far from those of all
# positions: in diagonals, and as a factor. Most scenes keep the views that they always had.
OTHER_PLACE, OTHER_SIZE = 0.35, 1.5
# A scene has detail in its middle if the smaller half of its splats is in a part of its bulk, in
# diagonals: a smaller part is something else in it, such as an insect in a city. A few splats show
# nothing.
DETAIL, MIN_OF_DETAIL = (0.003, 0.25), 200
SMALL_BULK = 0.2  # of a small bulk, a tenth of the way of the default cameras to it
WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
# Of the range of a colour, from which a splat is white, and of the splats, that are white at least
# where hardly anything is seen on white.
NEARLY_WHITE, NEARLY_ALL = 0.02, 0.99


_found: WeakKeyDictionary[SplatParams, Bulk] = WeakKeyDictionary()
_focus: WeakKeyDictionary[SplatParams, Bulk] = WeakKeyDictionary()


class Bulk(NamedTuple):
    """Where most of a scene is.

    Attributes:
        middle: (3,) scene units.
        size: of its diagonal, scene units; 0 if all splats are in one place.
    """

    middle: F64
    size: float


def bulk_of(scene: SplatParams) -> Bulk:
    """Of the positions, or, where they say something else, of the splats that matter.

    Raises:
        ValueError: no splat has a finite position.
    """
    if scene not in _found:  # who asks where cameras stand asks how to render, too
        _found[scene] = _bulk_of(scene)
    return _found[scene]


def focus_of(scene: SplatParams) -> Bulk:
    """What cameras look at: the bulk, or the detail in it.

    Trainers make splats as small as photographs show them. Of an object in a landscape, half of the
    splats may be ground, trees and sky, but the small ones are where people stood.

    Raises:
        ValueError: as `bulk_of`.
    """
    if scene not in _focus:
        _focus[scene] = _focus_of(scene)
    return _focus[scene]


def _focus_of(scene: SplatParams) -> Bulk:
    bulk = bulk_of(scene)
    finite = scene.finite()
    if not 0 < bulk.size < math.inf or np.count_nonzero(finite) < MIN_OF_DETAIL:
        return bulk
    axes = np.sort(scene.log_scales[finite].astype(np.float64), axis=1)
    sizes = axes[:, 1] + axes[:, 2]
    small = scene.means[finite][sizes <= np.median(sizes)].astype(np.float64)
    detail = _box(*np.percentile(small, BULK, axis=0))
    least, most = DETAIL
    return detail if least <= detail.size / bulk.size <= most else bulk


def _bulk_of(scene: SplatParams) -> Bulk:
    means = scene.means[np.isfinite(scene.means).all(axis=1)].astype(np.float64)
    if not len(means):
        raise ValueError("the scene is empty: name the cameras")
    plain = _box(*np.percentile(means, BULK, axis=0))
    if not 0 < plain.size < math.inf:
        return plain
    found, some = plain, scene.take(slice(None, None, max(1, -(-len(scene) // MAX_WEIGHED))))
    for _ in range(N_TURNS):
        found = _of_worth(some, found)
    if not found.size:
        return plain
    apart = float(np.linalg.norm(found.middle - plain.middle)) / plain.size
    ratio = found.size / plain.size
    agree = apart <= OTHER_PLACE and 1 / OTHER_SIZE <= ratio <= OTHER_SIZE
    return plain if agree else found


def options_for(scene: SplatParams) -> Options:
    """How a scene is rendered whatever its unit is: what is near is not cut off a small one.

    Scenes whose focus is a unit or more are rendered with `DEFAULT`, as are empty ones.
    """
    if not np.isfinite(scene.means).all(axis=1).any():
        return DEFAULT
    size = focus_of(scene).size
    return (
        replace(DEFAULT, near=SMALL_BULK * size)
        if 0 < SMALL_BULK * size < DEFAULT.near
        else DEFAULT
    )


def background_for(scene: SplatParams) -> tuple[float, float, float]:
    """What a scene is rendered on: white, or black if nearly all its splats are white.

    On white hardly anything would show how exact these have to be.
    """
    colours = 0.5 + C0 * scene.sh[:, 0].astype(np.float64)
    n_white = np.count_nonzero((np.abs(colours - 1) <= NEARLY_WHITE).all(axis=1))
    return BLACK if n_white >= NEARLY_ALL * len(scene) > 0 else WHITE


def _of_worth(scene: SplatParams, bulk: Bulk) -> Bulk:
    """The bulk of what matters near another bulk; that one, if nothing is there."""
    weights = worth(scene, bulk)
    seen = weights > 0
    if not seen.any():
        return bulk
    points, weights = scene.means[seen].astype(np.float64), weights[seen]
    shares = [share / 100 for share in BULK]
    ends = np.array([weighted_quantiles(points[:, k], weights, shares) for k in range(3)])
    found = _box(ends[:, 0], ends[:, 1])
    return found if found.size else bulk


def _box(low: F64, high: F64) -> Bulk:
    return Bulk((low + high) / 2, float(np.linalg.norm(high - low)))


def worth(scene: SplatParams, bulk: Bulk) -> F64:
    """(N,) opacity times area of each splat near the bulk; 0 of outliers and of what is not finite.

    The area is that of the two larger axes. One splat of the sky would outweigh a scene: no area
    counts for more than that of a large splat near the bulk.
    """
    finite = scene.finite()
    away = np.zeros(len(scene))
    away[finite] = np.abs(scene.means[finite].astype(np.float64) - bulk.middle).max(axis=1)
    near = finite & (away <= REACH * bulk.size)
    found = np.zeros(len(scene))
    if not near.any():
        return found
    axes = np.sort(scene.log_scales[near].astype(np.float64), axis=1)
    areas = np.exp(np.clip(axes[:, 1] + axes[:, 2], -300, 300))
    areas = np.minimum(areas, np.percentile(areas, LARGE_PERCENTILE))
    opacities = 1 / (1 + np.exp(-np.clip(scene.opacity_logits[near].astype(np.float64), -50, 50)))
    found[near] = opacities * areas / areas.max()
    return found


def weighted_quantiles(values: F64, weights: F64, shares: npt.ArrayLike) -> F64:
    """The values below which these shares of the weights are, each of 0..1.

    Args:
        values: (N,) numbers, at least one.
        weights: (N,) of them, not all 0.
        shares: of the sum of the weights.
    """
    order = np.argsort(values, kind="stable")
    heavy = weights[order]
    sums = np.cumsum(heavy)
    found: F64 = np.interp(np.asarray(shares) * sums[-1], sums - heavy / 2, values[order])
    return found
