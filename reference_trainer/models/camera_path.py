"""Where the cameras are, and what is large there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from evogs_codec.render import Camera

__all__ = ["CameraPath"]

F64 = npt.NDArray[np.float64]
# Least extent of cameras in one place, scene units: objects of Blender scenes are so large.
MIN_EXTENT = 1.3
ONE_PLACE = 1e-6  # of the distance from the origin: cameras nearer to each other are in one place


@dataclass(frozen=True, eq=False)
class CameraPath:
    """The places of the cameras, and the scale that they give a scene.

    Attributes:
        places: (C, 3) scene units.
        extent: 1.1 times the largest distance from the mean of all, as in 3DGS. Of cameras in one
            place, which say nothing of the size of the scene, about that from the origin.
    """

    places: F64
    extent: float

    @staticmethod
    def of(cameras: Sequence[Camera]) -> CameraPath:
        """Of at least one camera."""
        places = np.stack([camera.position for camera in cameras])
        middle = places.mean(axis=0)
        furthest = np.linalg.norm(places - middle, axis=1).max()
        away = max(MIN_EXTENT, float(np.linalg.norm(middle)))
        return CameraPath(places, float(1.1 * furthest) if furthest > ONE_PLACE * away else away)

    def scene_size(self, means: npt.NDArray[np.floating]) -> float:
        """The median of `sizes`, by which rates of positions are multiplied.

        The extent without splats.
        """
        return float(np.median(self.sizes(means))) if len(means) else self.extent

    def sizes(self, means: npt.NDArray[np.floating]) -> F64:
        """(N,) what is large at `means` (N, 3): the extent, or the way to the nearest camera.

        3DGS takes the extent alone. Where the path is short, that is less than a background needs.
        """
        near = np.isfinite(means).all(axis=1)
        found = np.full(len(means), self.extent)
        found[near] = np.maximum(self.extent, cKDTree(self.places).query(means[near])[0])
        return found
