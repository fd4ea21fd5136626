"""BD-rate (Bjontegaard): how many bytes more one curve takes for the quality of another.

Bytes are compared as logarithms, interpolated over PSNR by cubics that keep order (PCHIP).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

__all__ = ["Curve", "at_worst", "bd_rate", "bytes_at", "log_bytes", "psnr_at"]

Curve: TypeAlias = Sequence[tuple[float, float]]  # bytes and PSNR in dB of each point
F64: TypeAlias = npt.NDArray[np.float64]
SAMPLES = 1001  # of the PSNR that both have


def bd_rate(curve: Curve, *others: Curve) -> float | None:
    """Bytes of `curve` beyond those of the best of `others`, in %, over the PSNR that both have.

    Args:
        curve: at least two points.
        others: likewise; at each PSNR the smallest counts.

    Returns:
        Negative if `curve` is smaller; None where they have no PSNR in common.

    Raises:
        ValueError: a curve has fewer than two points, or its bytes and PSNR do not rise together.
    """
    found = _beyond(curve, others)
    return None if found is None else float(100 * np.expm1(found.mean()))


def at_worst(curve: Curve, *others: Curve) -> float | None:
    """As `bd_rate`, at the one PSNR where `curve` takes most bytes beyond the best of `others`."""
    found = _beyond(curve, others)
    return None if found is None else float(100 * np.expm1(found.max()))


def log_bytes(curve: Curve, at: F64) -> F64:
    """(n,) logarithm of the bytes that a curve takes for (n,) dB; NaN outside of it."""
    n_bytes, psnr = _in_order(curve)
    found: F64 = PchipInterpolator(psnr, np.log(n_bytes), extrapolate=False)(at)
    return found


def psnr_at(curve: Curve, n_bytes: float) -> float:
    """The PSNR for so many bytes; beyond its ends a curve goes on as between its last two points.

    Raises:
        ValueError: as `bd_rate`.
    """
    sizes, psnr = _in_order(curve)
    x, sizes = float(np.log(n_bytes)), np.log(sizes)
    if sizes[0] <= x <= sizes[-1]:
        return float(PchipInterpolator(sizes, psnr)(x))
    a, b = (0, 1) if x < sizes[0] else (-2, -1)
    return float(psnr[a] + (x - sizes[a]) * (psnr[b] - psnr[a]) / (sizes[b] - sizes[a]))


def bytes_at(curve: Curve, psnr: float) -> float | None:
    """The bytes for so many dB; above its end a curve goes on as `psnr_at`, below it has none.

    Raises:
        ValueError: as `bd_rate`.
    """
    sizes, decibels = _in_order(curve)
    if psnr < decibels[0]:
        return None
    if psnr <= decibels[-1]:
        return float(np.exp(log_bytes(curve, np.array([psnr]))[0]))
    slope = np.log(sizes[-1] / sizes[-2]) / (decibels[-1] - decibels[-2])
    return float(sizes[-1] * np.exp(slope * (psnr - decibels[-1])))


def _beyond(curve: Curve, others: Sequence[Curve]) -> F64 | None:
    """Logarithms of bytes less those of the best of others, at samples of the PSNR in common."""
    curves = [_in_order(points) for points in (curve, *others)]
    low = max(curves[0][1][0], min(psnr[0] for _, psnr in curves[1:]))
    high = min(curves[0][1][-1], max(psnr[-1] for _, psnr in curves[1:]))
    if not low < high:
        return None
    at = np.linspace(low, high, SAMPLES)
    own, *of_others = (log_bytes(points, at) for points in (curve, *others))
    best = np.fmin.reduce(of_others)
    there = np.isfinite(best)
    found: F64 = (own - best)[there]
    return found if there.any() else None


def _in_order(curve: Curve) -> tuple[F64, F64]:
    points = np.array(sorted(curve), np.float64)
    if len(points) < 2:
        raise ValueError(f"a curve of {len(points)} point, expected 2 or more")
    n_bytes, psnr = points.T
    if not ((np.diff(n_bytes) > 0).all() and (np.diff(psnr) > 0).all()):
        raise ValueError(f"bytes and PSNR do not rise together: {points.tolist()}")
    return n_bytes, psnr
