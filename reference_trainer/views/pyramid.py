"""Smaller pictures by area averaging: every pixel is the mean of what it covers."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from reference_trainer.views.view import F32, View

__all__ = ["area_average", "at_scale"]


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
    channels = image.shape[2]
    rows = _shares(image.shape[0], height) @ image.reshape(image.shape[0], -1)
    columns = rows.reshape(height, -1, channels).transpose(1, 0, 2).reshape(image.shape[1], -1)
    small = _shares(image.shape[1], width) @ columns
    averaged = small.reshape(width, height, channels).transpose(1, 0, 2)
    return np.ascontiguousarray(averaged, np.float32)


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
