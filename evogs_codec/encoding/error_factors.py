"""How many times their estimates real errors are, measured: numbers are rounded and drawn.

An estimate is linear. Splats that change places in depth change pictures by more, however little
they move, and SH that are rounded to 0 in most splats err all together.

Letters: D channels, K classes (spec 3.2), N leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from evogs_codec.encoding.measured_gains import psnr_of_sh
from evogs_codec.encoding.pictures import Pictures
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.model.splats import F32, F64, SplatParams

__all__ = ["N_MEASURING_VIEWS", "USUAL_FACTORS", "ErrorFactors"]

N_MEASURING_VIEWS = 2  # views, enough for that
LOG_PRICE_SPACING = math.log(192.0)  # between logarithms of the prices of a bit that are measured
# Of positions and of SH bands above 0 the factors are measured. Those of rotations, scales and
# opacities are what they were of three scenes, about: `sensitivity.BEYOND_LINEAR`, which all of
# these multiply, is too high for them. Where nothing is measured, the factor of positions is 1.
USUAL_FACTORS = (1.0, 0.6, 0.65, 0.85)
MIN_FACTOR, MAX_FACTOR = 0.5, 300.0
MIN_ERROR = 1e-15  # mean squared error; of less, there is nothing to be measured


@dataclass(frozen=True, eq=False)
class ErrorFactors:
    """How many times the estimates of an importance real errors are, by the price of a bit.

    Attributes:
        leaves: N leaves of a tree.
        weights: (K, N) of their numbers, by an estimate.
        steps: (K,) at a price of a bit, to which numbers are rounded.
        pictures: of the leaves.
        has_palette: SH above band 0 are in one, and not measured.
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
        place = math.log(price) / LOG_PRICE_SPACING
        low = math.floor(place)
        part = place - low
        found: F64 = (1 - part) * self._at(low) + part * self._at(low + 1)
        return np.exp(found).astype(np.float32)

    def _at(self, place: int) -> F64:
        if place not in self.known:
            factors = self._measured(self.steps(math.exp(LOG_PRICE_SPACING * place)))
            self.known[place] = np.log(np.clip(factors, MIN_FACTOR, MAX_FACTOR))
        return self.known[place]

    def _measured(self, steps: F64) -> F64:
        """(K,) factors, of numbers that are rounded to these steps."""
        found = np.ones(len(self.weights))
        found[: len(USUAL_FACTORS)] = USUAL_FACTORS
        means, estimate = _rounded(self.leaves.means, steps[0], self.weights[0])
        factor = _times(self.pictures.psnr(replace(self.leaves, means=means)), estimate)
        # What splats that change places add rises less than the squares of steps do. Views do not
        # show all that moves, so no position weighs less.
        found[0] = max(1.0, (1 + factor) / 2)
        if len(found) > N_GROUPS and not self.has_palette:
            sh, estimate = self.leaves.sh.copy(), 0.0
            for band, kind in enumerate(range(N_GROUPS, len(found)), start=1):
                part = slice(band**2, (band + 1) ** 2)
                sh[:, part], of_band = _rounded(sh[:, part], steps[kind], self.weights[kind])
                estimate += of_band
            (psnr,) = psnr_of_sh(self.pictures, self.leaves, [sh])
            found[N_GROUPS:] = _times(psnr, estimate)
        return found


def _rounded(values: F32, step: float, weights: F32) -> tuple[F32, float]:
    """Numbers (N, ...) of N leaves, rounded, and the error by the weights (N,) of an estimate."""
    found: F32 = (np.rint(values / step) * step).astype(np.float32)
    squares = np.square(found - values).reshape(len(values), -1).sum(axis=1)
    return found, float(weights @ squares)


def _times(psnr: float, estimate: float) -> float:
    """How many times an estimate the error of a PSNR is."""
    error = float(10 ** (-psnr / 10))
    return error / estimate if min(error, estimate) > MIN_ERROR else 1.0
