"""No step back: makes streams whose prefixes do not look worse than shorter prefixes.

The state after each step of the levels is rendered. If a state looks worse than one before it, its
step is held back until it looks better (`held_steps`). If all coarse splats together look worse
than some of them, all are made more exact. If the last level, at coarse steps, looks hardly better
than the level before it, it comes late (`late_level`). It comes late too if all coarse splats look
far worse than the whole stream: then there are three layers, and it comes with the second.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.common.progress import Progress
from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.progressive import Decoder
from evogs_codec.editing.level_psnr import LevelPsnr, with_level_psnr
from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.layers import BETWEEN, N_LAYERS, Layering
from evogs_codec.format.directory import Directory, read_directory
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.scene.choose import FoundStream
from evogs_codec.scene.measure import MANY, Gauge
from evogs_codec.scene.request import Request

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["steady"]

SAME = 0.03  # dB; two states look the same if no view differs by more
# A state is a fall if its lead over one before it, in the mean over views and less DOUBT standard
# errors of JUDGES views, is below -FALL dB.
FALL, DOUBT, JUDGES = 0.05, 1.0, 6
FEW = 4  # views that judge a large scene at first
UNSURE = 0.8  # standard deviations that the mean of a few views is from that of all, at most
FELL = 0.02  # dB; if a state looks worse than one before it by more, on a few views, more judge
# dB; all coarse splats look better than level 0 by this at least, and worse than the best state by
# this at most. Otherwise they are made more exact.
GAIN = 0.5
LATE = 1.5  # dB; if the last coarse level looks better than the one before by less, it comes late
WIDE = 16.0  # dB; if the whole looks better than all coarse splats by more, a layer comes between
FINER, LEAST_RATIO = 4.0, 2.0  # of the price of a bit, from a layer to the next
TRIES = 6  # streams that are made again, at most


@dataclass(frozen=True, eq=False)
class _State:
    """What is there after a step.

    Attributes:
        place: its level, and which of the steps of the level it is.
        few: (f,) PSNR of a few views of it, dB.
        draw: gives (n,) that of all views.
    """

    place: tuple[int, int]
    few: F64
    draw: Callable[[], F64]

    @cached_property
    def decibels(self) -> F64:
        """(n,) PSNR of each view, dB; they are drawn where a few leave something in doubt."""
        return self.draw()

    @property
    def mean(self) -> float:
        """Of a few views, dB."""
        return float(self.few.mean())

    def is_like(self, other: _State) -> bool:
        """Whether it looks the same."""
        return _is_like(self.few - other.few) and _is_like(self.decibels - other.decibels)

    def keeps_up_with(self, other: _State) -> bool:
        """Whether it is no fall after another one, also on `JUDGES` other views."""
        by = self.few - other.few
        if _is_like(by) or abs(_lead(by)) <= UNSURE * by.std():
            by = self.decibels - other.decibels
        return _is_like(by) or _lead(by) >= 0


def _is_like(by: F64) -> bool:
    """Whether a state looks the same as one that it is better than by so many dB, view by view."""
    return bool(np.abs(by).max() <= SAME)


def _lead(by: F64) -> float:
    """How far a state that is better by this, view by view, is from a fall, dB; below 0 it is."""
    return float(by.mean() + FALL - DOUBT * by.std() / math.sqrt(JUDGES))


def steady(found: FoundStream, request: Request) -> FoundStream:
    """The stream without falls, as far as it was made by views; it says the PSNR of its levels.

    It is finished, and no draft.
    """
    gauge = Gauge.of(found.tree, request)
    if gauge is None:
        return replace(found, data=found.finished(), coded=None)
    mending = _Mending(gauge.many, request.progress, request.layers is None and not request.polish)
    aims_at_psnr = found.coded is None and request.target_bytes is None
    if aims_at_psnr:  # a third layer takes bytes
        found = mending.with_three_layers(found) or found
    levels = None
    for _ in range(TRIES):
        levels = _looked_at(found, gauge, request)
        again = mending.mended(found) if levels is None else mending.later(found, levels)
        if again is None:
            break
        found = again
    if levels is None:
        levels = _looked_at(found, gauge, request, worst=math.inf)
    assert levels is not None, "nothing falls so far"
    data = with_level_psnr(found.finished(), LevelPsnr(tuple(levels), gauge.said))
    return replace(found, data=data, coded=None)


def _looked_at(
    found: FoundStream, gauge: Gauge, request: Request, worst: float | None = None
) -> list[float] | None:
    """PSNR of each level; None as soon as a state of the levels of the tree falls by `worst` dB."""
    directory = read_directory(found.data)
    n_judged = found.n_coarse if found.is_by_views else 0
    most = FELL if worst is None else worst
    levels, before = [], -math.inf
    cuts = [
        (level, cut is whole, cut)
        for level in range(directory.n_levels)
        for *parts, whole in [_cuts(directory, level)]
        # Of level 0 what is added helps.
        for cut in ((*parts, whole) if 0 < level < n_judged else (whole,))
    ]
    states = _shown(found, directory, [cut for _, _, cut in cuts])
    for (level, is_whole, _), leaves in zip(cuts, states, strict=True):
        request.progress("measure", level / directory.n_levels)
        if level >= n_judged:
            levels.append(gauge.views.psnr(leaves))
            continue
        if is_whole:
            of_all, shown = gauge.both(leaves)
            levels.append(of_all)
        else:
            shown = gauge.few.psnr(leaves)
        if shown < before - most:
            return None
        before = shown
    request.progress("measure", 1.0)
    return levels


@dataclass
class _Mending:
    """Streams made again because a state looks worse than one before it.

    Attributes:
        views: that judge.
        progress: called with how much was looked at.
        may_be_late: whether the last level may come late: not with `layers` or `polish`.
        layering: of the stream.
        before: runs of steps that are held back.
    """

    views: Views
    progress: Progress
    may_be_late: bool
    layering: Layering = field(default_factory=lambda: Layering(N_LAYERS))
    before: list[Run] = field(default_factory=list)

    def with_three_layers(self, found: FoundStream) -> FoundStream | None:
        """With its last level late, of a stream that aims at a PSNR.

        None if coarse splats look well enough beside the whole, or if a state of the last two
        layers falls. With a palette one did, so it is not tried.
        """
        if not (self.may_be_late and found.can_be_late) or found.tree.palette is not None:
            return None
        directory, views = read_directory(found.data), self.views.fewer(FEW)
        cuts = [Cut.of_level(directory, found.n_coarse - 1), Cut.full(directory)]
        coarse, whole = map(views.psnr, _shown(found, directory, cuts))
        if whole < coarse + WIDE:
            return None
        layering = Layering(N_LAYERS + 1, is_late=True, between=BETWEEN)
        other = found.holding((), layering)
        if other is None or _falls_late(other, views):
            return None
        self.layering = layering
        return other

    def later(self, found: FoundStream, levels: Sequence[float]) -> FoundStream | None:
        """With its last level late; None if that looks enough better than the one before it.

        Args:
            found: a stream.
            levels: PSNR of its coarse levels, at least, dB.
        """
        last = found.n_coarse - 1
        if self.layering.is_late or last < 1 or levels[last] >= levels[last - 1] + LATE:
            return None
        if not (self.may_be_late and found.can_be_late):
            return None
        self.layering = replace(self.layering, is_late=True)
        return found.holding((), self.layering)

    def mended(self, found: FoundStream) -> FoundStream | None:
        """With finer coarse splats, or with steps held back; None if there is nothing to mend."""
        states = _states(found, self.views, self.progress)
        ends = {state.place[0]: state.mean for state in states}
        late = self.later(found, list(ends.values()))
        if late is not None:
            return late
        runs, is_coarse = _runs(states)
        finer = self.layering.ratio / FINER
        if is_coarse and found.is_layered and finer >= LEAST_RATIO:
            self.layering = replace(self.layering, ratio=finer)
            return found.holding((), self.layering)
        if runs and runs != self.before:  # else they could not be held back
            self.before = runs
            return found.holding(runs, self.layering)
        return None


def _falls_late(found: FoundStream, views: Views) -> bool:
    """Whether a state after the coarse levels looks worse than one before it."""
    directory = read_directory(found.data)
    levels = range(found.n_coarse - 1, directory.n_levels)
    first = list(_cuts(directory, levels.start))
    cuts = first + [cut for level in levels[1:] for cut in _cuts(directory, level, rooms=False)]
    shown = np.array([views.psnr(leaves) for leaves in _shown(found, directory, cuts)])
    return bool(np.any(shown < np.maximum.accumulate(shown) - FALL))


def _states(found: FoundStream, views: Views, progress: Progress) -> list[_State]:
    """Those after each step of the levels of the tree."""
    directory = read_directory(found.data)
    cuts = [
        ((level, number), cut)
        for level in range(found.n_coarse)
        for number, cut in enumerate(_cuts(directory, level))
    ]
    is_large, states = found.tree.n_leaves > MANY, []
    few = views.fewer(FEW) if is_large else views

    def drawn(cut: Cut) -> F64:
        return views.psnr_of_each(next(_shown(found, directory, [cut])))

    shown = _shown(found, directory, [cut for _, cut in cuts])
    for (place, cut), leaves in zip(cuts, shown, strict=True):
        shown_by = few.psnr_of_each(leaves)
        draw = partial(drawn, cut) if is_large else shown_by.copy
        states.append(_State(place, shown_by, draw))
        progress("look at prefixes", len(states) / len(cuts))
    return states


def _shown(found: FoundStream, directory: Directory, cuts: Sequence[Cut]) -> Iterator[SplatParams]:
    """The leaves of cuts of which each contains the one before; no packet is decoded twice."""
    decoder, data = Decoder(), memoryview(found.data)
    decoder.feed(data[: directory.data_offset])
    done = np.zeros(len(directory.packets), bool)
    sizes = directory.packets["size"].astype(np.int64)
    for cut in cuts:
        selected = cut.packets(directory)
        for packet in np.flatnonzero(selected & ~done).tolist():
            at = int(directory.offsets[packet])
            decoder.feed(data[at : at + int(sizes[packet])], at)
        done |= selected
        yield decoder.leaves(sh_degree=found.tree.shown_degree)


def _cuts(directory: Directory, level: int, *, rooms: bool = True) -> Iterator[Cut]:
    """After each of the steps of a level, of all tiles that have so many.

    Without `rooms` only after those that refine in some tile: others of late levels show nothing.
    """
    whole = Cut.of_level(directory, level)
    core = directory.columns == 0
    before = np.bincount(
        directory.packets["tile"][core & (directory.labels < level)], minlength=len(whole.steps)
    )
    own = np.flatnonzero(core & (directory.labels == level))
    numbers = directory.steps[own] - before[directory.packets["tile"][own]] + 1
    shows = rooms | (directory.packets["n_refines"][own] > 0)
    for number in np.unique(numbers[shows & (numbers < numbers.max(initial=0))]).tolist():
        n_steps = np.minimum(before + number, whole.steps[:, 0])
        yield Cut(np.minimum(whole.steps, n_steps[:, None]), whole.palette)
    yield whole


def _runs(states: Sequence[_State]) -> tuple[list[Run], bool]:
    """Which steps are to be held back, and whether coarse splats are too coarse for that to do."""
    if len(states) < 2:
        return [], False
    last = states[-1]
    shown, best = [0], states[0]
    for k, state in enumerate(states[1:-1], start=1):
        if state.keeps_up_with(best) and last.keeps_up_with(state):
            shown.append(k)
            best = max(best, state, key=lambda state: state.mean)
    shown.append(len(states) - 1)
    runs = [
        Run(states[before + 1].place, states[after].place)
        for before, after in pairwise(shown)
        if not all(state.is_like(states[before]) for state in states[before + 1 : after])
    ]
    most = max(state.mean for state in states)
    return runs, last.mean < max(states[0].mean + GAIN, most - GAIN)
