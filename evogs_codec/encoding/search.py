"""Where a value that falls is nearest to what is wanted: secants, kept in brackets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

__all__ = ["MAX_TRIES", "MIN_BRACKET", "TRIES_ON_ONE_SIDE", "Found", "Goal", "Start", "nearest"]

MAX_TRIES = 14
MIN_BRACKET = 1e-6  # of the logarithm of a place
PROBE_SPREAD, GOLDEN = 0.2, 0.618  # of the logarithm: around a jump, where a value is any near it
# After so many tries, all on one side of a target and hardly nearer than the first, the end of the
# range is tried.
TRIES_ON_ONE_SIDE = 3
HARDLY_NEARER, STILL_FAR = 0.5, 0.2  # of the distance of the first try, and of a far one
T = TypeVar("T")


@dataclass(frozen=True)
class Found(Generic[T]):
    """The best of a search: where, its value, and what has it.

    `is_end`: an end of what was searched, beyond which the target lies. `above`: of the values that
    are no less than the target the nearest, if the search came across one.
    """

    at: float
    value: float
    what: T
    is_end: bool = False
    above: Found[T] | None = None


@dataclass(frozen=True)
class Start:
    """Where a search begins.

    Attributes:
        at: the first place.
        slope: first guess of the change of the value over that of the logarithm of the place.
        known: a place and its value, about, if one was measured before.
    """

    at: float
    slope: float
    known: tuple[float, float] | None = None


@dataclass(frozen=True)
class Goal:
    """What a search is for.

    Attributes:
        value: that is wanted.
        slack: a value this near is good enough.
        most: a value above it is the best only where none is below.
    """

    value: float
    slack: float
    most: float = math.inf

    def badness(self, value: float) -> tuple[bool, float]:
        """Of two values the one of which this is less is better."""
        return value > self.most, abs(value - self.value)

    def is_met(self, value: float) -> bool:
        """Whether the search may end with a value."""
        return abs(value - self.value) <= self.slack


def nearest(
    measure: Callable[[float], tuple[float, T]],
    goal: Goal,
    start: Start,
    bounds: tuple[float, float],
    probes: int = 0,
    far: float = math.inf,
    narrow: float = MIN_BRACKET,
) -> Found[T]:
    """Where a value that falls is nearest to a goal: secants in the logarithm, kept in brackets.

    Args:
        measure: value at a place, and what has it.
        goal: what is wanted.
        start: where the search begins.
        bounds: no place is outside.
        probes: places around a jump over the target that are tried, at most.
        far: a first value that is further off has the end of the range tried. So have first tries
            that are all on one side, hardly come nearer and stay a fifth of that off, or of which a
            line meets the target beyond the end. If the end does not reach the target, nothing
            does.
        narrow: of the logarithm; between places this near the value jumps over the target.
    """
    target = goal.value
    low, high = (math.log(bound) for bound in bounds)
    at, slope = math.log(start.at), start.slope
    best: Found[T] | None = None
    above: Found[T] | None = None
    before = None if start.known is None else (math.log(start.known[0]), start.known[1])
    middle: float | None = None  # of a jump
    last_try = MAX_TRIES - 1
    is_above: set[bool] = set()
    tried: set[float] = set()  # ends of the range
    distances: list[float] = []
    for k in range(MAX_TRIES + probes):
        value, what = measure(math.exp(at))
        if best is None or goal.badness(value) < goal.badness(best.value):
            best = Found(math.exp(at), value, what)
        if value >= target and (above is None or value < above.value):
            above = Found(math.exp(at), value, what)
        if goal.is_met(value):
            break
        is_above.add(value > target)
        end = bounds[0] if value < target else bounds[1]
        if len(is_above) == 1 and math.isclose(math.exp(at), end):
            return Found(end, value, what, is_end=True)
        distances.append(abs(value - target))
        if before is not None and before[0] != at and (before[1] - value) * (before[0] - at) < 0:
            slope = (before[1] - value) / (before[0] - at)
        before = at, value
        there = at + (target - value) / slope
        hardly = max(HARDLY_NEARER * distances[0], STILL_FAR * far)
        is_slow = k + 1 == TRIES_ON_ONE_SIDE and distances[-1] > hardly
        is_beyond = k > 0 and not math.log(bounds[0]) < there < math.log(bounds[1])
        may_be_out = is_slow or is_beyond or (not k and distances[0] > far)
        if may_be_out and len(is_above) == 1 and end not in tried:
            tried.add(end)
            last, at_end = measure(end)
            if goal.is_met(last) and last <= goal.most:
                return Found(end, last, at_end)
            if (last > target) == (value > target):
                return Found(end, last, at_end, is_end=True)
        if value > target:
            low = at
        else:
            high = at
        at = there
        if not low < at < high:
            at = (low + high) / 2
        if middle is None and high - low < narrow:
            middle, last_try = (low + high) / 2, k + probes
        if k >= last_try:
            break
        if middle is not None:
            at = middle + PROBE_SPREAD * (k * GOLDEN % 1 - 0.5)
            at = min(max(at, math.log(bounds[0])), math.log(bounds[1]))
    assert best is not None
    return replace(best, above=above)
