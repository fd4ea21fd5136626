"""A stream moved by an offset: origins of tiles change, and no packet does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.format.chunks import MAX_ORIGIN
from evogs_codec.format.directory import read_directory
from evogs_codec.format.write_directory import rebuild_directory
from evogs_codec.model.placement import placed_text
from evogs_codec.model.splats import F64
from evogs_codec.stores.sources import Source, bytes_of

__all__ = ["Moved", "moved"]


@dataclass(frozen=True, eq=False)
class Moved:
    """A moved stream.

    Attributes:
        data: its bytes.
        offset: (3,) by how much it was moved, a multiple of `unit`, scene units.
        unit: of the grid of positions.
    """

    data: bytes
    offset: F64
    unit: float


def moved(data: Source, offset: F64) -> Moved:
    """The stream with every splat moved by the multiple of the grid that is nearest to `offset`.

    All integers stay as they are, and so do their digests, which do not hold origins (spec 7.7).
    Cameras of the metadata move, too.

    Args:
        data: a whole stream.
        offset: (3,) scene units.

    Raises:
        StreamError: header or chunks are not legal.
        ValueError: an origin would be beyond the range of the format (R-5.5-1).
    """
    view = bytes_of(data)
    directory = read_directory(view)
    unit = 2.0 ** -directory.grid_exponents[0]
    steps = np.rint(np.asarray(offset, np.float64) / unit)
    tiles = directory.tiles.copy()
    # In float64, where nothing wraps, and compared before the cast; sums below 2**53 are exact.
    origins = tiles["origin"].astype(np.float64) + steps
    if not (np.abs(origins) <= MAX_ORIGIN).all():
        raise ValueError(f"an origin would be over 2^52 units of {unit:g} from zero")
    tiles["origin"] = origins.astype(np.int64)
    text = placed_text(directory.info.text, np.eye(3), steps * unit)
    placed = replace(directory, info=replace(directory.info, text=text))
    head = rebuild_directory(placed, tiles, directory.packets, directory.digests)
    body = view[directory.data_offset : directory.size]
    return Moved(b"".join([head, body]), steps * unit, unit)
