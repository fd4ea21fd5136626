"""A tile, lifted and weighed by views of it among its neighbours: most of what a job does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.drawn import Drawn
from evogs_codec.encoding.error_factors import N_MEASURING_VIEWS
from evogs_codec.encoding.palette_worth import bits_of_picks, bits_of_psi
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.sensitivity import SEEN_SHARE_OF_CIRCLE, Importance
from evogs_codec.encoding.settings import Settings
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.panes import between
from evogs_codec.jobs.plan import Sharing
from evogs_codec.jobs.scratch_files import arrays_of
from evogs_codec.jobs.surroundings import (
    NearAndWide,
    Neighbourhood,
    is_apart,
    near_middle,
    part_shown,
)
from evogs_codec.jobs.tile_job import TileJob
from evogs_codec.lifting.coarse_entries import CoarseEntries
from evogs_codec.lifting.lift import Lifted, lift_with_order
from evogs_codec.lifting.shared_sh import SharedSh, coarse_sh, in_palette
from evogs_codec.model.splats import F32, SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.effort import Effort

__all__ = ["MOVE_PRICE", "Weighed", "in_prices"]

# What it costs to move a splat by its own size, in prices of a bit before the factor of an effort:
# few are moved by a third of it.
MOVE_PRICE = 10.0
# As of `sensitivity`, which has less: positions that no view shows have `MOVE_PRICE`, too.
SEEN_SHARE = 0.99


@dataclass(frozen=True, eq=False)
class Weighed:
    """A tile, lifted and weighed.

    Attributes:
        lifted: the tree, whose splats have SH of their own.
        prepared: that tree, or one with a palette, arranged and weighed.
        n_shown: splats for which the views are.
        shared: what splats share of a palette.
    """

    lifted: Lifted
    prepared: Prepared
    n_shown: int
    shared: SharedSh | None

    @staticmethod
    def of(job: TileJob, coarse: CoarseEntries | None = None) -> Weighed:
        """The tile of a job; with a palette if there are entries for the coarse splats of all.

        Without one it is not drawn if that was done for its survey.
        """
        splats = job.splats()
        lifted = lift_with_order(
            splats, job.n_levels, n_neighbours=Effort.of(job.effort).n_neighbours
        )
        if coarse is not None:
            tree, shared = _sharing(lifted, splats, coarse)
            return Weighed(lifted, *_prepared(job, splats, tree), shared)
        drawn = None
        if job.drawn is not None and Path(job.drawn).exists():
            with arrays_of(Path(job.drawn)) as found:
                drawn = Drawn.of_arrays(found)
        return Weighed(lifted, *_prepared(job, splats, lifted.tree, drawn), None)

    def keep_drawn(self, path: Path) -> None:
        """Write what pictures tell, for the next time that the tile is weighed."""
        arrays = self._drawn.arrays()
        write_atomic(path, lambda file: np.savez(file, allow_pickle=False, **arrays))

    def sharing(self, splats: SplatParams, price: float) -> Sharing:
        """What the tile tells of a palette.

        It is drawn with SH splat by splat. With a palette only coarse splats look otherwise.

        Args:
            splats: of the tile; they share their SH.
            price: of a bit.
        """
        tree = self.lifted.tree
        coarse = CoarseEntries.of(coarse_sh(tree), len(splats))
        other, _ = _sharing(self.lifted, splats, coarse)
        importance = Importance.of_cuts(
            arrange(other, 1),
            self.prepared.n_levels,
            self._drawn.cuts,
            seen=self.prepared.task.seen,
        )
        worth = in_prices(importance, price)
        return Sharing(
            coarse_sh(tree),
            worth.sum(axis=1, dtype=np.float64),
            bits_of_picks(other, np.arange(1 + worth.shape[1])),
            bits_of_psi(tree, importance, price),
        )

    @property
    def _drawn(self) -> Drawn:
        assert self.prepared.drawn is not None, "there are views"
        return self.prepared.drawn


def in_prices(importance: Importance, price: float) -> F32:
    """(degree, n) what errors of entries cost, in prices of a bit."""
    assert importance.entries is not None, "the tree has a palette"
    found: F32 = (importance.entries / np.float64(price)).astype(np.float32)
    return found


def _sharing(
    lifted: Lifted, splats: SplatParams, coarse: CoarseEntries
) -> tuple[EvolutionTree, SharedSh]:
    """The tree of splats with their SH in a palette, behind entries for coarse splats."""
    shared = SharedSh.of(splats)
    assert shared is not None, "it was looked for"
    tree = in_palette(lifted, shared.palette(splats.sh_degree), shared.vector_of, coarse)
    return tree, shared


def _prepared(
    job: TileJob, splats: SplatParams, tree: EvolutionTree, drawn: Drawn | None = None
) -> tuple[Prepared, int]:
    """The tree of a tile, arranged and weighed; and how many splats its views are for."""
    effort = Effort.of(job.effort)
    views = _views(job, splats)
    encoder = TargetEncoder(
        tree,
        Settings.by_views(np.zeros((0, 0))),
        views,
        layers=job.n_layers,
        ordering=views.fewer(effort.n_ordering_views),
        measuring=None if effort.by_leaves else views.fewer(N_MEASURING_VIEWS),
        by_leaves=effort.by_leaves,
        seen=SEEN_SHARE if effort.all_round else SEEN_SHARE_OF_CIRCLE,
        drawn=drawn,
        n_tiles=1,
        n_levels=job.n_levels,
    )
    return encoder.prepared, views.n_shown


def _views(job: TileJob, splats: SplatParams) -> Neighbourhood | NearAndWide:
    """Those of its neighbourhood; of a tile that is apart, views of its own as well."""
    stand_ins = job.stand_ins()
    of_block = SplatParams.joined(stand_ins)
    wide = _wide_views(job, splats, stand_ins) if len(of_block) else None
    if wide is not None and not is_apart(splats, of_block):
        return wide
    standing = job.around(near_middle(splats))
    near = Neighbourhood.of(splats, standing, len(splats), keep=MOVE_PRICE, around=job.of_others())
    return near if wide is None else NearAndWide(near, wide)


def _wide_views(
    job: TileJob, splats: SplatParams, stand_ins: Sequence[SplatParams]
) -> Neighbourhood:
    """Views of the neighbourhood, with panes of the other tiles."""
    standing = job.around_block(SplatParams.joined(stand_ins))
    n_shown = round(job.n_around * part_shown(stand_ins))
    eyes = np.array([camera.position for camera in standing.cameras]) + job.origin
    panes = {tile: Path(path) for tile, path in job.panes}
    around = between(job.tile, job.split, panes, standing.cameras, eyes, standing.background)
    return Neighbourhood.of(splats, standing, n_shown, keep=MOVE_PRICE, between=around)
