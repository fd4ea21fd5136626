"""Rendered views of a scene, by which an encoder judges accuracy."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32, F64, SplatParams
from evogs_codec.render.activated import Activated
from evogs_codec.render.camera import Camera
from evogs_codec.render.forward import draw, render
from evogs_codec.render.framing import background_for, options_for
from evogs_codec.render.gradients import add_squared_gradients, gradients
from evogs_codec.render.metrics import psnr
from evogs_codec.render.options import DEFAULT, Options
from evogs_codec.render.splats import Real, Splats
from evogs_codec.render.stills import Still
from evogs_codec.render.up import Direction, up_of
from evogs_codec.render.viewpoints import (
    cameras_all_around,
    cameras_around,
    most_different,
    weighing_cameras,
)

__all__ = ["DRAWN", "HELD_OUT", "Between", "Colour", "Views", "view_of"]

Colour = tuple[float, float, float]
Picture: TypeAlias = npt.NDArray[np.float32]


class Between(NamedTuple):
    """What else a view shows, and where that is.

    Attributes:
        veil: (H, W, 1) how much of what is behind shows through what is in front.
        behind: (H, W, 3) picture of what is behind.
    """

    veil: npt.NDArray[np.floating]
    behind: npt.NDArray[np.floating]


MAX_PSNR = 150.0  # dB of a view: of one without any error, for a mean that is a number
DRAWN = 12  # views that the sensitivity is estimated from
MORE_OF_GIVEN = 2  # times as many of given cameras, each of which may show another part
COMPARED = 6  # of these, at most, compared with the scene
# Coarse levels of many splats are drawn in pictures whose longer side is this part of the others',
# and has this many pixels at least.
SMALLER, MIN_SIDE = 0.625, 200
# Of a level or scene of more splats each is one of many that are worth alike.
SMALLER_ABOVE = 10_000
HELD_OUT = 5  # every 5th of the cameras given judges what descends on the others


@dataclass(frozen=True)
class Views:
    """Pictures of a scene.

    Attributes:
        scene: what others are compared with.
        cameras: of the views.
        background: behind the splats.
        others: cameras of the views that descent goes by.
        weighing: cameras that the sensitivity is estimated from; none: of `cameras`.
        options: of rendering.
        n_drawn: views that the sensitivity is estimated from, at most.
        between: what is in front of and behind the splats in views that show more than them. What
            is in front is not in pictures of them; it only hides.
        drawn: pictures of the scene so far.
        known: dB of pictures of splats so far, by digest and camera; None: all are drawn again.
    """

    scene: SplatParams
    cameras: Sequence[Camera]
    background: Colour = (1.0, 1.0, 1.0)
    others: Sequence[Camera] = ()
    weighing: Sequence[Camera] = ()
    options: Options = DEFAULT
    n_drawn: int = DRAWN
    between: Mapping[Camera, Between] = field(default_factory=dict, repr=False, compare=False)
    drawn: dict[Camera, Picture] = field(default_factory=dict, repr=False, compare=False)
    known: dict[tuple[bytes, Camera], float] | None = field(default=None, repr=False, compare=False)

    @staticmethod
    def of(
        scene: SplatParams,
        cameras: Sequence[Camera] | None = None,
        *,
        up: Direction | None = None,
        n_views: int | None = None,
        descent: bool = False,
    ) -> Views:
        """The views that `evogs encode` judges by, on white or black (`background_for`).

        Args:
            scene: what they show.
            cameras: theirs; by default 24 on a circle around the scene, and errors are weighed by
                `weighing_cameras`. Of others more weigh errors, since each may show another part.
            up: what is up in the default views, as of `cameras_around`.
            n_views: at most this many views.
            descent: with `others`, for `loss_gradient`: 108 all around the scene, or of
                the `cameras` given all but every 5th, which judges.

        Raises:
            ValueError: there is one camera only, and `descent` needs two.
        """
        others: Sequence[Camera] = ()
        n_weighing = DRAWN if n_views is None else n_views
        if cameras is None:
            above = up_of(scene).vector if up is None else up
            chosen: Sequence[Camera] = cameras_around(scene, above)
            others = cameras_all_around(scene, above) if descent else ()
            few = chosen if n_views is None else _at_most(chosen, n_views)
            weighing: Sequence[Camera] = weighing_cameras(scene, above, n_weighing)
        elif descent:
            if len(cameras) < 2:
                raise ValueError(f"{len(cameras)} camera, expected at least 2")
            chosen = cameras[::HELD_OUT]
            others = [other for k, other in enumerate(cameras) if k % HELD_OUT]
        else:
            chosen = cameras
        if cameras is not None:
            few = chosen if n_views is None else most_different(chosen, n_views)
            n_weighing *= MORE_OF_GIVEN
            weighing = most_different(chosen, n_weighing)
        return Views(
            scene,
            few,
            background=background_for(scene),
            others=others,
            weighing=weighing,
            options=options_for(scene),
            n_drawn=max(n_weighing, DRAWN),
        )

    def fewer(self, n_views: int) -> Views:
        """At most this many of the views; what one has drawn of the scene, the other has."""
        return replace(self, cameras=_at_most(self.cameras, n_views), drawn=self.drawn)

    def within(self, pixels: int | None) -> Views:
        """The views with at most this many pixels along the longer side; None: as they are."""
        if pixels is None:
            return self
        cameras, weighing = (
            [one.within(pixels) for one in some] for some in (self.cameras, self.weighing)
        )
        return replace(self, cameras=cameras, weighing=weighing, drawn=self.drawn)

    def weighing_within(self, pixels: int | None) -> Views:
        """The same, whose sensitivity is estimated from views of at most so many pixels."""
        if pixels is None:
            return self
        weighing = [one.within(pixels) for one in self.weighing or self.cameras]
        return replace(self, weighing=weighing, drawn=self.drawn)

    def psnr(self, splats: SplatParams) -> float:
        """Mean PSNR over the views, dB; over those that show the scene, if some do."""
        return float(np.mean(self.psnr_of_each(splats)))

    def psnr_of_each(self, splats: SplatParams) -> F64:
        """(n,) dB of each view of which `psnr` is the mean."""
        ready = Activated.of(splats)
        digest = b"" if self.known is None else _digest_of(splats)
        return self._psnr_of_each(lambda camera: self._render(ready, camera), digest)

    def psnr_of_sh(self, splats: SplatParams, each: Iterable[F32]) -> Iterator[float]:
        """`psnr` of the splats with each SH (N, K, 3) in place of theirs, quicker than on its own.

        Args:
            splats: N splats.
            each: SH, of which one is needed at a time.
        """
        ready = Activated.of(splats)
        stills = {
            camera: Still.of(ready, camera, self._behind(camera), self.options)
            for camera in self.cameras
        }
        for sh in each:
            yield self._psnr(
                lambda camera, sh=sh: self._veiled(stills[camera].with_sh(sh), camera)  # type: ignore[misc]
            )

    def sensitivity(self, splats: SplatParams) -> F32:
        """(D, N) mean squared change of the pictures to the squared change of each number.

        Each view takes one backward pass, whatever the number of splats.
        """
        return self._sensitivity(splats, self._weighing.cameras)[0]

    def sensitivity_and_psnr(self, splats: SplatParams) -> tuple[F32, float]:
        """`sensitivity`, and the PSNR of every other of its views, dB.

        Of a coarse level, with at most a quarter of the splats of the scene, only those are drawn:
        each splat is in more pixels. So it is of any coarse level of many splats, and pictures of
        these are smaller (`_of_coarse`).
        """
        few = self._of_coarse
        is_coarse = 4 * len(splats) <= len(self.scene) or SMALLER_ABOVE < len(splats) < len(
            self.scene
        )
        if not is_coarse:
            return self.sensitivity(splats), few.psnr(splats)
        found, images = few._sensitivity(splats, few.cameras)
        return found, few._psnr(images.__getitem__)

    def loss_gradient(self, splats: SplatParams, iteration: int) -> F32:
        """(D, N) gradient of the mean squared error of a view of `others`, one per iteration.

        Raises:
            ValueError: there are no others.
        """
        if not self.others:
            raise ValueError("there are no other views to descend by")
        view = view_of(iteration, len(self.others))
        camera = self.others[view]
        drawing = draw(splats, camera, self._behind(camera), options=self.options)
        error = self._veiled(drawing.image, camera) - self._picture(camera)
        error = self._veiled(error * np.float32(2 / error.size), camera)
        gradient = gradients(drawing, splats, error)
        return SplatParams(*_parts(gradient)).channels()

    @property
    def _weighing(self) -> Views:
        """The views that the sensitivity is estimated from."""
        return replace(self, cameras=self.weighing or self.cameras).fewer(self.n_drawn)

    @cached_property
    def _of_coarse(self) -> Views:
        """The views that coarse levels are drawn in: of a scene of many splats they are smaller.

        Views that show more than the scene keep their size, which is that of `between`.
        """
        few = self._weighing.fewer(COMPARED)
        if len(self.scene) <= SMALLER_ABOVE or self.between:
            return few
        side = max((max(camera.width, camera.height) for camera in few.cameras), default=0)
        return few.within(max(round(SMALLER * side), MIN_SIDE))

    @property
    def pictures(self) -> list[Picture]:
        """Of the scene, (H, W, 3) each."""
        if any(camera not in self.drawn for camera in self.cameras):
            ready = Activated.of(self.scene)
            for camera in self.cameras:
                if camera not in self.drawn:
                    self.drawn[camera] = self._render(ready, camera)
        return [self.drawn[camera] for camera in self.cameras]

    def divided(self, every: int) -> tuple[Views, Views]:
        """Of the views that `psnr` is the mean of every so-many-th, and the others."""
        shows = self._shows if any(self._shows) else [True] * len(self.cameras)
        cameras = [camera for camera, shown in zip(self.cameras, shows, strict=True) if shown]
        others = [camera for k, camera in enumerate(cameras) if k % every]
        return (
            replace(self, cameras=cameras[::every], drawn=self.drawn),
            replace(self, cameras=others, drawn=self.drawn),
        )

    @cached_property
    def _shows(self) -> Sequence[bool]:
        """Of each view, whether the scene is in it."""
        empty = np.array(self.background, np.float32)
        # Of most views, a few pixels tell.
        return [
            bool((picture[::8, ::8] != empty).any() or (picture != empty).any())
            for picture in self.pictures
        ]

    def _picture(self, camera: Camera) -> Picture:
        if camera not in self.drawn:
            self.drawn[camera] = self._render(self.scene, camera)
        return self.drawn[camera]

    def _render(self, splats: Splats, camera: Camera) -> Picture:
        found: Picture = render(splats, camera, self._behind(camera), options=self.options)
        return self._veiled(found, camera)

    def _behind(self, camera: Camera) -> Colour | npt.NDArray[np.floating]:
        return self.between[camera].behind if camera in self.between else self.background

    def _veiled(self, picture: Picture, camera: Camera) -> Picture:
        if camera not in self.between:
            return picture
        # Numbers of 16 bits are slow to multiply by, and so is one number for three.
        veil = self.between[camera].veil[..., 0].astype(np.float32)
        found = np.empty_like(picture)
        for channel in range(picture.shape[-1]):
            np.multiply(picture[..., channel], veil, out=found[..., channel])
        return found

    def _shown(self, camera: Camera) -> npt.NDArray[np.floating] | None:
        """(H, W) how much of the splats is seen at each pixel; None: all of it."""
        return self.between[camera].veil[..., 0] if camera in self.between else None

    def _psnr(self, of: Callable[[Camera], Picture]) -> float:
        """Mean PSNR of these pictures of the views, as of `psnr`."""
        return float(np.mean(self._psnr_of_each(of)))

    def _psnr_of_each(self, of: Callable[[Camera], Picture], digest: bytes = b"") -> F64:
        """What pictures have; with the digest of what they show, none is asked for twice."""
        known = {} if self.known is None or not digest else self.known
        shows, pictures = self._shows, self.pictures
        found = []
        for camera, picture, is_shown in zip(self.cameras, pictures, shows, strict=True):
            if not is_shown and any(shows):
                continue
            if (digest, camera) not in known:
                known[digest, camera] = min(psnr(of(camera), picture), MAX_PSNR)
            found.append(known[digest, camera])
        return np.array(found)

    def _sensitivity(
        self, splats: SplatParams, cameras: Sequence[Camera]
    ) -> tuple[F32, dict[Camera, Picture]]:
        """By these views, and what they show."""
        totals = [np.zeros(part.shape, np.float32) for part in _parts(splats)]
        images = {}
        ready = Activated.of(splats)
        for camera in cameras:
            drawing = draw(ready, camera, self._behind(camera), options=self.options)
            images[camera] = self._veiled(drawing.image, camera)
            if not len(splats):
                continue
            add_squared_gradients(totals, drawing, ready, self._shown(camera))
        for total in totals:
            total /= len(cameras)
        return SplatParams(*totals).channels(), images


def view_of(iteration: int, n_views: int) -> int:
    """All views in random order, then all again in another."""
    round_, place = divmod(iteration, n_views)
    return int(np.random.default_rng(round_).permutation(n_views)[place])


def _at_most(cameras: Sequence[Camera], n: int) -> Sequence[Camera]:
    """Every so-many-th of the cameras, so that they are no more than n."""
    return cameras[:: max(1, -(-len(cameras) // n))]


def _digest_of(splats: SplatParams) -> bytes:
    digest = hashlib.blake2b(digest_size=32)
    for part in _parts(splats):
        digest.update(part.tobytes())
    return digest.digest()


def _parts(of: Splats) -> tuple[Real, ...]:
    """The numbers of splats, or the gradients to them, in the order of `SplatParams`."""
    return of.means, of.quats, of.log_scales, of.opacity_logits, of.sh
