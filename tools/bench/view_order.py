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

GRID = 12  # rays along a side of the picture
ENOUGH = 0.25  # part of the picture; a tile that covers more is no more urgent
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
        found: npt.NDArray[np.bool_] = (
            _sides((self.low + self.high) / 2, camera) >= -radii[:, None]
        ).all(axis=1)
        return found

    def covers(self, camera: Camera) -> F64:
        """(n,) part of the picture that each box covers, on a grid of rays.

        Half a ray for one that no ray meets, unless all of it is beyond a side of the picture.
        """
        at = (np.arange(GRID) + 0.5) / GRID
        x, y = (a.ravel() for a in np.meshgrid(at * camera.width, at * camera.height))
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)])
        ways = rays.T @ camera.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [(side[:, None] - camera.position) / ways for side in (self.low, self.high)]
        enters, leaves = np.minimum(*ends).max(axis=2), np.maximum(*ends).min(axis=2)
        met = np.count_nonzero(leaves >= np.maximum(enters, 0), axis=1)
        corners = np.where(_CORNERS, self.high[:, None], self.low[:, None])
        is_beyond = np.any(np.all(_sides(corners, camera) < 0, axis=1), axis=1)
        found: F64 = np.where(is_beyond, 0, np.maximum(met, 0.5)) / GRID**2
        return found

    def weights(self, camera: Camera) -> F64:
        """(n,) how urgent each box is, from `UNSEEN` to 1: by what it covers of the picture.

        1 is a quarter of the picture, or the mean of what is in sight if that is less.
        """
        covers = self.covers(camera)
        seen = covers[covers > 0]
        enough = min(ENOUGH, float(seen.mean())) if len(seen) else ENOUGH
        return np.asarray(np.clip(covers / enough, UNSEEN, 1))


# (8, 3) whether a corner of a box is its high end along each axis.
_CORNERS = np.arange(8)[:, None] >> np.arange(3) & 1 == 1


def _sides(points: F64, camera: Camera) -> F64:
    """(..., 4) how far points (..., 3) are inside each side of what the camera sees."""
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
    found: F64 = at @ sides.T
    return found


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
