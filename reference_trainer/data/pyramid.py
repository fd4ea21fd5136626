"""Smaller pictures by area averaging: every pixel is the mean of what it covers.

A large picture has many small ones: the grid of their pixels may begin anywhere. A trainer that
sees several of them learns less of where the edges of pixels happen to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import zip_longest
from math import ceil

import numpy as np
from scipy.sparse import csr_array

from reference_trainer.data.view import F32, View

__all__ = ["area_average", "at_scale", "averaged", "on_shifted_grids"]

BAND = 1 << 20  # pixels of a picture that are averaged at a time
MIN_FINER = 1.9  # times as many pixels a side as at least; 2, less what rounding takes
HALVES = ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5))  # of a pixel, right and down


def at_scale(view: View, factor: int) -> View:
    """`view` with its sides divided by `factor` (8, 4, 2, 1), rounded; its field stays the same.

    Raises:
        ValueError: `factor` is below 1.
    """
    if factor < 1:
        raise ValueError(f"factor is {factor}, expected 1 or more")
    if factor == 1:
        return view
    width, height = (max(1, round(n / factor)) for n in (view.camera.width, view.camera.height))
    return View(
        view.name, view.camera.resized(width, height), area_average(view.image, width, height)
    )


def on_shifted_grids(views: tuple[View, ...], finer: tuple[View, ...]) -> tuple[View, ...]:
    """Each view, then the same photograph on grids half a pixel to the right, below, and both.

    The last column or row of a shifted grid is left out: it would reach over the edge.

    Args:
        views: photographs, and what pixels they have.
        finer: the same photographs with pixels of about half the size or less. Where their
            pixels are larger, or a view is missing here, it has no shifted grids.
    """
    found = []
    for view, larger in zip_longest(views, finer):
        found.append(view)
        if larger is not None:
            found += _shifted(view, larger.image)
    return tuple(found)


def _shifted(view: View, image: F32) -> list[View]:
    camera = view.camera
    if min(image.shape[0] / camera.height, image.shape[1] / camera.width) < MIN_FINER:
        return []
    found = []
    for right, below in HALVES:
        width, height = (n - ceil(x) for n, x in ((camera.width, right), (camera.height, below)))
        if not (width and height):
            continue
        down = _shares(image.shape[0], camera.height, below)[:height]
        across = _shares(image.shape[1], camera.width, right)[:width]
        moved = replace(
            camera, width=width, height=height, cx=camera.cx - right, cy=camera.cy - below
        )
        found.append(View(view.name, moved, _mixed(image, down, across)))
    return found


def area_average(image: F32, width: int, height: int) -> F32:
    """(height, width, C) of an (H, W, C) picture; border pixels count by the share covered."""
    size = (image.shape[1], image.shape[0])
    return averaged(lambda start, stop: image[start:stop], size, (width, height), image.shape[2])


def averaged(
    rows: Callable[[int, int], F32],
    size: tuple[int, int],
    sides: tuple[int, int],
    channels: int = 3,
) -> F32:
    """`area_average` of a picture that is made band by band, so that little of it is there at once.

    Args:
        rows: gives the rows from a first to before a last, (n, W, C).
        size: W and H.
        sides: width and height of the result.
        channels: C.
    """
    width, height = sides
    down, across = _shares(size[1], height), _shares(size[0], width)
    found = np.empty((height, width, channels), np.float32)
    step = max(1, BAND * height // (size[0] * size[1]))
    for top in range(0, height, step):
        shares = down[top : top + step]
        first, last = int(shares.indices.min()), int(shares.indices.max()) + 1
        found[top : top + shares.shape[0]] = _mixed(
            rows(first, last), shares[:, first:last], across
        )
    return found


def _mixed(image: F32, down: csr_array, across: csr_array) -> F32:
    """(height, width, C) of an (H, W, C) picture, by shares of its rows and of its columns."""
    height, width, channels = down.shape[0], across.shape[0], image.shape[2]
    rows = (down @ image.reshape(len(image), -1)).reshape(height, -1, channels)
    columns = across @ rows.transpose(1, 0, 2).reshape(image.shape[1], -1)
    mixed = columns.reshape(width, height, channels).transpose(1, 0, 2)
    return np.ascontiguousarray(mixed, np.float32)


def _shares(n: int, n_out: int, start: float = 0.0) -> csr_array:
    """(n_out, n): how much of output i is input j; rows add up to 1.

    With a `start` outputs begin so much of their size later, and what is outside does not count:
    rows that reach over the end add up to less.
    """
    if n_out > n:
        raise ValueError(f"{n} pixels do not average to {n_out}")
    edges = (np.arange(n_out + 1) + start) * (n / n_out)
    # Every input that an output touches, one more than most need; those outside have share 0.
    span = int(np.ceil(n / n_out)) + 1
    outputs = np.repeat(np.arange(n_out), span)
    inputs = np.floor(edges[:-1]).astype(np.int64)[:, None] + np.arange(span)
    left = np.maximum(inputs, edges[:-1, None])
    right = np.minimum(inputs + 1, edges[1:, None])
    covered = (np.clip(right - left, 0, None) * (n_out / n)).ravel()
    used = (covered > 0) & (inputs.ravel() < n)
    entries = (covered[used], (outputs[used], inputs.ravel()[used]))
    return csr_array(entries, shape=(n_out, n))
