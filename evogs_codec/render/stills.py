"""A picture of splats that stay where they are and take other colours.

Whoever draws the same splats with several sets of SH puts them in place once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render import screen as s
from evogs_codec.render.activated import Activated, Buffers
from evogs_codec.render.blending import blend, constants_of
from evogs_codec.render.camera import Camera
from evogs_codec.render.compiled import n_threads, parallel_kernel, prange
from evogs_codec.render.forward import Colour, prepare
from evogs_codec.render.harmonics import basis
from evogs_codec.render.options import Options
from evogs_codec.render.splats import Real
from evogs_codec.render.tiles import Chunk, Tiles

__all__ = ["Still"]

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Still:
    """Splats in their places on one picture.

    Attributes:
        means: (N, 3) of the splats.
        camera, options: of the picture.
        background: (3,) float32, or a picture (H, W, 3).
        tiles, chunks: which splats are in each tile.
        status: (N,) as of `Drawing`.
    """

    means: Real
    camera: Camera
    options: Options
    background: Array
    tiles: Tiles
    chunks: Sequence[Chunk]
    status: npt.NDArray[np.uint8]

    @staticmethod
    def of(splats: Activated, camera: Camera, background: Colour, options: Options) -> Still:
        """Of splats; in memory of its own."""
        own = replace(splats, buffers=Buffers.of(len(splats)))
        tiles, status = prepare(own, camera, options)
        colour = np.asarray(background, np.float32)
        return Still(splats.means, camera, options, colour, tiles, [*tiles.chunks()], status)

    def with_sh(self, sh: Real) -> npt.NDArray[np.float32]:
        """(H, W, 3) the picture that `render` gives of the splats with this SH (N, K, 3)."""
        view = self.camera.view(self.options)
        _recolour(self.means, sh, view, self.status, self.tiles.records, n_threads())
        image = np.empty((self.camera.height, self.camera.width, 3), np.float32)
        is_picture = self.background.ndim > 1
        kept = image.shape[:2] if is_picture else (0, 0)
        transmittance, last = np.empty(kept, np.float32), np.empty(kept, np.int32)
        colour = np.zeros(3, np.float32) if is_picture else self.background
        constants = constants_of(self.options, np.float32)
        for chunk in self.chunks:
            blend(
                chunk.first, self.tiles.columns, chunk.offsets, chunk.entries, chunk.order,
                self.tiles.records, self.tiles.rows, colour, constants,
                image, transmittance, last, n_threads(),
            )  # fmt: skip
        if is_picture:
            image += transmittance[..., None] * self.background
        return image


@parallel_kernel
def _recolour(
    means: Array, sh: Array, view: Array, status: Array, records: Array, n_workers: int
) -> None:
    """Fill the colours of the records of N splats that are drawn.

    Arguments, several to a line:
        means, sh: parameters.
        view: `Camera.view`.
        status, records: what `projection.project` made; records in and out.
        n_workers: splats are dealt out to so many.
    """
    n, n_functions = len(means), sh.shape[1]
    for worker in prange(n_workers):
        values = np.empty(16)
        for i in range(worker * n // n_workers, (worker + 1) * n // n_workers):
            if status[i] != p.DRAWN:
                continue
            dx, dy = means[i, 0] - view[s.EYE], means[i, 1] - view[s.EYE + 1]
            dz = means[i, 2] - view[s.EYE + 2]
            inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            basis(
                dx * inverse, dy * inverse, dz * inverse,
                values, np.uint64(0), np.uint64(1), n_functions,
            )  # fmt: skip
            red = green = blue = 0.5
            for k in range(n_functions):
                red += values[k] * sh[i, k, 0]
                green += values[k] * sh[i, k, 1]
                blue += values[k] * sh[i, k, 2]
            records[i, p.RED], records[i, p.GREEN] = max(0.0, red), max(0.0, green)
            records[i, p.BLUE] = max(0.0, blue)
