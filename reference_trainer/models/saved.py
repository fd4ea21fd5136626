"""Arrays of a checkpoint, taken by name: each has the type and the shape that is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec import InputError
from evogs_codec.common.printable import shown

__all__ = ["Arrays", "taken", "taken_number"]

Arrays: TypeAlias = dict[str, npt.NDArray[Any]]


def taken(
    arrays: Mapping[str, npt.NDArray[Any]],
    name: str,
    dtype: npt.DTypeLike,
    *shape: int | None,
) -> npt.NDArray[Any]:
    """The array `name`; a side of None may have any length.

    Raises:
        InputError: it is missing, or of another type or shape.
    """
    if name not in arrays:
        raise InputError(f"{name} is missing")
    found = arrays[name]
    if found.dtype != np.dtype(dtype):
        raise InputError(f"{name} is {shown(found.dtype)}, expected {np.dtype(dtype)}")
    fits = len(found.shape) == len(shape) and all(
        side in (None, length) for length, side in zip(found.shape, shape, strict=True)
    )
    if not fits:
        expected = " x ".join("any" if side is None else str(side) for side in shape)
        raise InputError(f"{name} has shape {found.shape}, expected {expected or 'one number'}")
    return found


def taken_number(arrays: Mapping[str, npt.NDArray[Any]], name: str, low: int, high: int) -> int:
    """The whole number `name`, in `low`..`high`.

    Raises:
        InputError: it is missing, no whole number, or out of range.
    """
    found = int(taken(arrays, name, np.int64))
    if not low <= found <= high:
        raise InputError(f"{name} is {found}, expected {low} to {high}")
    return found
