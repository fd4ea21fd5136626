"""How good views find what a prefix of a stream shows, and by how much it looks worse."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.encoding.few_views import N_DEVIATIONS
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.scene.falls.states import FALL_DB

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["PACKET_FALL_DB", "Judges", "Prefix"]

PACKET_FALL_DB = FALL_DB / 2  # dB; views that are not drawn may show twice as much
SURELY_DB = 0.5  # what a few views find better by more is no fall, whatever another one shows


@dataclass(frozen=True)
class Judges:
    """Views that judge prefixes.

    What an SH band adds to a large splat may show in one view alone. Small pictures of all views
    show it, and decide where only colours differ. They do not show every fall where splats do:
    small splats are drawn larger than they are, by part of a pixel.

    Attributes:
        views: all of them.
        few: some of them, that judge first; None: all judge.
        small: all of them, in small pictures, that judge first, too; None: the few are enough.
    """

    views: Views
    few: Views | None = None
    small: Views | None = None


class Prefix:
    """How good views find what a prefix shows.

    All judge only where a few leave doubt. Where none judges first, its leaves are not kept.
    """

    def __init__(self, leaves: SplatParams, judges: Judges) -> None:
        """One that shows these leaves."""
        self._judges = judges
        if judges.few is None:
            self.psnr = judges.views.psnr(leaves)
        else:
            self._leaves = leaves

    def like(self, leaves: SplatParams) -> Prefix:
        """Another one, in which packets of SH bands may come in another order.

        All views judge where there are no small pictures: a few miss too many falls of SH bands.
        """
        judges = self._judges
        return Prefix(leaves, judges if judges.small else Judges(judges.views))

    @cached_property
    def psnr(self) -> float:
        """Of all views, dB."""
        return self._judges.views.psnr(self._leaves)

    def fall_after(self, other: Prefix, enough: float = math.inf) -> float:
        """How much worse it looks than another prefix, dB.

        An estimate, where those that judge first show that it is at most `PACKET_FALL_DB`, or more
        than `enough`. Otherwise all views judge.
        """
        if self._judges.few is not None and other._judges.few is not None:
            about, least, most = self._about(other)
            if most <= PACKET_FALL_DB or least > enough:
                return about
        return other.psnr - self.psnr

    def _about(self, other: Prefix) -> tuple[float, float, float]:
        """An estimate of how much worse it looks, and the least and the most it may be, dB."""
        worse = other._of_few - self._of_few
        mean, doubt = float(worse.mean()), N_DEVIATIONS * float(worse.std())
        if self._judges.small is None or mean + doubt <= -SURELY_DB:
            return mean, mean - doubt, mean + doubt
        small = other._of_small - self._of_small
        if self._has_splats_of(other):
            return small, small, small
        return mean, min(mean - doubt, small), max(mean + doubt, small)

    def _has_splats_of(self, other: Prefix) -> bool:
        """Whether the splats are those of another prefix, but for their SH."""
        of = ("means", "quats", "log_scales", "opacity_logits")
        one, two = self._leaves, other._leaves
        return len(one) == len(two) and all(
            np.array_equal(getattr(one, name), getattr(two, name)) for name in of
        )

    @cached_property
    def _of_few(self) -> F64:
        assert self._judges.few is not None, "a few views judge first"
        return self._judges.few.psnr_of_each(self._leaves)

    @cached_property
    def _of_small(self) -> float:
        assert self._judges.small is not None, "small pictures judge first"
        return self._judges.small.psnr(self._leaves)
