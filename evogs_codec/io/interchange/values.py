"""Numbers as other formats store them: bytes of opacity and colour, three of four components.

Letters: N splats.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32, I64, U8

__all__ = [
    "BYTE_COLOURS",
    "BYTE_LOGITS",
    "C0",
    "SMALLEST_SCALE",
    "as_bytes",
    "largest_and_rest",
    "log_scales_of",
    "logits_of",
    "quats_of",
    "sigmoid",
    "unit",
]

C0 = 0.28209479177387814  # the SH function of band 0

SMALLEST_SCALE = -20.0  # the logarithm for a scale of 0: 2e-9 units, which renders the same

REST = np.array(
    [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]
)  # the components that are not number i


def logits_of(opacities: npt.NDArray[np.floating]) -> F32:
    """Logits of opacities; infinite for 0 and 1, NaN outside."""
    o = np.asarray(opacities, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (np.log(o) - np.log1p(-o)).astype(np.float32)


def sigmoid(logits: F32) -> F32:
    """Opacities of logits."""
    with np.errstate(over="ignore"):
        opacities: F32 = (1 / (1 + np.exp(-logits.astype(np.float64)))).astype(np.float32)
    return opacities


BYTE_LOGITS: F32 = logits_of(np.arange(256) / 255)
BYTE_COLOURS: F32 = ((np.arange(256) / 255 - 0.5) / C0).astype(np.float32)  # SH of band 0


def log_scales_of(scales: npt.NDArray[np.floating]) -> F32:
    """Logarithms of standard deviations: `SMALLEST_SCALE` for 0, NaN for negative ones."""
    s = np.asarray(scales, np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(s)
    logs[s == 0] = SMALLEST_SCALE
    return logs


def as_bytes(parts: npt.NDArray[np.floating]) -> U8:
    """Numbers of 0 to 255, rounded; others become the nearest."""
    rounded: U8 = np.rint(np.clip(parts, 0, 255)).astype(np.uint8)
    return rounded


def unit(quats: F32) -> F32:
    """(N, 4) the rotations as unit quaternions; the identity for zero."""
    q = quats.astype(np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(length > 0, q, [1.0, 0, 0, 0])
    q /= np.where(length > 0, length, 1)
    return q.astype(np.float32)


def largest_and_rest(quats: F32) -> tuple[I64, F32]:
    """Which component of unit quaternions is the largest, and the others if it is positive.

    Args:
        quats: (N, 4) in the order of the format.

    Returns:
        (N,) and (N, 3).
    """
    rows = np.arange(len(quats))
    largest = np.argmax(np.abs(quats), axis=1)
    signs = np.where(quats[rows, largest] < 0, np.float32(-1), np.float32(1))
    return largest, quats[rows[:, None], REST[largest]] * signs[:, None]


def quats_of(largest: npt.NDArray[np.integer], rest: F32) -> F32:
    """(N, 4) the inverse of `largest_and_rest`; of three that are too large the fourth is 0."""
    rows = np.arange(len(rest))
    quats = np.empty((len(rest), 4), np.float32)
    squares = np.einsum("ij,ij->i", rest, rest)
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - squares))
    quats[rows[:, None], REST[largest]] = rest
    return quats
