"""Boxes of what splats cover.

Letters: N splats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from evogs_codec.model.splats import F64, SplatParams

__all__ = ["Box", "covered", "size_of"]

Point: TypeAlias = "tuple[float, float, float]"

MIN_OPACITY = 1 / 255  # below, a renderer draws nothing
SIGMAS = math.sqrt(2 * math.log(255))  # 3.33: beyond, an opaque splat is below the least opacity
MAX_LOG_SCALE = 80.0  # of a log-scale that is taken as it is
SIZE_PERCENTILE = 90  # percentile: the size of the splats that a level merges
BLOCK = 1 << 16  # splats at a time
ROUNDING = 2.0**-12  # of its width is a box larger, so that its numbers are short


@dataclass(frozen=True)
class Box:
    """From `low` to `high`, along the axes."""

    low: Point
    high: Point

    @staticmethod
    def around(boxes: list[Box]) -> Box:
        """The smallest that holds all of these."""
        lows, highs = np.array([b.low for b in boxes]), np.array([b.high for b in boxes])
        return Box.of(lows.min(axis=0), highs.max(axis=0))

    @staticmethod
    def of(low: F64, high: F64) -> Box:
        """From corners (3,)."""
        (a, b, c), (d, e, f) = low.tolist(), high.tolist()
        return Box((a, b, c), (d, e, f))

    def moved(self, way: F64) -> Box:
        """Elsewhere."""
        return Box.of(np.array(self.low) + way, np.array(self.high) + way)

    def rounded(self) -> Box:
        """A little larger, with numbers of few digits, none of its sides 0."""
        low, high = np.array(self.low), np.array(self.high)
        step = 2.0 ** math.floor(math.log2(max(self.diagonal, 1e-30) * ROUNDING))
        return Box.of((np.floor(low / step) - 1) * step, (np.ceil(high / step) + 1) * step)

    def holds(self, other: Box) -> bool:
        """Whether no point of the other one is outside."""
        return all(a <= b for a, b in zip(self.low, other.low, strict=True)) and all(
            a >= b for a, b in zip(self.high, other.high, strict=True)
        )

    def meets(self, other: Box) -> bool:
        """Whether they share a point."""
        return all(a <= b for a, b in zip(self.low, other.high, strict=True)) and all(
            a >= b for a, b in zip(self.high, other.low, strict=True)
        )

    @property
    def diagonal(self) -> float:
        """Its length."""
        return math.dist(self.low, self.high)


def covered(splats: SplatParams) -> Box:
    """What at least one splat is drawn on: 3.33 standard deviations of those that are drawn at all.

    Of no such splat the positions count, and of none the origin.
    """
    shown = splats.take(_is_shown(splats))
    if not len(shown):
        means = splats.means if len(splats) else np.zeros((1, 3))
        return Box.of(means.min(axis=0).astype(np.float64), means.max(axis=0).astype(np.float64))
    boxes = []
    for at in range(0, len(shown), BLOCK):
        some = shown.take(slice(at, at + BLOCK))
        means, half = some.means.astype(np.float64), SIGMAS * _deviations(some)
        boxes.append(Box.of((means - half).min(axis=0), (means + half).max(axis=0)))
    return Box.around(boxes)


def size_of(splats: SplatParams) -> float:
    """The largest standard deviation that 90 of 100 drawn splats do not exceed, scene units."""
    shown = splats.take(_is_shown(splats))
    if not len(shown):
        return 0.0
    largest = np.minimum(shown.log_scales.max(axis=1), MAX_LOG_SCALE)
    return float(np.exp(np.percentile(largest.astype(np.float64), SIZE_PERCENTILE)))


def _is_shown(splats: SplatParams) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    least = math.log(MIN_OPACITY / (1 - MIN_OPACITY))
    found: np.ndarray[tuple[int], np.dtype[np.bool_]] = splats.opacity_logits >= least
    return found


def _deviations(splats: SplatParams) -> F64:
    """(N, 3) standard deviations along the axes of the scene."""
    q = splats.quats.astype(np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 0, q / np.where(length > 0, length, 1), (1.0, 0.0, 0.0, 0.0))
    w, x, y, z = q.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    s = np.exp(np.minimum(splats.log_scales.astype(np.float64), MAX_LOG_SCALE)).T
    out = [np.sqrt(sum(np.square(a * b) for a, b in zip(row, s, strict=True))) for row in rows]
    return np.stack(out, axis=1)
