"""The PSNR that a search goes by: of a few views where these tell that it is not what is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evogs_codec.encoding.pictures import Divisible
from evogs_codec.encoding.search import Goal
from evogs_codec.model.splats import F64, SplatParams

__all__ = ["EVERY", "MIN_VIEWS", "N_DEVIATIONS", "FewViews"]

EVERY = 5  # one of so many views is one of the few; they are of both sizes
N_DEVIATIONS = 0.8  # standard deviations that the mean of a few views is from that of all, at most
# In a search more: a wrong early value would never be measured again.
N_DEVIATIONS_IN_SEARCH = 2 * N_DEVIATIONS
MIN_VIEWS = 5  # few views; the deviation of fewer says little


@dataclass(eq=False)
class FewViews:
    """PSNR of splats, one after the other, in search of a goal.

    Views differ far more from each other than in what a price changes. So the few are compared with
    the same views of the splats that all views judged last.

    Attributes:
        views: that judge.
        goal: what is searched for.
        of_all: (n,) of the splats that all views judged last, dB, the few first.
    """

    views: Divisible
    goal: Goal
    of_all: F64 | None = None

    def psnr(self, splats: SplatParams) -> float:
        """In dB; about, where it is not what is wanted."""
        few, others = self._divided
        each = few.psnr_of_each(splats)
        if self.of_all is not None and len(each) >= MIN_VIEWS:
            by = each - self.of_all[: len(each)]
            about = float(self.of_all.mean() + by.mean())
            if abs(about - self.goal.value) > self.goal.slack + N_DEVIATIONS_IN_SEARCH * by.std():
                return about
        self.of_all = np.concatenate([each, others.psnr_of_each(splats)])
        return float(self.of_all.mean())

    @cached_property
    def _divided(self) -> tuple[Divisible, Divisible]:
        return self.views.divided(EVERY)
