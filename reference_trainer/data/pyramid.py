"""Smaller pictures by area averaging: every pixel is the mean of what it covers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from reference_trainer.data.view import F32, View

__all__ = ["area_average", "at_scale", "averaged"]

BAND = 1 << 20  # pixels of a picture that are averaged at a time


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
        band = rows(first, last)
        n = shares.shape[0]
        mixed = shares[:, first:last] @ band.reshape(len(band), -1)
        columns = mixed.reshape(n, -1, channels).transpose(1, 0, 2).reshape(size[0], -1)
        small = across @ columns
        found[top : top + n] = small.reshape(width, n, channels).transpose(1, 0, 2)
    return found


def _shares(n: int, n_out: int) -> csr_array:
    """(n_out, n): how much of output i is input j; rows add up to 1."""
    if n_out > n:
        raise ValueError(f"{n} pixels do not average to {n_out}")
    edges = np.arange(n_out + 1) * (n / n_out)
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
