"""Splats to start from: the points of a data set, or random ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from evogs_codec import SplatParams

if TYPE_CHECKING:
    from reference_trainer.data import Dataset, View

__all__ = ["first_splats"]

C0 = 0.28209479177387814  # of spherical harmonics, band 0
FIRST_OPACITY = 0.1
MIN_HALF_SIDE = 1.3  # of the cube that random points fill; objects of Blender scenes fit
# Part of the ball that a camera sees whole. For cameras of NeRF-synthetic this comes to the cube
# that is usual for them; cameras that stand twice as far away see things twice as large.
SEEN_SHARE = 0.95
N_NEIGHBOURS = 3
F32 = npt.NDArray[np.float32]


def first_splats(
    data: Dataset, n_random: int, sh_degree: int, seed: tuple[int, ...]
) -> SplatParams:
    """A splat at each point, as wide as the distance to its neighbours.

    Args:
        data: with points, or cameras around the origin.
        n_random: how many to draw in a cube where there are no points; the most to take of them.
        sh_degree: 0..3.
        seed: of the random ones.
    """
    rng = np.random.default_rng(seed)
    if data.points is None:
        half_side = _half_side(data.train)
        points = rng.uniform(-half_side, half_side, (n_random, 3)).astype(np.float32)
        colours = rng.random((n_random, 3)).astype(np.float32)
    else:
        rows = np.sort(rng.permutation(len(data.points))[:n_random])
        points = data.points[rows]
        colours = np.full_like(points, 0.5) if data.colours is None else data.colours[rows]
    n = len(points)
    sh = np.zeros((n, (sh_degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = (colours - 0.5) / C0
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    width = np.log(_spacing(points))[:, None].repeat(3, axis=1).astype(np.float32)
    logits = np.full(n, np.log(FIRST_OPACITY / (1 - FIRST_OPACITY)), np.float32)
    return SplatParams(points, quats, width, logits, sh)


def _half_side(views: tuple[View, ...]) -> float:
    """Of a cube around the origin that most of the pictures show whole."""
    radii = []
    for view in views:
        camera = view.camera
        tangent = 0.5 * min(camera.width / camera.fx, camera.height / camera.fy)
        radii.append(np.linalg.norm(camera.position) * tangent / np.hypot(1, tangent))
    return max(MIN_HALF_SIDE, SEEN_SHARE * float(np.median(radii)))


def _spacing(points: F32) -> npt.NDArray[np.float64]:
    """(N,) root of the mean squared distance to the nearest neighbours."""
    k = min(N_NEIGHBOURS + 1, len(points))
    distances = cKDTree(points).query(points, k=k)[0].reshape(len(points), k)[:, 1:]
    squares = (distances**2).mean(axis=1) if k > 1 else np.ones(len(points))
    spacing: npt.NDArray[np.float64] = np.sqrt(np.maximum(squares, 1e-7))
    return spacing
