"""Points that a trainer may start from: positions and colours of a `.ply`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from plyfile import PlyData

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError
from evogs_codec.io.plain_files import is_there
from reference_trainer.data.view import F32

__all__ = ["checked_points", "read_points"]


def read_points(path: Path) -> tuple[F32, F32]:
    """(N, 3) positions and (N, 3) colours in 0..1, grey where the file has none.

    Raises:
        InputError: the file cannot be read, or has no vertices with x, y and z.
    """
    if not is_there(path):
        raise InputError(f"{path}: cannot be read: it is missing")
    try:
        rows = PlyData.read(str(path))["vertex"]
        positions = np.column_stack([rows[name] for name in ("x", "y", "z")])
        names = {found.name for found in rows.properties}
        if {"red", "green", "blue"} <= names:
            stored = np.column_stack([rows[name] for name in ("red", "green", "blue")])
            colours = stored / 255 if stored.dtype.kind in "iu" else stored
        else:
            colours = np.full(positions.shape, 0.5)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except MemoryError:
        raise
    except Exception as error:  # plyfile and numpy raise a dozen types over damaged bytes
        raise InputError(f"{path}: no .ply of points: {shown(error)}") from error
    return checked_points(path, positions, colours)


def checked_points(
    path: Path, positions: npt.NDArray[np.generic], colours: npt.NDArray[np.generic]
) -> tuple[F32, F32]:
    """The same as float32.

    Raises:
        InputError: a number is not finite.
    """
    with np.errstate(over="ignore"):  # too large for float32 is not finite
        points, shades = positions.astype(np.float32), colours.astype(np.float32)
    if not (np.isfinite(points).all() and np.isfinite(shades).all()):
        raise InputError(f"{path}: a point is not finite")
    return points, np.clip(shades, 0, 1)
