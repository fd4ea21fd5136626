"""SSIM of two pictures, and its gradient: an 11 x 11 Gaussian window, zeros around the picture.

W pixels to a line. For each line, the five moments under the window are made first along columns,
then along the line, so nothing but the three partial derivatives is ever stored as a picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.compiled import (
    Scalar,
    inlined,
    n_threads,
    parallel_kernel,
    prange,
    row_kernel,
)

__all__ = ["ssim", "ssim_gradient"]

Array = npt.NDArray[Any]
Real = npt.NDArray[np.floating[Any]]

RADIUS, SIGMA = 5, 1.5
C1, C2 = 0.01**2, 0.03**2
_TAPS = 2 * RADIUS + 1


def ssim(a: Real, b: Real) -> float:
    """Mean structural similarity of two (H, W, C) pictures of values 0..1."""
    a, b = _planes(a, b)
    return _mean(_forward(a, b, _window(a), np.empty((3, 0, 0, 0), a.dtype), n_threads()), a)


def ssim_gradient(a: Real, b: Real) -> tuple[float, Real]:
    """`ssim`, and its gradient to `a`, (H, W, C)."""
    a, b = _planes(a, b)
    window, partials = _window(a), np.empty((3, *a.shape), a.dtype)
    value = _mean(_forward(a, b, window, partials, n_threads()), a)
    out = np.empty((*a.shape[1:], a.shape[0]), a.dtype)
    _backward(a, b, window, partials, out, n_threads())
    return value, out


def _planes(a: Real, b: Real) -> tuple[Real, Real]:
    if a.shape != b.shape or a.ndim != 3 or not a.size:
        raise ValueError(f"pictures of shapes {a.shape} and {b.shape}")
    dtype = np.float64 if np.float64 in (a.dtype, b.dtype) else np.float32
    first: Real = np.ascontiguousarray(np.moveaxis(a, 2, 0), dtype)
    second: Real = np.ascontiguousarray(np.moveaxis(b, 2, 0), dtype)
    return first, second


def _window(like: Real) -> Real:
    x = np.arange(_TAPS) - RADIUS
    window = np.exp(-(x**2) / (2 * SIGMA**2))
    return np.asarray(window / window.sum(), like.dtype)


def _mean(sums: npt.NDArray[np.float64], a: Real) -> float:
    return float(sums.sum() / a.size)


@row_kernel
def _moments(a: Array, b: Array, weight: Scalar, lines: Array) -> None:
    """Add the moments of one line, weighted, to the five lines (with RADIUS zeros at both ends)."""
    n = np.uint64(len(a))
    at = np.uint64(RADIUS)
    for i in range(n):
        x, y = a[i], b[i]
        wx, wy = weight * x, weight * y
        lines[0, i + at] += wx
        lines[1, i + at] += wy
        lines[2, i + at] += wx * x
        lines[3, i + at] += wy * y
        lines[4, i + at] += wx * y


@row_kernel
def _along(line: Array, window: Array, out: Array) -> None:
    """Blur a line that has RADIUS zeros at both ends."""
    for i in range(np.uint64(len(out))):
        total = out.dtype.type(0)
        for k in range(np.uint64(_TAPS)):
            total += window[k] * line[i + k]
        out[i] = total


@row_kernel
def _compare(m: Array, partials: Array, c1: Scalar, c2: Scalar) -> float:
    """Similarity of the pixels of a line from its five moments, summed; fills three partials."""
    one = m.dtype.type(1)
    two = m.dtype.type(2)
    total = 0.0
    for i in range(np.uint64(m.shape[1])):
        ma, mb = m[0, i], m[1, i]
        a1, b1 = two * ma * mb + c1, ma * ma + mb * mb + c1
        a2 = two * (m[4, i] - ma * mb) + c2
        b2 = m[2, i] - ma * ma + m[3, i] - mb * mb + c2
        scale = one / (b1 * b2)
        s = a1 * a2 * scale
        by_variance = -s / b2
        by_covariance = two * a1 * scale
        partials[0, i] = (
            two * (mb * a2 * scale - ma * s / b1) - two * ma * by_variance - mb * by_covariance
        )
        partials[1, i] = by_variance
        partials[2, i] = by_covariance
        total += s
    return total


@inlined
def _rows_around(y: int, height: int) -> tuple[int, int]:
    return max(0, y - RADIUS), min(height, y + RADIUS + 1)


@parallel_kernel
def _forward(a: Array, b: Array, window: Array, partials: Array, n_workers: int) -> Array:
    """Similarity of each line, summed over its pixels; fills (3, C, H, W) partials unless empty."""
    channels, height, width = a.shape
    sums = np.empty((channels, height))
    keep = partials.shape[1] > 0
    c1, c2 = a.dtype.type(C1), a.dtype.type(C2)
    for worker in prange(n_workers):
        lines = np.zeros((5, width + 2 * RADIUS), a.dtype)
        moments = np.empty((5, width), a.dtype)
        line_partials = np.empty((3, width), a.dtype)
        for line in range(worker, channels * height, n_workers):
            c, y = line // height, line % height
            lines[:] = a.dtype.type(0)
            first, last = _rows_around(y, height)
            for row in range(first, last):
                _moments(a[c, row], b[c, row], window[row - y + RADIUS], lines)
            for m in range(5):
                _along(lines[m], window, moments[m])
            sums[c, y] = _compare(moments, line_partials, c1, c2)
            if keep:
                partials[:, c, y] = line_partials
    return sums


@row_kernel
def _weighted(line: Array, weight: Scalar, out: Array) -> None:
    at = np.uint64(RADIUS)
    for i in range(np.uint64(len(line))):
        out[i + at] += weight * line[i]


@parallel_kernel
def _backward(
    a: Array, b: Array, window: Array, partials: Array, out: Array, n_workers: int
) -> None:
    """Gradient of the mean to `a`, (H, W, C), from the partials: blurred once more."""
    channels, height, width = a.shape
    scale = a.dtype.type(1.0 / a.size)
    two = a.dtype.type(2)
    for worker in prange(n_workers):
        lines = np.zeros((3, width + 2 * RADIUS), a.dtype)
        blurred = np.empty((3, width), a.dtype)
        for line in range(worker, channels * height, n_workers):
            c, y = line // height, line % height
            lines[:] = a.dtype.type(0)
            first, last = _rows_around(y, height)
            for row in range(first, last):
                for part in range(3):
                    _weighted(partials[part, c, row], window[row - y + RADIUS], lines[part])
            for part in range(3):
                _along(lines[part], window, blurred[part])
            for x in range(width):
                out[y, x, c] = scale * (
                    blurred[0, x] + two * a[c, y, x] * blurred[1, x] + b[c, y, x] * blurred[2, x]
                )
