"""`CodedTree`: a tree in integers, as a stream holds it (spec 3, 5.3 to 5.6).

Letters: R records of a step that name a slot, P of them with psi, S splits, A adds, D channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from evogs_codec.model.arithmetic import SYMMETRIC, AlphaTable, Quantiser
from evogs_codec.model.channels import N_CORE, channel_class
from evogs_codec.model.components import Components
from evogs_codec.model.palette import Palette
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import I32, U8

__all__ = [
    "CodedStep",
    "CodedTile",
    "CodedTree",
]


@dataclass(frozen=True, eq=False)
class CodedStep:
    """One step of one tile.

    Attributes:
        level: label.
        slots: (R,) int32, strictly increasing.
        kinds: (R,) uint8 of refine, split, drop.
        alpha: (5, S) uint8 indices into the tables of the level.
        psi: (D, P) int32, q of refines and splits; d of channels in `siblings`.
        adds: (D, A) int32, q of the adds.
        error: estimates for the packet entries (spec 5.6), by column of `Components`.
        gain: mean squared error of pictures that the packet of each column takes off; for the
            order of packets, no part of the stream.
        picks, changed_picks: int32 as of `tree.Step`, where there is a palette.
        siblings: channels whose psi are sibling differences (`model.siblings`).
    """

    level: int
    slots: I32
    kinds: U8
    alpha: U8
    psi: I32
    adds: I32
    error: tuple[int, ...] = ()
    gain: tuple[float, ...] = ()
    picks: I32 = field(default_factory=lambda: np.empty(0, np.int32))
    changed_picks: I32 = field(default_factory=lambda: np.empty(0, np.int32))
    siblings: tuple[int, ...] = ()

    @property
    def n_new(self) -> int:
        """Slots the step makes."""
        return int(self.alpha.shape[1] + self.adds.shape[1])


@dataclass(frozen=True, eq=False)
class CodedTile:
    """Steps, origin (3,) and box, (3,) each, of a tile."""

    origin: tuple[int, int, int]
    box_min: tuple[int, int, int]
    box_max: tuple[int, int, int]
    steps: tuple[CodedStep, ...]


@dataclass(frozen=True, eq=False)
class CodedTree:
    """All that a stream says of a scene, but for the bytes it says it in.

    Where there is a palette (spec 12), `entries` (C, n) int32 are its q, `entry_levels` (n,) the
    levels of their packets, never falling; psi and adds have the channels of core alone.
    `entry_uses` (n,) or (0,) are numbers that rise where other steps are the first to pick entries.
    A packet of the palette ends after each of `palette_ends` entries; by default each level has
    one.
    """

    sh_degree: int
    n_levels: int
    grid_exponents: tuple[int, ...]
    quantisers: tuple[tuple[Quantiser, ...], ...]
    alpha: Mapping[tuple[int, int], AlphaTable]
    tiles: tuple[CodedTile, ...]
    info: SceneInfo = field(default_factory=SceneInfo)
    entries: I32 | None = None
    entry_levels: I32 = field(default_factory=lambda: np.empty(0, np.int32))
    entry_uses: I32 = field(default_factory=lambda: np.empty(0, np.int32))
    palette_ends: tuple[int, ...] = ()

    def alpha_table(self, level: int, group: int) -> AlphaTable:
        """The table of a level and group; symmetric where none is stored."""
        return self.alpha.get((level, group), SYMMETRIC)

    @property
    def components(self) -> Components:
        """Those of the stream (spec 3.5, 12)."""
        return Components(self.sh_degree, self.entries is not None)

    @property
    def palette_rows(self) -> list[slice]:
        """The entries of each packet of the palette."""
        levels = np.unique(self.entry_levels)
        of_levels: list[int] = np.searchsorted(self.entry_levels, levels, side="right").tolist()
        return [slice(*ends) for ends in pairwise((0, *(self.palette_ends or of_levels)))]

    @property
    def palette_levels(self) -> list[int]:
        """Level of each packet of the palette."""
        return [int(self.entry_levels[rows.start]) for rows in self.palette_rows]

    def palette(self) -> Palette | None:
        """The entries as a decoder has them."""
        if self.entries is None:
            return None
        kinds = [channel_class(N_CORE + k) for k in range(len(self.entries))]
        units = np.array([self.quantisers[0][kind].step for kind in kinds])
        values = self.entries * units[:, None] * 2.0 ** -self.grid_exponents[4]
        return Palette(self.sh_degree, values.astype(np.float32))
