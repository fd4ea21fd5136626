"""Which levels a cut has: what is there of a truncated file, or what an extraction keeps.

All of it follows from the directory: no packet is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.decoding.cut import Cut
from evogs_codec.format.directory import Directory
from evogs_codec.model.components import CORE

__all__ = ["LevelPresence", "bytes_for_first_splats", "level_presence"]

State: TypeAlias = Literal["present", "in part", "missing"]


@dataclass(frozen=True)
class LevelPresence:
    """How much of a level a cut has.

    Attributes:
        state: "present" if the cut has all packets of this level and of those below; "missing" if
            it has none of this level; else "in part".
        has_all_splats: the cut has all core packets of this level and of those below: if the state
            is "in part", only SH are missing.
    """

    state: State
    has_all_splats: bool


def level_presence(directory: Directory, cut: Cut, whole: Cut | None = None) -> list[LevelPresence]:
    """(n_levels,) how much of each level a cut has.

    Args:
        directory: of the stream.
        cut: for instance `Cut.of_prefix`, of a truncated file.
        whole: the cut that has all of each level; by default all packets of the file.

    Raises:
        ValueError: a cut asks for steps that the file does not have.
    """
    has = cut.packets(directory)
    missing = (Cut.full(directory) if whole is None else whole).packets(directory) & ~has
    some = has & (directory.packets["size"] > 0)
    label, is_core = directory.labels, directory.packets["component"] == CORE

    def lowest(packets: npt.NDArray[np.bool_]) -> int:
        return int(label[packets].min(initial=directory.n_levels))

    has_some = np.bincount(label[some], minlength=directory.n_levels) > 0
    not_whole, without_splats = lowest(missing), lowest(missing & is_core)
    found: list[LevelPresence] = []
    for level in range(directory.n_levels):
        has_all_splats = level < without_splats
        in_part = has_all_splats or bool(has_some[level])
        state: State = "present" if level < not_whole else "in part" if in_part else "missing"
        found.append(LevelPresence(state, has_all_splats))
    return found


def bytes_for_first_splats(directory: Directory, cut: Cut) -> int | None:
    """How many bytes a file has from its first on, when a cut of it has splats.

    Returns:
        None if the cut adds no splats.

    Raises:
        ValueError: the cut asks for steps that the file does not have.
    """
    rows = directory.packets
    adds = cut.packets(directory) & (rows["component"] == CORE) & (rows["n_adds"] > 0)
    ends = directory.offsets[adds] + rows["size"][adds]
    return int(ends.min()) if len(ends) else None
