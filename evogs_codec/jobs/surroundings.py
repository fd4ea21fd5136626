"""Views of a tile among its neighbours, which hide parts of it and are far larger.

What a tile alone shows, cut out of its scene, is not what a viewer sees: cut faces, insides, all of
it near. So its views are those of its neighbourhood, where some splats of each other tile, larger
than they are, stand for all.

Letters: N splats of the tile, D channels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.encoding.settings import SCENE_PRICE
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import F32, F64, SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Views
    from evogs_codec.render.up import Direction

__all__ = ["Neighbourhood", "enlarged", "price_of"]

BULK = (20, 80)  # percentiles of the positions
FAR = 8.0  # times the size of a tile: a neighbourhood that is larger does not show it


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pictures of a tile among others (`encoding.measured_gains.Telling`).

    Attributes:
        views: of the tile and what is around it.
        around: what stands for the other tiles.
        n_shown: splats for which the views are: those of all tiles, or of this one, if it is so
            small that views of all would not show it.
        n_circle: of the views, the first so many stand on the circle.
        keep: what an error of a position as large as its splat costs at least, whether a view
            shows it or not, in mean squared error.
    """

    views: Views
    around: SplatParams
    n_shown: int
    n_circle: int
    keep: float

    @staticmethod
    def of(
        splats: SplatParams,
        own: SplatParams,
        around: SplatParams,
        n_around: int,
        *,
        up: Direction,
        n_views: int,
        all_round: bool,
        keep: float,
    ) -> Neighbourhood:
        """From cameras around all of it.

        Args:
            splats: of the tile.
            own: what stands for them in the views of other tiles.
            around: the same of the other tiles.
            n_around: splats of all tiles.
            up: axis or vector that is up.
            n_views: so many.
            all_round: some of them stand below and far above.
            keep: times a price of a bit, that of the splats for which the views are.
        """
        from evogs_codec.render import Views, cameras_around, weighing_cameras
        from evogs_codec.render.framing import options_for
        from evogs_codec.render.viewpoints import n_on_circle

        stands_in = _joined(own, around)
        middle, size = _bulk(splats)
        is_apart = not len(stands_in) or _bulk(stands_in)[1] > FAR * size
        # Of a tile that has an object and a part of the city around it, the object.
        near = np.abs(splats.means - middle).max(axis=1) <= max(size, 1e-30)
        shown = splats.take(near) if is_apart else stands_in
        looked_at = shown if len(shown) else splats
        cameras = (
            weighing_cameras(looked_at, up, n_views)
            if all_round
            else cameras_around(looked_at, up, n=n_views)
        )
        views = Views.of(_joined(splats, around), cameras)
        options = options_for(shown)
        n_shown = len(splats) if is_apart else n_around
        return Neighbourhood(
            replace(views, options=options),
            around,
            n_shown,
            n_on_circle(n_views) if all_round else n_views,
            keep * price_of(n_shown),
        )

    def fewer(self, n_views: int) -> Neighbourhood:
        """At most this many of the views, of those on the circle."""
        circle = replace(self.views, cameras=self.views.cameras[: self.n_circle])
        return replace(self, views=circle.fewer(n_views))

    def within(self, pixels: int | None) -> Neighbourhood:
        """The views with at most this many pixels along the longer side; None: as they are."""
        return replace(self, views=self.views.within(pixels))

    def psnr(self, splats: SplatParams) -> float:
        """Mean PSNR of the views with the tile as these splats, dB."""
        return self.views.psnr(_joined(splats, self.around))

    def sensitivity(self, splats: SplatParams) -> F32:
        """(D, N) mean squared change of the pictures to the squared change of each number."""
        return self._own(self.views.sensitivity(_joined(splats, self.around)), splats)

    def sensitivity_and_psnr(self, splats: SplatParams) -> tuple[F32, float]:
        """Both, of pictures that are drawn once."""
        found, decibels = self.views.sensitivity_and_psnr(_joined(splats, self.around))
        return self._own(found, splats), decibels

    def loss_gradient(self, splats: SplatParams, iteration: int) -> F32:
        """(D, N) gradient of the mean squared error of one view."""
        found = self.views.loss_gradient(_joined(splats, self.around), iteration)
        return self._own(found, splats)

    def _own(self, found: F32, splats: SplatParams) -> F32:
        own = found[: n_channels(splats.sh_degree), : len(splats)].copy()
        sizes = np.exp(np.clip(splats.log_scales.max(axis=1), -40, 40))
        own[0:3] = np.maximum(own[0:3], self.keep / np.square(sizes))
        return own


def _bulk(splats: SplatParams) -> tuple[F64, float]:
    """(3,) middle and diagonal of what most splats are in, large ones and small ones alike."""
    low, high = np.percentile(splats.means.astype(np.float64), BULK, axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low))


def price_of(n_splats: int) -> float:
    """Of a bit, in mean squared error of views for so many splats."""
    return SCENE_PRICE / max(n_splats, 1)


def enlarged(splats: SplatParams, every: int) -> SplatParams:
    """Splats of which each stands for `every`, with the area of all."""
    return replace(splats, log_scales=splats.log_scales + np.float32(math.log(every) / 2))


def _joined(splats: SplatParams, around: SplatParams) -> SplatParams:
    """These, then those around, at the higher of their SH degrees."""
    parts: Sequence[SplatParams] = splats, around
    d = max(n_channels(part.sh_degree) for part in parts)
    rows = [part.channels() for part in parts]
    padded = [np.pad(x, ((0, d - len(x)), (0, 0))) for x in rows]
    return SplatParams.from_channels(np.concatenate(padded, axis=1))
