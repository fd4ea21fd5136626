"""Splits that do not show: two children that together are, nearly, their parent.

The children sit d standard deviations from their parent, on its longest axis. A mixture of two
Gaussians at +-d sigma has the parent's covariance if each has (1 - d^2) of its variance on that
axis, and the parent's peak if each has opacity 1 - sqrt(1 - o) of it, divided by how far its own
density has fallen at the parent's centre.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams
from evogs_codec.model.splats import F32

__all__ = ["moment_matched", "rotations", "symmetric"]

# Of position, rotation, scale, opacity, SH: both children shrink and fade, all else goes apart.
ALPHA = (1.0, 1.0, -1.0, -1.0, 1.0)
MIN_OPACITY, MAX_OPACITY = 1e-4, 0.995  # opacities of children


def moment_matched(parents: SplatParams, distance: float) -> tuple[SplatParams, F32]:
    """psi, shaped like the M parents, and alpha (M, 5)."""
    psi = symmetric(parents, distance)[0]
    rows, axis = np.arange(len(parents)), parents.log_scales.argmax(axis=1)
    scales = np.zeros_like(parents.log_scales)
    scales[rows, axis] = 0.5 * np.log(1 - distance**2)
    opacity = 1 / (1 + np.exp(-parents.opacity_logits.astype(np.float64)))
    fall = np.exp(-(distance**2) / (2 * (1 - distance**2)))
    child = np.clip((1 - np.sqrt(1 - opacity)) / fall, MIN_OPACITY, MAX_OPACITY)
    logits = np.log(child / (1 - child)) - parents.opacity_logits
    alpha = np.tile(np.array(ALPHA, np.float32), (len(parents), 1))
    return SplatParams(psi.means, psi.quats, scales, logits.astype(np.float32), psi.sh), alpha


def symmetric(parents: SplatParams, distance: float) -> tuple[SplatParams, F32]:
    """Psi that only moves, and alpha (M, 5) of ones: with one sign for all, nothing else can."""
    rows, axis = np.arange(len(parents)), parents.log_scales.argmax(axis=1)
    direction = rotations(parents.quats)[rows, :, axis]
    # The sign is free; a fixed rule costs the codec less.
    largest = np.abs(direction).argmax(axis=1)
    direction = direction * np.sign(direction[rows, largest])[:, None]
    length = distance * np.exp(parents.log_scales[rows, axis].astype(np.float64))
    psi = SplatParams(
        (direction * length[:, None]).astype(np.float32),
        np.zeros_like(parents.quats),
        np.zeros_like(parents.log_scales),
        np.zeros_like(parents.opacity_logits),
        np.zeros_like(parents.sh),
    )
    return psi, np.ones((len(parents), 5), np.float32)


def rotations(quats: F32) -> npt.NDArray[np.float64]:
    """(M, 3, 3) matrices of quaternions (M, 4) of any length; zero means identity."""
    q = quats.astype(np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 0, q / np.maximum(length, 1e-300), [1.0, 0.0, 0.0, 0.0])
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
