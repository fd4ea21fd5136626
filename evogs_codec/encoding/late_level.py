"""The last level of a tree, late: its splits only make room, and refines show what they are to be.

At coarse steps the last level of some trees looks hardly better than the one before it, and its
bytes are better spent on splats that are at once as they are to be (`layers`).

Letters: D channels, n slots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

from evogs_codec.encoding.held_steps import rooms
from evogs_codec.model.splats import F64, I32
from evogs_codec.model.tree import EvolutionTree, Slots

__all__ = ["LateLevel", "can_be_late"]


def can_be_late(tiles: Sequence[EvolutionTree], n_levels: int) -> bool:
    """Whether there is a level before the last one, which splits and adds nothing.

    Its drops come with the splats that make room.
    """
    last = [step for tile in tiles for step in tile.steps if step.level == n_levels - 1]
    return n_levels > 1 and any(s.n_new for s in last) and not any(s.n_adds for s in last)


@dataclass(frozen=True, eq=False)
class LateLevel:
    """A tile whose last level makes room.

    Attributes:
        tile: with the slots that the last level makes, in its splits.
        n_rooms: steps of the level.
        lacks: (D, n) what is to be added to the slots.
        picks: (n,) of the slots, as they are to be; (0,) without a palette.
    """

    tile: EvolutionTree
    n_rooms: int
    lacks: F64
    picks: I32

    @staticmethod
    def of(tile: EvolutionTree, level: int) -> LateLevel:
        """The steps of a tile from this level on."""
        begin = sum(step.level < level for step in tile.steps)
        made = rooms(tile, begin)
        roomy = replace(tile, steps=(*tile.steps[:begin], *made))
        last = _last_state(tile)
        picks = last.picks if tile.palette is not None else last.picks[:0]
        return LateLevel(roomy, len(made), last.values - _last_state(roomy).values, picks)


def _last_state(tile: EvolutionTree) -> Slots:
    """After all steps."""
    return next(islice(tile.states(), len(tile.steps) - 1, None))
