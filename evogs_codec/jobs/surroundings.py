"""Views of a tile among its neighbours, which hide parts of it and are far larger.

What a tile alone shows, cut out of its scene, is not what a viewer sees: cut faces, insides, all of
it near. So its views are those of its neighbourhood, with panes of the other tiles (`panes`). The
cameras stand around some splats of each tile, which stand for all. They are also what is drawn of
other tiles, larger than they are, where a tile is apart and has views of its own as well.

Letters: N splats of the tile, D channels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import tee
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.encoding.settings import SCENE_PRICE
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import F32, F64, SplatParams

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Options, Views
    from evogs_codec.render.up import Direction
    from evogs_codec.render.views import Between, Colour

__all__ = [
    "NearAndWide",
    "Neighbourhood",
    "Standing",
    "enlarged",
    "is_apart",
    "near_middle",
    "part_shown",
    "price_of",
]

BULK = (20, 80)  # percentiles of the positions
MAX_OF_TILE = 8.0  # times the size of a tile: a neighbourhood that is larger does not show it


@dataclass(frozen=True, eq=False)
class Standing:
    """Where cameras stand around splats.

    Attributes:
        cameras: of the views.
        n_circle: of these, the first so many stand on the circle.
        options: of rendering.
        background: behind all.
    """

    cameras: Sequence[Camera]
    n_circle: int
    options: Options
    background: Colour

    @staticmethod
    def around(
        splats: SplatParams, *, up: Direction, n_views: int, all_round: bool, pixels: int | None
    ) -> Standing:
        """Around all of the splats.

        Args:
            splats: at least one.
            up: axis or vector that is up.
            n_views: so many.
            all_round: some of them stand below and far above.
            pixels: of the longer side, at most; None: as cameras are by default.
        """
        from evogs_codec.render import cameras_around, weighing_cameras
        from evogs_codec.render.framing import background_for, options_for
        from evogs_codec.render.viewpoints import n_on_circle

        cameras = (
            weighing_cameras(splats, up, n_views)
            if all_round
            else cameras_around(splats, up, n=n_views)
        )
        if pixels is not None:
            cameras = [camera.within(pixels) for camera in cameras]
        n_circle = n_on_circle(n_views) if all_round else n_views
        return Standing(cameras, n_circle, options_for(splats), background_for(splats))

    def seen_from(self, origin: F64) -> Standing:
        """The same cameras as seen from another origin (3,)."""
        cameras = [
            replace(camera, translation=camera.translation + camera.rotation @ origin)
            for camera in self.cameras
        ]
        return replace(self, cameras=cameras)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pictures of a tile among others (`encoding.measured_gains.Telling`).

    Attributes:
        views: of the tile and what is around it.
        around: splats that stand for the other tiles; none where views have panes of them.
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
        standing: Standing,
        n_shown: int,
        *,
        keep: float,
        around: SplatParams | None = None,
        between: Mapping[Camera, Between] | None = None,
    ) -> Neighbourhood:
        """From cameras around all of it, or around a tile that is apart.

        Args:
            splats: of the tile.
            standing: where cameras stand.
            n_shown: splats for which the views are.
            keep: times a price of a bit, that of the splats for which the views are.
            around: what stands for the other tiles.
            between: of each view, what of other tiles is in front and behind.
        """
        from evogs_codec.render import Views

        around = splats.take(slice(0)) if around is None else around
        views = Views.of(SplatParams.joined([splats, around]), standing.cameras)
        views = replace(
            views,
            options=standing.options,
            background=standing.background,
            between=between or {},
        )
        return Neighbourhood(views, around, n_shown, standing.n_circle, keep * price_of(n_shown))

    def fewer(self, n_views: int) -> Neighbourhood:
        """At most this many of the views, of those on the circle."""
        circle = replace(self.views, cameras=self.views.cameras[: self.n_circle])
        return replace(self, views=circle.fewer(n_views))

    def psnr(self, splats: SplatParams) -> float:
        """Mean PSNR of the views with the tile as these splats, dB."""
        return self.views.psnr(SplatParams.joined([splats, self.around]))

    def psnr_of_sh(self, splats: SplatParams, each: Iterable[F32]) -> Iterator[float]:
        """Mean PSNR with each SH (N, K, 3) in place of those of the splats, dB."""
        joined = SplatParams.joined([splats, self.around])

        def all_of(sh: F32) -> F32:
            around = self.around.sh
            k = max(sh.shape[1], around.shape[1])
            parts = [np.pad(x, ((0, 0), (0, k - x.shape[1]), (0, 0))) for x in (sh, around)]
            return np.concatenate(parts)

        return self.views.psnr_of_sh(joined, map(all_of, each))

    def sensitivity(self, splats: SplatParams) -> F32:
        """(D, N) mean squared change of the pictures to the squared change of each number."""
        return self._own(self.views.sensitivity(SplatParams.joined([splats, self.around])), splats)

    def sensitivity_and_psnr(self, splats: SplatParams) -> tuple[F32, float]:
        """Both, of pictures that are drawn once."""
        found, decibels = self.views.sensitivity_and_psnr(SplatParams.joined([splats, self.around]))
        return self._own(found, splats), decibels

    def loss_gradient(self, splats: SplatParams, iteration: int) -> F32:
        """(D, N) gradient of the mean squared error of one view."""
        found = self.views.loss_gradient(SplatParams.joined([splats, self.around]), iteration)
        return self._own(found, splats)

    def _own(self, found: F32, splats: SplatParams) -> F32:
        own = found[: n_channels(splats.sh_degree), : len(splats)].copy()
        sizes = np.exp(np.clip(splats.log_scales.max(axis=1), -40, 40))
        own[0:3] = np.maximum(own[0:3], self.keep / np.square(sizes))
        return own


@dataclass(frozen=True, eq=False)
class NearAndWide:
    """Pictures of a tile that is apart: its own, and those of all of its neighbourhood.

    What the wide ones alone show, such as the sky above an object, counts as well. Errors are in
    prices of the near ones: those of the wide ones count more, as they are for more splats.

    Attributes:
        near: views of the tile.
        wide: views of the neighbourhood.
    """

    near: Neighbourhood
    wide: Neighbourhood

    @property
    def n_shown(self) -> int:
        """Splats whose price of a bit errors have."""
        return self.near.n_shown

    def fewer(self, n_views: int) -> NearAndWide:
        """At most this many views of each kind, of those on the circle."""
        return NearAndWide(self.near.fewer(n_views), self.wide.fewer(n_views))

    def psnr(self, splats: SplatParams) -> float:
        """PSNR whose squared error is that of both kinds, with the tile as these splats, dB."""
        return self._in_both(self.near.psnr(splats), self.wide.psnr(splats))

    def psnr_of_sh(self, splats: SplatParams, each: Iterable[F32]) -> Iterator[float]:
        """`psnr` with each SH (N, K, 3) in place of those of the splats."""
        first, second = tee(each)
        near, wide = self.near.psnr_of_sh(splats, first), self.wide.psnr_of_sh(splats, second)
        return map(self._in_both, near, wide)

    def sensitivity(self, splats: SplatParams) -> F32:
        """(D, N) mean squared change of the pictures to the squared change of each number."""
        return self.near.sensitivity(splats) + self._factor * self.wide.sensitivity(splats)

    def sensitivity_and_psnr(self, splats: SplatParams) -> tuple[F32, float]:
        """Both, of pictures that are drawn once."""
        of_near, near = self.near.sensitivity_and_psnr(splats)
        of_wide, wide = self.wide.sensitivity_and_psnr(splats)
        return of_near + self._factor * of_wide, self._in_both(near, wide)

    def loss_gradient(self, splats: SplatParams, iteration: int) -> F32:
        """(D, N) gradient of the mean squared error of one of the near views."""
        return self.near.loss_gradient(splats, iteration)

    @property
    def _factor(self) -> np.float32:
        return np.float32(self.wide.n_shown / self.near.n_shown)

    def _in_both(self, near: float, wide: float) -> float:
        return -10 * math.log10(10 ** (-near / 10) + float(self._factor) * 10 ** (-wide / 10))


def is_apart(splats: SplatParams, stand_ins: SplatParams) -> bool:
    """Whether a neighbourhood, with these stand-ins, is too large to show a tile."""
    return not len(stand_ins) or _bulk(stand_ins)[1] > MAX_OF_TILE * _bulk(splats)[1]


def part_shown(stand_ins: Sequence[SplatParams]) -> float:
    """What part of the splats of a neighbourhood its views show: tiles that are apart are dots.

    `stand_ins` are those of each tile, at least one in all.
    """
    parts, of_all = stand_ins, SplatParams.joined(stand_ins)
    shown = sum(len(part) for part in parts if len(part) and not is_apart(part, of_all))
    return shown / len(of_all) if shown else 1.0


def near_middle(splats: SplatParams) -> SplatParams:
    """Of a tile that has an object and a part of the city around it, the object."""
    middle, size = _bulk(splats)
    near = splats.take(np.abs(splats.means - middle).max(axis=1) <= max(size, 1e-30))
    return near if len(near) else splats


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
