"""What an encoder asks of views of a scene: protocols, of which `render.Views` has all.

Whoever has another renderer gives an object with the methods of `Pictures`. What the others add
saves time.

Letters: N splats, D channels, K SH coefficients of a channel, n views.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, runtime_checkable

from evogs_codec.model.splats import F32, F64, SplatParams

__all__ = ["Divisible", "Pictures", "Recolouring", "Telling"]


class Pictures(Protocol):
    """Views of a scene."""

    def sensitivity(self, splats: SplatParams) -> F32:
        """(D, N) mean squared change of the pictures to the squared change of each number."""

    def psnr(self, splats: SplatParams) -> float:
        """Mean PSNR of pictures of `splats` against those of the scene, dB."""

    def loss_gradient(self, splats: SplatParams, iteration: int) -> F32:
        """(D, N) gradient of the mean squared error of one view, not of those of `psnr`."""


@runtime_checkable
class Telling(Pictures, Protocol):
    """Pictures that give their sensitivity and their PSNR together, drawn once."""

    def sensitivity_and_psnr(self, splats: SplatParams) -> tuple[F32, float]:
        """`sensitivity`, and the PSNR of some of the pictures that are drawn for it, dB."""


@runtime_checkable
class Recolouring(Pictures, Protocol):
    """Pictures that are drawn again in less time where only SH change."""

    def psnr_of_sh(self, splats: SplatParams, each: Iterable[F32]) -> Iterator[float]:
        """`psnr` of the splats with each SH (N, K, 3) in place of theirs."""


@runtime_checkable
class Divisible(Pictures, Protocol):
    """Pictures of which some can be drawn without the others."""

    def psnr_of_each(self, splats: SplatParams) -> F64:
        """(n,) dB of each view of which `psnr` is the mean."""

    def divided(self, every: int) -> tuple[Divisible, Divisible]:
        """Of the views that `psnr` is the mean of every so-many-th, and the others."""
