"""Pictures of scenes from the same cameras: PSNR and SSIM per view, and where they differ."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.common.progress import Progress
from evogs_codec.model.splats import SplatParams
from evogs_codec.render import Camera, psnr, render, ssim
from evogs_codec.render.framing import options_for
from evogs_codec.render.png import Real

__all__ = ["DIFFERENCE_GAIN", "MAX_PSNR", "Likeness", "Look", "difference", "evenly", "look"]

DIFFERENCE_GAIN = 8  # by which a difference picture shows differences larger
MAX_PSNR = 150.0  # dB of pictures without any difference, for a mean that is a number
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Likeness:
    """V views of a scene against those of a reference.

    Attributes:
        psnr: dB of each view, at most `MAX_PSNR`, which equal pictures have.
        ssim: of each view.
    """

    psnr: tuple[float, ...]
    ssim: tuple[float, ...]

    @property
    def is_equal(self) -> bool:
        """There is no difference in any view."""
        return all(decibels >= MAX_PSNR for decibels in self.psnr)

    @property
    def mean_psnr(self) -> float:
        """Of all views, dB."""
        return float(np.mean(self.psnr))

    @property
    def mean_ssim(self) -> float:
        """Of all views."""
        return float(np.mean(self.ssim))


@dataclass(frozen=True, eq=False)
class Look:
    """What scenes look like.

    Attributes:
        likeness: of each scene, to the first.
        shown: numbers of the views whose pictures are kept.
        pictures: per scene, those pictures, (H, W, 3) each.
    """

    likeness: tuple[Likeness, ...]
    shown: tuple[int, ...]
    pictures: tuple[tuple[Real, ...], ...]


def look(
    scenes: Sequence[SplatParams],
    cameras: Sequence[Camera],
    background: Colour,
    *,
    shown: Iterable[int] = (),
    progress: Progress,
) -> Look:
    """Render scenes from all cameras, and compare each with the first.

    Args:
        scenes: the reference, and others.
        cameras: V of them, at least one.
        background: behind the splats.
        shown: numbers of views whose pictures are kept.
        progress: called with the stage "render" and the part that is done.
    """
    kept, options = tuple(sorted(set(shown))), options_for(scenes[0])
    figures: list[list[tuple[float, float]]] = [[] for _ in scenes]
    pictures: list[list[Real]] = [[] for _ in scenes]
    for number, camera in enumerate(cameras):
        progress("render", number / len(cameras))
        drawn = [render(scene, camera, background, options=options) for scene in scenes]
        for of, picture in zip(figures, drawn, strict=True):
            of.append((min(psnr(picture, drawn[0]), MAX_PSNR), ssim(picture, drawn[0])))
        if number in kept:
            for mine, picture in zip(pictures, drawn, strict=True):
                mine.append(picture)
    progress("render", 1.0)
    likeness = tuple(
        Likeness(tuple(p for p, _ in of), tuple(min(s, 1.0) for _, s in of)) for of in figures
    )
    return Look(likeness, kept, tuple(tuple(mine) for mine in pictures))


def evenly(n: int, wanted: int) -> list[int]:
    """At most `wanted` of the numbers 0..n-1, evenly spread."""
    wanted = min(n, wanted)
    return [math.floor(k * n / wanted) for k in range(wanted)]


def difference(picture: Real, reference: Real) -> Real:
    """(H, W, 3) white where two pictures are equal, darker by `DIFFERENCE_GAIN` times the error."""
    error = np.abs(picture.astype(np.float32) - reference.astype(np.float32))
    return np.asarray(1 - np.clip(DIFFERENCE_GAIN * error, 0, 1))
