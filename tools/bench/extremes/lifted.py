"""The row of lifting: quaternions of any length and wide scales, as covariances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from evogs_codec import SplatParams
from evogs_codec.lifting.lift import lift_with_order
from tools.bench.extremes import decimals
from tools.bench.extremes.row import Row
from tools.bench.extremes.scenes import plain

__all__ = ["shapes"]

LENGTHS = (0.0, 1e-45, 1e-40, 1e-20, 1.0, 1e20, 1e37)
LARGEST_SCALE = 30.0


def shapes(n: int) -> Iterator[Row]:
    """Each leaf of a tree of one level against the splat that it is."""
    scales = np.random.default_rng(8).uniform(-LARGEST_SCALE, 20, (n, 3)).astype(np.float32)
    quats = plain(n).quats.astype(np.float64) * np.resize(LENGTHS, n)[:, None]
    splats = replace(plain(n), quats=quats.astype(np.float32), log_scales=scales)
    lifted = lift_with_order(splats, 1)
    leaves = lifted.tree.leaves()
    error = max(_difference(leaves, k, splats, int(i)) for k, i in enumerate(lifted.leaf_of))
    bound = 2 * 2.0**-24 * (LARGEST_SCALE + 2)
    name = "quaternions: zero, 1e-45 to 1e37 long, log-scales of -30 to 20; covariances"
    yield Row(name, f"{bound:.3g}", f"{error:.3g}", error / bound, "")


def _difference(a: SplatParams, i: int, b: SplatParams, j: int) -> float:
    """Largest difference of two covariances, relative to the largest number of the second."""
    ours, theirs = decimals.covariance(a, i), decimals.covariance(b, j)
    off = max(abs(x - y) for x, y in zip(ours, theirs, strict=True))
    return float(off / max(map(abs, theirs)))
