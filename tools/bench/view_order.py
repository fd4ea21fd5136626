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

UNSEEN = 0.1  # of the weight of a box in sight


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
        at = (self.low + self.high) / 2 @ camera.rotation.T + camera.translation
        sides = np.array(
            [
                [camera.fx, 0, camera.cx],
                [-camera.fx, 0, camera.width - camera.cx],
                [0, camera.fy, camera.cy],
                [0, -camera.fy, camera.height - camera.cy],
            ]
        )
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        inside: npt.NDArray[np.bool_] = (at @ sides.T >= -self.radii[:, None]).all(axis=1)
        return inside

    @property
    def radii(self) -> F64:
        """(n,) half of each diagonal."""
        return np.asarray(np.linalg.norm(self.high - self.low, axis=1) / 2)

    def weights(self, camera: Camera) -> F64:
        """(n,) how large each box looks: 1 if the eye is in it."""
        eye = camera.position
        away = np.linalg.norm(np.maximum(np.maximum(self.low - eye, eye - self.high), 0), axis=1)
        sizes = self.radii / np.maximum(np.maximum(away, self.radii), np.finfo(float).tiny)
        return np.asarray(np.where(self.in_sight(camera), 1, UNSEEN) * sizes)


def view_order(directory: Directory, weights: F64) -> I64:
    """All packets, the most urgent first: near before far, coarse before fine, core before SH.

    Args:
        directory: of the stream.
        weights: (n_tiles,) of `Boxes.weights`.
    """
    packets, labels = directory.packets, directory.labels
    value = np.empty(len(packets))
    before: dict[tuple[int, int], float] = {}
    core: dict[tuple[int, int], float] = {}
    for i, (tile, component) in enumerate(zip(packets["tile"], packets["component"], strict=True)):
        own = weights.max() if component == PALETTE else weights[tile]
        step = (int(tile), int(directory.steps[i]))
        # Each level halves what is left to gain, and SH gain as much as core two levels later.
        own *= 2.0 ** -labels[i] * (1 if component in (0, PALETTE) else 0.25 / component)
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
