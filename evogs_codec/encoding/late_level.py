"""The last level of a tree, late: its splits only make room, and refines show what they are to be.

At coarse steps the last level of some trees looks hardly better than the one before it, and its
bytes are better spent on splats that are at once as they are to be (`layers`).

Letters: D channels, n slots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from evogs_codec.encoding.arrange import Renumbered
from evogs_codec.encoding.held_steps import rooms
from evogs_codec.model.splats import F64, I32, I64
from evogs_codec.model.tree import EvolutionTree, Slots, Step, columns_of

__all__ = ["LateLevel", "can_be_late", "gains_little"]

LATE_GAIN_DB = 1.5  # dB; if the last level, at coarse steps, looks better by less, it comes late
# The same where some steps look worse: held back they cost more bytes than a level that is late.
LATE_GAIN_IF_SOME_FALL_DB = 3.0


def can_be_late(tiles: Sequence[EvolutionTree], n_levels: int) -> bool:
    """Whether the last level is not the first, and makes its new splats by splits alone.

    Its drops come with the splats that make room.
    """
    last = [step for tile in tiles for step in tile.steps if step.level == n_levels - 1]
    return n_levels > 1 and any(s.n_new for s in last) and not any(s.n_adds for s in last)


def gains_little(decibels: float, *, some_fall: bool = False) -> bool:
    """Whether the last level, if it looks better than the one before by this, is to come late.

    `some_fall`: with some of its steps, or with earlier ones, pictures look worse.
    """
    return decibels < (LATE_GAIN_IF_SOME_FALL_DB if some_fall else LATE_GAIN_DB)


@dataclass(frozen=True, eq=False)
class LateLevel:
    """A tile whose last level makes room, part by part.

    A step that refines the splats of a part names a row of slots then, where it would name one here
    and one there.

    Attributes:
        tile: with the slots that the last level makes, in its splits.
        n_rooms: (n_parts,) steps of the level, of each part.
        name: (n,) the number that each slot of the tile as it was has here.
        order: (n,) the number that each slot had there.
        lacks: (D, n) what is to be added to the slots.
        picks: (n,) of the slots, as they are to be; (0,) without a palette.
    """

    tile: EvolutionTree
    n_rooms: Sequence[int]
    name: I32
    order: I64
    lacks: F64
    picks: I32

    @staticmethod
    def of(tile: EvolutionTree, level: int, parts: I64) -> LateLevel:
        """The steps of a tile from this level on.

        Args:
            tile: arranged.
            level: its last.
            parts: (n,) the part, from 0 on, that each of its slots is in, with all that come from
                the same add.
        """
        begin = sum(step.level < level for step in tile.steps)
        n = sum(step.n_new for step in tile.steps[:begin])
        made, born = _as_one(rooms(tile, begin), n)
        found, n_rooms = Renumbered(len(parts)), []
        found.name[:n] = np.arange(n)
        found.n_slots = n
        for part in range(int(parts.max(initial=0)) + 1):
            n_before, n_steps = n, len(found.steps)
            for step in made:
                rows = np.flatnonzero(parts[step.slots] == part)
                rows = rows[np.argsort(found.name[step.slots[rows]], kind="stable")]
                found.add(step, n_before, rows, rows[:0])
                n_before += step.n_new
            n_rooms.append(len(found.steps) - n_steps)
        roomy = replace(tile, steps=(*tile.steps[:begin], *found.steps))
        name, order, last = found.name.copy(), born[found.order], _last_state(tile)
        name[born] = found.name
        picks = last.picks[order] if tile.palette is not None else last.picks[:0]
        lacks = last.values[:, order] - _last_state(roomy).values
        return LateLevel(roomy, n_rooms, name, order, lacks, picks)


def _as_one(made: Sequence[Step], n: int) -> tuple[Sequence[Step], I64]:
    """Steps that make room as one step, where none of them writes what another did.

    Which of them came first changes no picture, and one list of slots has longer rows.

    Args:
        made: splits and drops; C2s that make room take the picks of their parents.
        n: slots before them.

    Returns:
        The steps, and (n_slots,) the number that each of their slots had before.
    """
    same = np.arange(n + sum(step.n_new for step in made))
    if len(made) < 2:
        return made, same
    slots = np.concatenate([step.slots for step in made])
    if len(np.unique(slots)) < len(slots) or slots.max() >= n:
        return made, same
    order = np.argsort(slots)
    kinds = np.concatenate([step.kinds for step in made])
    changed, splits = columns_of(kinds, order)
    one = replace(
        made[0],
        slots=slots[order],
        kinds=kinds[order],
        psi=np.concatenate([step.psi for step in made], axis=1)[:, changed],
        alpha=np.concatenate([step.alpha for step in made], axis=1)[:, splits],
    )
    return [one], np.concatenate([same[:n], n + splits])


def _last_state(tile: EvolutionTree) -> Slots:
    """After all steps."""
    return next(islice(tile.states(), len(tile.steps) - 1, None))
