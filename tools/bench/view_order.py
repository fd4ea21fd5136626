"""Which packets come first for a camera: as `viewOrder` of `evogs-fetch` has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.format.directory import Directory
from evogs_codec.model.components import PALETTE, PICKS
from evogs_codec.model.splats import F64, I64
from evogs_codec.render import Camera

__all__ = ["Boxes", "view_order"]

POINTS = 5  # of a box along an axis
UNSEEN = 0.3  # the least weight


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes around splats.

    Attributes:
        low, high: (n, 3) least and greatest positions.
    """

    low: F64
    high: F64

    @staticmethod
    def of_tiles(directory: Directory) -> Boxes:
        """Those of the tile table."""
        tiles, unit = directory.tiles, 2.0 ** -directory.grid_exponents[0]
        low, high = ((tiles["origin"] + tiles[name]) * unit for name in ("box_min", "box_max"))
        return Boxes(low.astype(np.float64), high.astype(np.float64))

    def in_sight(self, camera: Camera) -> npt.NDArray[np.bool_]:
        """(n,) whether the sphere around each box meets what the camera sees."""
        radii = np.linalg.norm(self.high - self.low, axis=1) / 2
        return _is_inside((self.low + self.high) / 2, camera, radii)

    def weights(self, camera: Camera) -> F64:
        """(n,) how large each box looks: the root of its area in sight, to that of the largest."""
        steps = (np.arange(POINTS) + 0.5) / POINTS
        grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        points = self.low[:, None] + grid * (self.high - self.low)[:, None]
        away = np.maximum(
            np.linalg.norm(points - camera.position, axis=2), np.finfo(np.float32).tiny
        )
        areas = (_is_inside(points, camera) / away**2).mean(axis=1)
        largest = max(float(areas.max()), np.finfo(float).tiny)
        return np.asarray(np.maximum(UNSEEN, np.sqrt(areas / largest)))


def _is_inside(points: F64, camera: Camera, margin: F64 | float = 0.0) -> npt.NDArray[np.bool_]:
    """(...) whether points (..., 3) are at most `margin` (...) out of what the camera sees."""
    at = points @ camera.rotation.T + camera.translation
    sides = np.array(
        [
            [camera.fx, 0, camera.cx],
            [-camera.fx, 0, camera.width - camera.cx],
            [0, camera.fy, camera.cy],
            [0, -camera.fy, camera.height - camera.cy],
        ]
    )
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    inside: npt.NDArray[np.bool_] = (at @ sides.T >= -np.asarray(margin)[..., None]).all(axis=-1)
    return inside


def view_order(directory: Directory, weights: F64) -> I64:
    """All packets, the most urgent first: as in the file, with tiles ahead that look large.

    Args:
        directory: of the stream.
        weights: (n_tiles,) of `Boxes.weights`.
    """
    packets = directory.packets
    value = np.empty(len(packets))
    before: dict[tuple[int, int], float] = {}
    core: dict[tuple[int, int], float] = {}
    for i, (tile, component) in enumerate(zip(packets["tile"], packets["component"], strict=True)):
        own = weights.max() if component == PALETTE else weights[tile]
        step = (int(tile), int(directory.steps[i]))
        own /= directory.offsets[i]
        chain = (-1 if component == PALETTE else int(tile), int(component))
        own = min(own, before.get(chain, np.inf))
        if component not in (0, PALETTE):
            own = min(own, core[step])
        if component == PICKS:
            own = min(own, before.get((-1, PALETTE), np.inf))
        if component == 0:
            core[step] = own
        value[i] = before[chain] = own
    return np.argsort(-value, kind="stable").astype(np.int64)
