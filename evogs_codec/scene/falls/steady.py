"""No step back: makes streams whose prefixes do not look worse than shorter prefixes.

The state after each step of the levels is rendered. If a state after some of the roots looks worse
than an earlier one, all roots come in one step. If another state looks worse than one before it,
its step comes with those after it (`joined_steps`), or is held back until it looks better
(`held_steps`); with a target, coarse splats are made finer before that, until their last level
looks better than the one before it.
If all coarse splats together look worse than some of them, all are made finer; if they look worse
than level 0 then, there is one layer of precision.

If the last level, at coarse steps, looks hardly better than the level before it, it comes late
(`late_level`); where steps would be held back, it does even if it looks somewhat better. It comes
late too if all coarse splats look far worse than the PSNR that is aimed at: then there are three
layers, and it comes with the second.

Only coarse levels are made for that, at the price of a bit that was found; the whole stream is made
when they do not fall. Its packets are looked at then (`packet_falls`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from evogs_codec.common.progress import Progress
from evogs_codec.editing.level_psnr import LevelPsnr, with_level_psnr
from evogs_codec.encoding.corrections import corrections
from evogs_codec.encoding.guess import LOW_PSNR
from evogs_codec.encoding.held_steps import ROOTS, Run, places
from evogs_codec.encoding.late_level import gains_little
from evogs_codec.encoding.layers import N_LAYERS, PRICE_RATIO, PRICE_RATIO_BETWEEN, Layering
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.encoding.settings import SCENE_PRICE
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.falls.packet_falls import without_falls
from evogs_codec.scene.falls.states import FALL_DB, N_JUDGING_FIRST, SAME_DB, Draft, State
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.measure import Gauge, without_room
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Camera, Views

__all__ = ["steady"]

# dB; all coarse splats look better than level 0 by this at least, and worse than the best state by
# this at most. Otherwise they are made more exact.
MIN_GAIN_DB = 0.5
# dB; if coarse splats look worse than what is aimed at by more, a layer comes between. They are not
# drawn where the slope of the PSNR tells that they look worse, by so many dB more.
WIDE_DB, UNSURE_DB = 16.0, 3.0
FINER_RATIO, MIN_RATIO = 4.0, 2.0  # of the price of a bit, from a layer to the next
# Price of a bit of coarse splats, times the number of splats: beyond, they show hardly anything.
MAX_COARSE_PRICE = 0.2
# dB; a state that one view, or two, find better by this is not drawn in the others.
BETTER_IN_ONE_DB, BETTER_IN_TWO_DB = 1.0, 0.2
# Of the logarithm of a price of a bit: states at prices this near are not looked at.
SAME_PRICE = 0.1
MAX_TRIES = 8  # streams that are made again, at most


def steady(found: FoundStream, request: Request) -> FoundStream:
    """The stream without falls, as far as it was made by views; it says the PSNR of its levels."""
    gauge = Gauge.of(found.tree, request)
    if gauge is None:
        made = found.made()
        _warn_of_span(made, request)
        return replace(made, stream=without_room(made.data, request))
    steadied = _steadied(found, gauge.many, request) if found.is_by_views else found.made()
    steadied = without_falls(steadied, gauge, request)
    _warn_of_span(steadied, request)
    prefixes, data = steadied.prefixes, steadied.data
    cuts = [prefixes.of_level(level) for level in range(prefixes.n_levels)]
    levels: list[float] = []
    for leaves in prefixes.shown(cuts, found.tree.shown_degree):
        request.progress("measure", len(levels) / len(cuts))
        levels.append(gauge.views.psnr(leaves))
    request.progress("measure", 1.0)
    return replace(steadied, stream=with_level_psnr(data, LevelPsnr(tuple(levels), gauge.said)))


def _warn_of_span(made: FoundStream, request: Request) -> None:
    """Warn of coarse values of a stream; with a target PSNR, what is reached is measured."""
    if request.target_psnr is None:
        made.warn_of_span()


def _steadied(found: FoundStream, views: Views, request: Request) -> FoundStream:
    """The stream without falls, made."""
    may_be_late = request.layers is None and not request.polish
    steadying = _Steadying(views, request.progress, may_be_late, found.layering)
    met = found  # the last that is known to meet a target, or else the first
    is_guess = found.has_target
    if is_guess:
        found = steadying.begun(found)
        if not _has_high_price(found):
            found, is_guess = found.nearer(), False
    try:
        for _ in range(MAX_TRIES):
            again = steadying.steadied(found)
            if again is None and is_guess:
                guessed, found, is_guess = found, found.nearer(), False
                if not _is_near(found, guessed):
                    continue
            if again is None:
                again = found.made()
                if again is found or _is_near(again, found):
                    return again
                met = again
            found = again
        return found.made()
    except TargetMissedError:
        if met is found:
            raise
        return met.made()


def _has_high_price(found: FoundStream) -> bool:
    """Whether its price is higher than that of a stream without a target: levels may well fall.

    Such a stream is measured once they do not: what is done against that changes its size.
    """
    assert found.price is not None, "it is by views"
    return found.price > SCENE_PRICE / max(found.tree.n_leaves, 1)


def _is_near(one: FoundStream, other: FoundStream) -> bool:
    """Whether their coarse levels are nearly the same."""
    assert one.price is not None, "both are by views"
    assert other.price is not None, "both are by views"
    return abs(math.log(one.price / other.price)) <= SAME_PRICE


@dataclass
class _Steadying:
    """Streams made again because a state looks worse than one before it.

    Attributes:
        views: that judge.
        progress: called with how much was looked at.
        may_be_late: whether the last level may come late: not with `layers` or `polish`.
        layering: of the stream.
        last_runs: runs of steps that were joined or held back last.
        looked_at_roots: whether it is known that all roots are to come in one step, or not.
    """

    views: Views
    progress: Progress
    may_be_late: bool
    layering: Layering
    last_runs: list[Run] = field(default_factory=list)
    looked_at_roots: bool = False

    def begun(self, found: FoundStream) -> FoundStream:
        """With the layers that suit it by a first look, of a stream that has a target.

        It has three layers and a late last level if coarse splats look far worse than a PSNR that
        is aimed at, no state from the last coarse level on falls, and there is no palette: in a
        trial with a palette a state fell. Otherwise it has two, and the last level is late if it
        gains little.
        """
        found = self._with_ratio_of_use(found) or found
        if not (self.may_be_late and found.can_be_late):
            return found
        last_but_one = last = math.nan
        is_wide = self._is_surely_wide(found)
        if not is_wide:
            last_but_one, last = self._draft(found).last_two()
            is_wide = found.psnr is not None and found.psnr >= last + WIDE_DB
        if is_wide and found.tree.palette is None:
            layering = Layering(N_LAYERS + 1, is_late=True, between=PRICE_RATIO_BETWEEN)
            other = found.holding((), layering)
            if not _falls_late(other, self.views.fewer(N_JUDGING_FIRST)):
                self.layering = layering
                return other
        if math.isnan(last):
            last_but_one, last = self._draft(found).last_two()
        return self._late(found) if gains_little(last - last_but_one) else found

    def steadied(self, found: FoundStream) -> FoundStream | None:
        """With finer coarse splats, or with steps joined or held back; None if it needs neither.

        With a target coarse splats are finer first: its price of a bit may be so high that coarse
        steps make levels fall, and to hold them back takes more bytes. They are finer still while
        their last level hardly looks better than the one before it, and more so if it looks worse.
        """
        finer = self._with_ratio_of_use(found)
        if finer is not None:
            return finer
        draft = self._draft(found)
        if not self.looked_at_roots:
            self.looked_at_roots = True
            if draft.roots_fall():
                return found.holding([ROOTS], self.layering)
        gain = self._gain_of_last(found, draft)
        if gains_little(gain):
            return self._late(found)
        states = draft.states(self.progress)
        assert found.encoder is not None, "it is by views"
        at_corrections = (
            set() if self.last_runs else _places_of_corrections(found.encoder.prepared.tiles)
        )
        runs, is_coarse = _runs(states, at_corrections)
        added, ratio = _added_by_last(states), self.layering.ratio / FINER_RATIO
        if found.has_target and added <= 0 and ratio / FINER_RATIO >= MIN_RATIO:
            ratio /= FINER_RATIO
        if is_coarse and found.is_layered and ratio >= MIN_RATIO:
            return self._finer(found, ratio)
        falls = len(states) > 1 and not states[-1].keeps_up_with(states[0])
        if falls and found.is_layered and self.may_be_late:
            self.layering, self.last_runs = Layering(1), []
            return found.holding((), self.layering)
        if runs and gains_little(gain, some_fall=True):
            return self._late(found)
        if not runs or runs == self.last_runs:  # nothing can be done about these
            return None
        shows_little = self.layering.ratio == PRICE_RATIO or added < MIN_GAIN_DB
        if found.has_target and found.is_layered and shows_little and ratio >= MIN_RATIO:
            return self._finer(found, ratio)
        self.last_runs = runs
        return found.holding(runs, self.layering)

    def _draft(self, found: FoundStream) -> Draft:
        tree = found.tree
        return Draft(found.draft(), found.n_coarse, tree.shown_degree, tree.n_leaves, self.views)

    def _is_surely_wide(self, found: FoundStream) -> bool:
        """Whether coarse splats look far worse than a PSNR that is aimed at, by a slope alone."""
        if found.psnr is None or found.encoder is None or found.encoder.guess is None:
            return False
        wide = -found.encoder.guess.slope * math.log(self.layering.ratio)
        return wide >= WIDE_DB + UNSURE_DB and found.psnr - wide >= LOW_PSNR

    def _with_ratio_of_use(self, found: FoundStream) -> FoundStream | None:
        """With coarse splats so fine that they show something; None if they are."""
        ratio, price = self.layering.ratio, found.price
        assert price is not None, "it is by views"
        most = MAX_COARSE_PRICE / max(found.tree.n_leaves, 1) / price
        while found.is_layered and ratio > most and ratio / FINER_RATIO >= MIN_RATIO:
            ratio /= FINER_RATIO
        if ratio == self.layering.ratio:
            return None
        return self._finer(found, ratio)

    def _finer(self, found: FoundStream, ratio: float) -> FoundStream:
        """With coarse splats at so many times the price of a bit."""
        self.layering = replace(self.layering, ratio=ratio)
        return found.holding((), self.layering)

    def _gain_of_last(self, found: FoundStream, draft: Draft) -> float:
        """By how many dB the last level looks better; infinite if it may not come late, or does."""
        may = self.may_be_late and found.can_be_late
        if not may or found.n_coarse < 2 or self.layering.is_late:
            return math.inf
        last_but_one, last = draft.last_two()
        return last - last_but_one

    def _late(self, found: FoundStream) -> FoundStream:
        self.layering, self.last_runs = replace(self.layering, is_late=True), []
        return found.holding((), self.layering)


def _falls_late(found: FoundStream, views: Views) -> bool:
    """Whether a state of the last coarse level, or after it, looks worse than an earlier of these.

    Where one or two of the views see that it looks better, the others do not judge.
    """
    draft = found.draft(is_whole=True)
    levels = range(found.n_coarse - 1, draft.n_levels)
    first = list(draft.steps_of(levels.start))
    cuts = first + [cut for level in levels[1:] for cut in draft.steps_of(level, rooms=False)]
    one, other = _two_of(views)
    best = None
    for leaves in draft.shown(cuts, found.tree.shown_degree):
        state = _Seen(leaves)
        if best is None:
            best = state
            continue
        by = state.gain_over(best, one)
        if by < BETTER_IN_ONE_DB:
            by = (by + state.gain_over(best, other)) / 2
            if by < BETTER_IN_TWO_DB:
                by = state.gain_over(best, views)
        if by < -FALL_DB:
            return True
        if by > 0:
            best = state
    return False


@dataclass(eq=False)
class _Seen:
    """What a state shows, and its PSNR in those views that have judged it."""

    leaves: SplatParams
    known: dict[tuple[Camera, ...], float] = field(default_factory=dict)

    def gain_over(self, other: _Seen, views: Views) -> float:
        """By how many dB views find it better than another one."""
        return self._psnr(views) - other._psnr(views)

    def _psnr(self, views: Views) -> float:
        key = tuple(views.cameras)
        if key not in self.known:
            self.known[key] = views.psnr(self.leaves)
        return self.known[key]


def _two_of(views: Views) -> tuple[Views, Views]:
    """The first of the views, and another one: of another size if there is one."""
    one, *others = views.cameras
    larger = [camera for camera in others if camera.width != one.width]
    other = (larger or others or [one])[0]
    return replace(views, cameras=[one]), replace(views, cameras=[other])


def _places_of_corrections(tiles: Sequence[EvolutionTree]) -> set[tuple[int, int]]:
    """Levels and steps of them that are corrections in some tile."""
    found: set[tuple[int, int]] = set()
    for tile in tiles:
        pairs = zip(places(tile), corrections(tile), strict=True)
        found.update(place for place, is_correction in pairs if is_correction)
    return found


def _runs(states: Sequence[State], at_corrections: set[tuple[int, int]]) -> tuple[list[Run], bool]:
    """Which steps are to be joined or held back, and whether coarse splats are too coarse for it.

    After one of the steps `at_corrections` is, each later one of them is too that looks worse by
    more than `SAME_DB`: their falls would add up.
    """
    if len(states) < 2:
        return [], False
    last = states[-1]
    good, best, is_one_held = [0], states[0], False
    for k, state in enumerate(states[1:-1], start=1):
        if state.place in at_corrections and (
            state.mean < best.mean - SAME_DB if is_one_held else state.seems_to_fall_after(best)
        ):
            is_one_held = True
            continue
        if state.keeps_up_with(best) and last.keeps_up_with(state):
            good.append(k)
            best = max(best, state, key=lambda state: state.mean)
    good.append(len(states) - 1)
    most = max(state.mean for state in states)
    return _between(states, good), last.mean < max(states[0].mean + MIN_GAIN_DB, most - MIN_GAIN_DB)


def _added_by_last(states: Sequence[State]) -> float:
    """By how many dB the last level looks better than the one before it; infinite if it is alone.

    As a few views find it.
    """
    last = states[-1]
    coarser = [state for state in states if state.place[0] < last.place[0]]
    return last.mean - coarser[-1].mean if coarser else math.inf


def _between(states: Sequence[State], good: Sequence[int]) -> list[Run]:
    """The steps between good states, where they do not look the same."""
    return [
        Run(states[before + 1].place, states[after].place)
        for before, after in pairwise(good)
        if not all(state.is_like(states[before]) for state in states[before + 1 : after])
    ]
