"""No step back of SH bands: packets of a band with which pictures are worse are left empty.

What an error is worth is estimated number by number. Of few splats, errors of one band may make up
for those of another, so that a band without errors looks worse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.encoding.targets import TargetMissedError
from evogs_codec.model.components import CORE
from evogs_codec.model.packet_id import PacketId
from evogs_codec.scene.found_stream import FoundStream
from evogs_codec.scene.prefixes import StreamPrefixes
from evogs_codec.scene.states import FALL

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["MANY", "without_worse_bands"]

MANY = 20_000  # splats; of more, errors make up for each other, and packets take long to draw
TRIES = 3


def without_worse_bands(found: FoundStream, views: Views) -> FoundStream:
    """A stream that is made, without packets of SH bands that these views show to be worse.

    As it is where it would look worse as a whole without them, or miss its target.
    """
    if not found.is_by_views or found.tree.n_leaves > MANY or found.tree.palette is not None:
        return found
    empty: frozenset[PacketId] = frozenset()
    looks = _Looks.of(found, views)
    for _ in range(TRIES):
        if looks.worse <= empty:  # nothing new: packets of adds cannot be empty
            break
        empty |= looks.worse
        try:
            again = found.leaving_empty(empty).made()
        except TargetMissedError:
            break
        other = _Looks.of(again, views)
        if other.whole < looks.whole - FALL or other.fall > looks.fall:
            break
        found, looks = again, other
    return found


@dataclass(frozen=True)
class _Looks:
    """How the packets of SH bands of a stream change pictures.

    Attributes:
        whole: PSNR of the whole, dB.
        fall: the deepest with one of them, dB.
        worse: those that are falls.
    """

    whole: float
    fall: float
    worse: frozenset[PacketId]

    @staticmethod
    def of(found: FoundStream, views: Views) -> _Looks:
        """Of a stream that is made."""
        prefixes = StreamPrefixes(found.data)
        directory = prefixes.directory
        sizes = directory.packets["size"].astype(np.int64)
        rows = np.flatnonzero(sizes)
        rows = rows[np.argsort(directory.offsets[rows], kind="stable")]
        if not directory.columns[rows].any():
            return _Looks(math.inf, 0.0, frozenset())
        cuts = [Cut.of_prefix(directory, int(directory.offsets[row] + sizes[row])) for row in rows]
        deepest, best, before = 0.0, -math.inf, -math.inf
        worse = []
        for row, leaves in zip(rows, prefixes.shown(cuts, found.tree.shown_degree), strict=True):
            decibels = views.psnr(leaves)
            component = directory.components.of_tiles[directory.columns[row]]
            if component != CORE and decibels < before:
                deepest = max(deepest, best - decibels)
                if best - decibels > FALL / 2:
                    tile, step = int(directory.packets["tile"][row]), int(directory.steps[row])
                    worse.append(PacketId(tile, component, step))
            best, before = max(best, decibels), decibels
        return _Looks(before, deepest, frozenset(worse))
