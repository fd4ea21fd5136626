"""Where a search for a target may begin, and when it may end.

What is searched for is one number, the price of a bit: all steps and roundings follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.encoding.search import Found, Goal, Start
from evogs_codec.encoding.sketch import Sketch
from evogs_codec.model.coded_tree import CodedTree

__all__ = [
    "BYTES_SLOPE",
    "LOW_PSNR",
    "PRICES",
    "PSNR_SLOPE",
    "USUAL_PSNR",
    "Guess",
    "goal_of_bytes",
    "goal_of_psnr",
    "price_near",
    "psnr_slope",
]

PRICES = (1e-18, 1e-5)  # mean squared error that a bit is worth
PSNR_SLACK, BYTES_SLACK = 0.2, 0.01  # dB from a target, at most, and part of the bytes asked for
# Up to the first PSNR a stream may miss by that; from the second on by so many times that. Between
# them the factor rises evenly: the PSNR jumps from price to price.
SMOOTH_PSNR, ROUGH_PSNR, ROUGH_FACTOR = 60.0, 70.0, 2.5
SAME_JUMP = 0.1  # dB; streams that differ a little jump to values this near
BYTES_SLOPE = -0.25  # of the logarithm of the bytes over that of the price, about
PSNR_SLOPE = -10 / math.log(10)  # dB, likewise: 3 dB for a price twice as high
# dB, likewise, of streams of up to the first PSNR; at the usual price streams have the second, and
# the slope above. Between them it changes evenly.
LOW_SLOPE, LOW_PSNR, USUAL_PSNR = -2.0, 33.0, 45.0
# Of a sketch: another guess follows if the price moved further, in the logarithm.
SETTLED = (0.3, 1.0, math.inf)
NEAR_END = 1.0  # of the logarithm of a price; a guess may be that far off


@dataclass(frozen=True)
class Guess(Start):
    """Where a search may begin: at a price of a bit, at which a target is nearly met.

    Attributes, others than those of `Start`:
        met: what is coded there, if it meets the target.
        jump: dB that a PSNR found near there may be off, since one was: there it jumps.
    """

    met: Found[CodedTree] | None = None
    jump: float = 0.0

    @staticmethod
    def of_psnr(sketch: Sketch, decibels: float, near: float) -> Guess:
        """Where a search for a PSNR may begin, by a sketch.

        Args:
            sketch: of the tree.
            decibels: the target.
            near: a price of a bit to begin with.
        """
        return _guess(sketch.psnr, decibels, Guess(near, psnr_slope(decibels)))

    @staticmethod
    def of_bytes(sketch: Sketch, n_bytes: int, near: float) -> Guess:
        """Where a search for a number of bytes may begin, likewise."""
        goal = goal_of_bytes(n_bytes)
        return _guess(sketch.log_bytes, goal.value, Guess(near, BYTES_SLOPE))

    @property
    def price(self) -> float:
        """Of a bit."""
        return self.at

    @property
    def is_at_end(self) -> bool:
        """Whether it is about an end of the range of prices: the target may be beyond."""
        return any(abs(math.log(self.price / end)) <= NEAR_END for end in PRICES)

    def at_target(self, target: float, value: float) -> Guess:
        """Where the target is, if the value is what it is here."""
        low, high = map(math.log, PRICES)
        at = math.log(self.price) + (target - value) / self.slope
        return replace(self, at=math.exp(min(max(at, low), high)))

    def measured(self, target: float, value: float) -> Guess:
        """`at_target` of a value that was measured."""
        return replace(self.at_target(target, value), known=(self.price, value))

    def jumping(self, found: Found[bytes], decibels: float) -> Guess:
        """The same, if a stream that was found is further off a PSNR than it may be elsewhere."""
        off = abs(found.value - decibels)
        return self if off <= goal_of_psnr(decibels).slack else replace(self, jump=off + SAME_JUMP)

    @property
    def unmeasured(self) -> Guess:
        """The same of a stream that differs: what was measured is not of that."""
        return replace(self, known=None, met=None)


def goal_of_psnr(decibels: float) -> Goal:
    """Of a search for a PSNR."""
    times = np.interp(decibels, (SMOOTH_PSNR, ROUGH_PSNR), (1.0, ROUGH_FACTOR))
    return Goal(decibels, PSNR_SLACK * float(times))


def goal_of_bytes(n_bytes: int) -> Goal:
    """Of a search for the logarithm of the bytes."""
    most = math.log(n_bytes)
    return Goal(most - BYTES_SLACK, BYTES_SLACK, most)


def psnr_slope(decibels: float) -> float:
    """Of streams of about this PSNR: dB over the logarithm of the price of a bit."""
    return float(np.interp(decibels, (LOW_PSNR, USUAL_PSNR), (LOW_SLOPE, PSNR_SLOPE)))


def price_near(decibels: float, usual: float) -> float:
    """A price of a bit at which streams have about this PSNR, if they have `USUAL_PSNR` at another.

    Args:
        decibels: PSNR.
        usual: price of a bit.
    """
    low, high = PRICES
    return min(max(usual * 10 ** ((USUAL_PSNR - decibels) / 10), low), high)


def _guess(rough: Callable[[float], float], target: float, guess: Guess) -> Guess:
    """By a sketch's rough values at some prices, the first of which is that of a guess."""
    slope, before = guess.slope, None
    for near in SETTLED:
        at, value = math.log(guess.price), rough(guess.price)
        if before is not None and (before[1] - value) * (before[0] - at) < 0:
            slope = (before[1] - value) / (before[0] - at)
        before = at, value
        guess = replace(guess, slope=slope).at_target(target, value)
        if abs(math.log(guess.price) - at) <= near:
            break
    return guess
