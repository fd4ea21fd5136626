"""(3, 3) rotation matrices, from what people give."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evogs_codec.model.splats import F64

__all__ = ["rotation_about", "rotation_of_matrix", "rotation_of_quaternion"]

NOT_ORTHOGONAL = 1e-3  # how far the rows of a matrix may be from those of a rotation


def rotation_about(axis: Sequence[float], degrees: float) -> F64:
    """The rotation about an axis by an angle, anticlockwise where the axis points at the viewer.

    Raises:
        ValueError: the axis has no direction.
    """
    x, y, z = _unit(axis, "the axis")
    half = np.radians(degrees) / 2
    return rotation_of_quaternion([np.cos(half), *(np.sin(half) * np.array([x, y, z]))])


def rotation_of_quaternion(quaternion: Sequence[float]) -> F64:
    """The rotation of w x y z, which need not be normalised.

    Raises:
        ValueError: it is zero.
    """
    w, x, y, z = _unit(quaternion, "the quaternion")
    matrix: F64 = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return matrix


def rotation_of_matrix(rows: Sequence[float]) -> F64:
    """The rotation nearest to nine numbers, row by row, which are one but for rounding.

    Raises:
        ValueError: they are no rotation: they stretch, or mirror.
    """
    matrix = np.array(rows, np.float64).reshape(3, 3)
    if not np.abs(matrix @ matrix.T - np.eye(3)).max() <= NOT_ORTHOGONAL:
        raise ValueError("the matrix is no rotation: its rows are not orthogonal unit vectors")
    if np.linalg.det(matrix) < 0:
        raise ValueError("the matrix is no rotation: it mirrors")
    left, _, right = np.linalg.svd(matrix)
    nearest: F64 = left @ right
    return nearest


def _unit(vector: Sequence[float], name: str) -> F64:
    numbers = np.array(vector, np.float64)
    length = np.linalg.norm(numbers)
    if not 0 < length < np.inf:
        raise ValueError(f"{name} has no direction")
    unit: F64 = numbers / length
    return unit
