"""The last level of a tree, late: its splits only make room, and refines show what they are to be.

At coarse steps the last level of some trees looks hardly better than the one before it, and its
bytes are better spent on splats that are at once as they are to be (`layers`).

Letters: D channels, n slots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

from evogs_codec.encoding.held_steps import rooms, splits_or_refines
from evogs_codec.model.splats import F64
from evogs_codec.model.tree import EvolutionTree

__all__ = ["LateLevel", "can_be_late"]


def can_be_late(tiles: Sequence[EvolutionTree], n_levels: int) -> bool:
    """Whether there is a level before the last one, which has splits and refines alone.

    Not with a palette: a C2 needs a pick before it can stand for its parent, and then its own.
    """
    if any(tile.palette is not None for tile in tiles):
        return False
    last = [step for tile in tiles for step in tile.steps if step.level == n_levels - 1]
    return n_levels > 1 and any(s.n_new for s in last) and all(map(splits_or_refines, last))


@dataclass(frozen=True, eq=False)
class LateLevel:
    """A tile whose last level makes room.

    Attributes:
        tile: with the slots that the last level makes, in its splits.
        n_rooms: steps of the level.
        lacks: (D, n) what is to be added to the slots.
    """

    tile: EvolutionTree
    n_rooms: int
    lacks: F64

    @staticmethod
    def of(tile: EvolutionTree, level: int) -> LateLevel:
        """The steps of a tile from this level on."""
        begin = sum(step.level < level for step in tile.steps)
        made = rooms(tile, begin)
        roomy = replace(tile, steps=(*tile.steps[:begin], *made))
        return LateLevel(roomy, len(made), _last_values(tile) - _last_values(roomy))


def _last_values(tile: EvolutionTree) -> F64:
    """(D, n) after all steps."""
    state = next(islice(tile.states(), len(tile.steps) - 1, None))
    return state.values
