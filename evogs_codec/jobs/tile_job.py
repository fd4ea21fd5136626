"""What a job gets: a tile, its neighbourhood, and how it is encoded.

A job needs nothing else, so that it gives the same bytes wherever it runs, and may be run again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from evogs_codec.io.finite import bounded_opacities
from evogs_codec.jobs.partition import SPLATS_OF_STAND_IN
from evogs_codec.jobs.surroundings import Standing, enlarged
from evogs_codec.jobs.tile_tree import Split
from evogs_codec.model.channels import n_channels
from evogs_codec.model.splats import F32, SplatParams
from evogs_codec.scene.effort import Effort

__all__ = ["TileJob", "sorted_rows"]

MAX_VIEWS = 12  # of a tile, by which its numbers are weighed

Part: TypeAlias = "tuple[int, str, tuple[float, float, float]]"


@dataclass(frozen=True)
class TileJob:
    """A tile, and how it is encoded.

    Attributes:
        rows: file of (n, D) float32, positions from `origin`.
        sh_degree: of its splats.
        origin: scene units.
        tile: number of the tile.
        block: of each tile of the neighbourhood, this one among them, its number, the file of the
            splats that stand for it, and where its origin is from that of the first.
        panes: number and file of those of each other tile that has some.
        split: the part of the tree that is the neighbourhood.
        n_around: splats of the neighbourhood, those of this tile among them.
        n_levels: of the tree.
        n_layers: of precision.
        may_be_late: the last level may come late.
        up: what is up in views, an axis or a vector.
        effort: as of `encode_scene`.
        shares: splats share their SH, so that a survey tells of a palette.
        n_tiles: of the stream.
        drawn: file of what pictures tell of the tile (`Drawn`), which a survey leaves.
    """

    rows: str
    sh_degree: int
    origin: tuple[float, float, float]
    tile: int
    block: tuple[Part, ...]
    panes: tuple[tuple[int, str], ...]
    split: Split
    n_around: int
    n_levels: int
    n_layers: int
    may_be_late: bool
    up: str | tuple[float, float, float]
    effort: str | int = "default"
    shares: bool = False
    n_tiles: int = 1
    drawn: str | None = None

    def splats(self) -> SplatParams:
        """Those of the tile, in an order that does not depend on that of the rows."""
        splats = SplatParams.from_channels(sorted_rows(self.rows, self.sh_degree).T)
        return bounded_opacities(splats)

    def stand_ins(self) -> list[SplatParams]:
        """What stands for each tile of the neighbourhood, from the origin of the first."""
        return [self._stand_ins([part], self.block[0][0]) for part in self.block]

    def of_others(self) -> SplatParams:
        """What stands for the other tiles, from the origin of this one."""
        return self._stand_ins([part for part in self.block if part[0] != self.tile], self.tile)

    def around(self, splats: SplatParams) -> Standing:
        """Where cameras stand around splats."""
        effort = Effort.of(self.effort)
        return Standing.around(
            splats,
            up=self.up,
            n_views=min(MAX_VIEWS, effort.n_views),
            all_round=effort.all_round,
            pixels=effort.pixels,
        )

    def around_block(self, of_block: SplatParams) -> Standing:
        """Where cameras stand around the neighbourhood, seen from the origin of the tile."""
        own = {tile: offset for tile, _, offset in self.block}[self.tile]
        return self.around(of_block).seen_from(np.array(own))

    def _stand_ins(self, parts: Sequence[Part], origin: int) -> SplatParams:
        """What stands for these tiles, from the origin of one of the neighbourhood."""
        offsets = {tile: np.array(offset) for tile, _, offset in self.block}
        found = [np.empty((0, n_channels(self.sh_degree)), np.float32)]
        for tile, path, _ in parts:
            rows = sorted_rows(path, self.sh_degree)
            rows[:, 0:3] += (offsets[tile] - offsets[origin]).astype(np.float32)
            found.append(rows)
        return enlarged(SplatParams.from_channels(np.concatenate(found).T), SPLATS_OF_STAND_IN)


def sorted_rows(path: str, sh_degree: int) -> F32:
    """(n, D) rows of a file, sorted."""
    d = n_channels(sh_degree)
    rows = np.fromfile(path, "<f4").reshape(-1, d)
    order = np.argsort(np.ascontiguousarray(rows).view(f"S{4 * d}")[:, 0], kind="stable")
    return rows[order].astype(np.float32)
