"""What an estimate of errors misses, measured: numbers are rounded, class by class, and drawn.

An estimate is linear. Splats that change places in depth change pictures by more, however little
they move, and numbers that are rounded to 0 in most splats err all together.

Letters: C channels of SH, D channels, K classes (spec 3.2), N leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from evogs_codec.encoding.measured_gains import Pictures, psnr_of_sh
from evogs_codec.model.channels import N_GROUPS, channel_class
from evogs_codec.model.splats import F32, F64, SplatParams

__all__ = ["MEASURING", "Missed"]

MEASURING = 3  # views, enough for that
APART = math.log(64.0)  # between logarithms of the prices of a bit that are measured
# Of more leaves, drawing takes long: SH of a palette are not measured, and of geometry positions
# alone. The factors of the others are what they were of three scenes, about.
MANY = 100_000
GEOMETRY = (1.0, 0.6, 0.65, 0.85)
LEAST, MOST = 0.5, 30.0  # views do not show all that an error changes
LEAST_ERROR = 1e-15  # mean squared error; of less, there is nothing to be measured
_SH = N_GROUPS - 1  # its first class


@dataclass(frozen=True, eq=False)
class Missed:
    """How many times the estimates of an importance real errors are, by the price of a bit.

    Attributes:
        leaves: N leaves of a tree.
        weights: (K, N) of their numbers, by an estimate.
        steps: (K,) at a price of a bit, to which numbers are rounded.
        pictures: of the leaves.
        has_palette: SH above band 0 are in one.
        known: (K,) logarithms of the factors, by the place of a price, so far.
    """

    leaves: SplatParams
    weights: F32
    steps: Callable[[float], F64]
    pictures: Pictures
    has_palette: bool
    known: dict[int, F64] = field(default_factory=dict, repr=False)

    def at(self, price: float) -> F32:
        """(K,) factors at a price of a bit, between those that are measured."""
        place = math.log(price) / APART
        low = math.floor(place)
        part = place - low
        found: F64 = (1 - part) * self._at(low) + part * self._at(low + 1)
        return np.exp(found).astype(np.float32)

    def _at(self, place: int) -> F64:
        if place not in self.known:
            factors = self._measured(self.steps(math.exp(APART * place)))
            self.known[place] = np.log(np.clip(factors, LEAST, MOST))
        return self.known[place]

    def _measured(self, steps: F64) -> F64:
        """(K,) factors, of numbers that are rounded to these steps."""
        found = np.ones(len(self.weights))
        found[:_SH] = GEOMETRY
        is_large = len(self.leaves) > MANY
        for kind in range(1 if is_large else _SH):
            found[kind] = self._of_geometry(kind, steps)
        if not (is_large and self.has_palette):
            found[_SH:] = self._of_sh(steps)
        return found

    def _of_geometry(self, kind: int, steps: F64) -> float:
        """Where errors are more than an estimate, they rise less than the squares of steps do."""
        channels = self.leaves.channels()
        estimate = self._round(channels, kind, steps)
        factor = _times(self.pictures.psnr(SplatParams.from_channels(channels)), estimate)
        return min(factor, (1 + factor) / 2)

    def _of_sh(self, steps: F64) -> list[float]:
        estimates, each = [], []
        for kind in range(_SH, len(self.weights)):
            channels = self.leaves.channels()
            estimates.append(self._round(channels, kind, steps))
            each.append(SplatParams.from_channels(channels).sh)
        found = psnr_of_sh(self.pictures, self.leaves, each)
        return [_times(psnr, one) for psnr, one in zip(found, estimates, strict=True)]

    def _round(self, channels: F32, kind: int, steps: F64) -> float:
        """Round a class of channels (D, N), in place; the error by the estimate."""
        own = [c for c in range(len(channels)) if channel_class(c) == kind]
        before = channels[own]
        channels[own] = np.rint(before / steps[kind]) * steps[kind]
        off = np.square(channels[own] - before).sum(axis=0)
        return float(self.weights[kind] @ off)


def _times(psnr: float, estimate: float) -> float:
    """How many times an estimate the error of a PSNR is."""
    error = float(10 ** (-psnr / 10))
    return error / estimate if min(error, estimate) > LEAST_ERROR else 1.0
