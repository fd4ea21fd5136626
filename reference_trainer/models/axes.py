"""Names of the axes of splats: the rotation that is nearest to none, as a quaternion (1, g).

A splat has three axes and no order of them, so 24 rotations draw the same. The least of them turns
by at most 62.8 degrees, so w of its quaternion is never small and can be 1: three numbers are left,
which are small, and rotations that change later need no fourth.
"""

from __future__ import annotations

import itertools

import numpy as np

from evogs_codec.model.splats import F32, F64
from reference_trainer.models.split import rotations
from reference_trainer.models.tensors import SplatTensors

__all__ = ["one_w", "with_least_rotations"]

QUATS, SCALES = slice(3, 7), slice(7, 10)


def with_least_rotations(channels: F32) -> F32:
    """The same N splats, channels (D, N), their quaternions (1, g) with g as short as it can be."""
    turns = _turns()
    quats = channels[QUATS].T.astype(np.float64)
    quats[~quats.any(axis=1), 0] = 1  # zero means no rotation
    every = _products(quats[:, None], turns[None])  # (N, 24, 4)
    best = np.abs(every[:, :, 0]).argmax(axis=1)
    found = every[np.arange(len(quats)), best]
    out = channels.copy()
    out[QUATS] = (found / found[:, :1]).T
    # Axis k of a turned splat is the axis that the turn takes there.
    source = np.abs(rotations(turns.astype(np.float32))).argmax(axis=1)[best]
    out[SCALES] = np.take_along_axis(channels[SCALES].T, source, axis=1).T
    return out


def one_w(splats: SplatTensors) -> bool:
    """Whether the quaternions of all splats have the same w, above 0."""
    w = splats.quats[:, 0]
    return bool(len(w) and w[0] > 0 and (w == w[0]).all())


def _turns() -> F64:
    """(24, 4) quaternions that take axes to axes."""
    found: list[F64] = []
    for numbers in itertools.product((0.0, 1.0, -1.0), repeat=4):
        turn = np.array(numbers)
        there = np.flatnonzero(turn)
        if len(there) in (1, 2, 4) and turn[there[0]] > 0:
            found.append(turn / np.linalg.norm(turn))
    return np.array(found)


def _products(a: F64, b: F64) -> F64:
    """Quaternions a b: b first."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    rows = [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    return np.stack(rows, axis=-1)
