"""States of a stream: what is shown after each step of its levels, and how good views find it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.encoding.few_views import N_DEVIATIONS
from evogs_codec.model.splats import F64
from evogs_codec.scene.prefixes import Prefixes

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["FALL_DB", "N_JUDGING_FIRST", "SAME_DB", "Draft", "State"]

SAME_DB = 0.03  # dB; two states look the same if no view differs by more
# A state is a fall if its mean gain over an earlier one, less `N_STANDARD_ERRORS` standard errors
# of a mean of `N_OF_ERROR` views, is below -`FALL_DB`.
FALL_DB, N_STANDARD_ERRORS, N_OF_ERROR = 0.05, 1.0, 6
ALL_JUDGE_STATES_UP_TO = 1_000  # of more splats a few views judge first
N_JUDGING_FIRST = 5  # of them, at most; every second or fifth view, so that they are of both sizes

_Place: TypeAlias = tuple[int, int]  # a level, and which of its steps


@dataclass(frozen=True, eq=False)
class State:
    """What is there after a step.

    Attributes:
        place: of the step.
        few: (f,) PSNR of a few views of it, dB.
        draw: gives (n,) that of the other views.
    """

    place: _Place
    few: F64
    draw: Callable[[], F64]

    @cached_property
    def decibels(self) -> F64:
        """PSNR of each view, dB; all are drawn where a few leave something in doubt."""
        return np.concatenate([self.few, self.draw()])

    @property
    def mean(self) -> float:
        """Of a few views, dB."""
        return float(self.few.mean())

    def is_like(self, other: State) -> bool:
        """Whether it looks the same."""
        return _is_like(self.few - other.few) and _is_like(self.decibels - other.decibels)

    def seems_to_fall_after(self, other: State) -> bool:
        """Whether it is a fall after another one, by the few views alone."""
        by = self.few - other.few
        return not _is_like(by) and _margin(by) < 0

    def keeps_up_with(self, other: State) -> bool:
        """Whether it is no fall after another one; all views are drawn where a few leave doubt."""
        by = self.few - other.few
        if not _is_like(by) and abs(_margin(by)) <= N_DEVIATIONS * by.std():
            by = self.decibels - other.decibels
        return _is_like(by) or _margin(by) >= 0


def _is_like(by: F64) -> bool:
    """Whether a state looks the same as one that it is better than by so many dB, view by view."""
    return bool(np.abs(by).max() <= SAME_DB)


def _margin(by: F64) -> float:
    """How far a state that is better by this, view by view, is from a fall, dB; below 0: one."""
    return float(by.mean() + FALL_DB - N_STANDARD_ERRORS * by.std() / math.sqrt(N_OF_ERROR))


@dataclass(frozen=True, eq=False)
class Draft:
    """A stream to be looked at.

    Attributes:
        prefixes: of it.
        n_levels: of it, that are looked at.
        sh_degree: of its splats.
        n_splats: that it has at last.
        views: that judge.
    """

    prefixes: Prefixes[Any]
    n_levels: int
    sh_degree: int
    n_splats: int
    views: Views
    _known: dict[int, F64] = field(default_factory=dict, repr=False)  # of the few views, by level

    def last_two(self) -> list[float]:
        """PSNR of the last two levels, of a few views, dB."""
        levels = [self.n_levels - k for k in (2, 1)]
        few, _ = self._few
        cuts = map(self.prefixes.of_level, levels)
        for level, leaves in zip(levels, self.prefixes.shown([*cuts], self.sh_degree), strict=True):
            self._known[level] = few.psnr_of_each(leaves)
        return [float(self._known[level].mean()) for level in levels]

    def roots_fall(self) -> bool:
        """Whether a state after a step of level 0 looks worse than one before it."""
        cuts = [((0, k), cut) for k, cut in enumerate(self.prefixes.steps_of(0))]
        if len(cuts) < 2:
            return False
        best, *others = self._states(cuts, no_progress, {})
        self._known[0] = others[-1].few
        for state in others:
            if not state.keeps_up_with(best):
                return True
            best = max(best, state, key=lambda state: state.mean)
        return False

    def states(self, progress: Progress = no_progress) -> list[State]:
        """Those after each step of the levels, but of level 0 only the last (`roots_fall`)."""
        cuts: list[tuple[_Place, Any]] = []
        known: dict[_Place, F64] = {}
        for level in range(self.n_levels):
            cuts += [((level, k), cut) for k, cut in enumerate(self.prefixes.steps_of(level))]
            if level in self._known:
                known[cuts[-1][0]] = self._known[level]
        n_first = sum(level == 0 for (level, _), _ in cuts)
        return self._states(cuts[max(n_first - 1, 0) :], progress, known)

    def _states(
        self, cuts: Sequence[tuple[_Place, Any]], progress: Progress, known: Mapping[_Place, F64]
    ) -> list[State]:
        """After cuts of which each contains the one before, with the PSNR of few views of some."""
        few, others = self._few

        def drawn(cut: Any) -> F64:  # noqa: ANN401
            if not others.cameras:
                return np.empty(0)
            return others.psnr_of_each(next(self.prefixes.shown([cut], self.sh_degree)))

        found: list[State] = []
        unknown = [cut for place, cut in cuts if place not in known]
        leaves = self.prefixes.shown(unknown, self.sh_degree)
        for place, cut in cuts:
            of_few = known[place] if place in known else few.psnr_of_each(next(leaves))
            found.append(State(place, of_few, partial(drawn, cut)))
            progress("look at prefixes", len(found) / len(cuts))
        return found

    @cached_property
    def _few(self) -> tuple[Views, Views]:
        """Views that judge first, and the others."""
        few = (
            self.views.fewer(N_JUDGING_FIRST)
            if self.n_splats > ALL_JUDGE_STATES_UP_TO
            else self.views
        )
        others = [camera for camera in self.views.cameras if camera not in few.cameras]
        return few, replace(self.views, cameras=others, drawn=self.views.drawn)
