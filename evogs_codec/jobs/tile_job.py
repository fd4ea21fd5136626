"""Tile jobs: what is done to a tile, from the bytes of its rows to those of a stream.

A job needs its arguments and nothing else, so that it gives the same bytes wherever it runs, and
may be run again.

Letters: K classes (spec 3.2), L levels with those of layers.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from evogs_codec.encoding.alpha_tables import weighted_alphas
from evogs_codec.encoding.grids import TooFineError
from evogs_codec.encoding.late_level import can_be_late
from evogs_codec.encoding.layers import Layered, Layering
from evogs_codec.encoding.missed import MEASURING
from evogs_codec.encoding.packet_order import gains_of_tile
from evogs_codec.encoding.palette_worth import bits_of_picks, bits_of_psi
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.quantise import tiles_on
from evogs_codec.encoding.sensitivity import SEEN_OF_CIRCLE, Importance
from evogs_codec.encoding.settings import Settings
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.encoding.write import write
from evogs_codec.io.files import write_atomic
from evogs_codec.io.finite import bounded_opacities
from evogs_codec.jobs.panes import Panes, between
from evogs_codec.jobs.partition import STAND_IN, Split
from evogs_codec.jobs.picks import Unnumbered, unnumbered_of
from evogs_codec.jobs.plan import Needs, Plan, Sharing, Survey
from evogs_codec.jobs.surroundings import (
    NearAndWide,
    Neighbourhood,
    Standing,
    enlarged,
    is_apart,
    near_middle,
    price_of,
)
from evogs_codec.lifting.coarse_entries import CoarseEntries
from evogs_codec.lifting.lift import Lifted, lift_with_order
from evogs_codec.lifting.shared_sh import SharedSh, coarse_sh, in_palette
from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS, channel_class, n_channels
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.splats import F32, SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.effort import Effort
from evogs_codec.scene.prefixes import TreePrefixes

__all__ = ["TileJob", "Weighed", "code_tile", "draw_tile", "sorted_rows", "survey_tile"]

VIEWS = 12  # of a tile, by which its numbers are weighed
ALPHAS = 4096  # of a level and group that a survey keeps
# What it costs to move a splat by its own size, in prices of a bit before the factor of an effort:
# few are moved by a third of it.
KEEP = 10.0
SEEN = 0.99  # as of `sensitivity`, which has less: positions that no view shows have `KEEP`, too


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
        has_palette: the SH above band 0 of all splats of the stream are in a palette; of a survey.
        n_tiles: of the stream.
    """

    rows: str
    sh_degree: int
    origin: tuple[float, float, float]
    tile: int
    block: tuple[tuple[int, str, tuple[float, float, float]], ...]
    panes: tuple[tuple[int, str], ...]
    split: Split
    n_around: int
    n_levels: int
    n_layers: int
    may_be_late: bool
    up: str | tuple[float, float, float]
    effort: str | int = "default"
    has_palette: bool = False
    n_tiles: int = 1


def draw_tile(job: TileJob, out: str) -> None:
    """Write the `Panes` of a tile to a file."""
    standing = _standing(job, _of_block(job))
    Panes.of(_splats(job), standing.cameras, standing.options).write(Path(out))


@dataclass(frozen=True, eq=False)
class Weighed:
    """A tile, lifted and weighed: most of what a job does.

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

        Where the job says that there is a palette, entries are for those of the tile alone.
        """
        splats = _splats(job)
        lifted = lift_with_order(
            splats, job.n_levels, n_neighbours=Effort.of(job.effort).n_neighbours
        )
        tree, shared = lifted.tree, None
        if job.has_palette:
            coarse = CoarseEntries.of(coarse_sh(tree), len(splats))
        if coarse is not None:
            tree, shared = _sharing(lifted, splats, coarse)
        return Weighed(lifted, *_prepared(job, splats, tree), shared)


def survey_tile(job: TileJob, out: str, *, known: Weighed | None = None) -> None:
    """Write the `Survey` of a tile to a file; `known` is the tile without a palette."""
    tile = known or Weighed.of(job)
    prepared, n_shown = tile.prepared, tile.n_shown
    price = Effort.of(job.effort).price * price_of(n_shown)
    sharing = late = None
    gain = np.inf
    looks = prepared.layered is not None and Effort.of(job.effort).looks
    if looks and job.may_be_late and can_be_late(prepared.tiles, job.n_levels):
        layered = _layered(prepared, job, is_late=True)
        late = _needs(prepared, layered, layered.tiles, price)
        gain = _gain_of_last(prepared, price)
    if job.has_palette:
        importance = _importance(prepared)
        worth = _in_prices(importance, price)
        sharing = Sharing(
            coarse_sh(tile.lifted.tree),
            worth.sum(axis=1, dtype=np.float64),
            bits_of_picks(prepared.aim.tree, np.arange(1 + worth.shape[1])),
            bits_of_psi(tile.lifted.tree, importance, price),
        )
    plain = _needs(prepared, prepared.layered, prepared.tiles, price)
    Survey(plain, late, gain, sharing).write(Path(out))


def code_tile(job: TileJob, plan: Plan, out: str, *, known: Weighed | None = None) -> int | None:
    """Write the stream of a tile to a file, and its gains beside it, which `merge` reads.

    With a palette the stream is of core alone, and beside it is what the tile picks (`Unnumbered`).

    Args:
        job: the tile.
        plan: what all tiles have in common.
        out: the file.
        known: the tile without a palette.

    Returns:
        None; or the group whose grid is too fine for a number of the tile, and nothing is written.
    """
    weighed = known or Weighed.of(job, plan.coarse)
    prepared, n_shown, shared = weighed.prepared, weighed.n_shown, weighed.shared
    price = Effort.of(job.effort).price * price_of(n_shown)
    extent = prepared.ranges.extent
    layered, importance = prepared.layered, _importance(prepared)
    if layered is not None:
        layered = _layered(prepared, job, is_late=plan.is_late)
    plain = importance.at(price)
    own = plan.coarser((layered or plain).steps(price, extent))
    weights = layered.weights(price, extent) if layered else plain.raised(price, extent)
    tiles = layered.tiles if layered else prepared.tiles
    grid = plan.grid(own)
    try:
        found = tiles_on(tiles, grid, plan.alpha, plan.settings, weights=weights, price=price)
        tile = _on_the_grid(found[0], own)
    except TooFineError as error:
        return error.group
    coded = plan.coded(grid, found)
    coded = layered.with_gains(coded) if layered else coded
    coded = prepared.gains.rescale(coded) if prepared.gains else coded
    gains = gains_of_tile(coded, coded.tiles[0])
    moved = _moved(tile, [round(x * 2.0 ** plan.exponents[0]) for x in job.origin])
    of_stream = replace(coded, tiles=(moved,), quantisers=plan.quantisers)
    if shared is not None:
        picks = Unnumbered.of(tile, shared.keys, _in_prices(importance, price))
        picks.write(unnumbered_of(Path(out)))
        of_stream = _of_core(of_stream)
    data = write(of_stream, effort=Effort.of(job.effort).level)
    gained = io.BytesIO()
    # What views gain counts as much as all the splats for which they are.
    np.save(gained, np.concatenate([[[n_shown] * gains.steps.shape[1]], gains.steps]))
    write_atomic(f"{out}.gains", gained.getvalue())
    write_atomic(out, data)
    return None


def _layered(prepared: Prepared, job: TileJob, *, is_late: bool) -> Layered:
    """A tile in layers; one without a last level has nothing that comes late."""
    layering = Layering(job.n_layers, is_late=is_late)
    n_coarse, n_others = job.n_levels - is_late, job.n_tiles - 1
    return Layered(prepared.tiles, n_coarse, _importance(prepared), layering, n_others)


def _needs(
    prepared: Prepared, layered: Layered | None, tiles: Sequence[EvolutionTree], price: float
) -> Needs:
    """What the tile would have on its own, in these layers; `tiles` has its alphas."""
    kept = {}
    for place, (alphas, weights) in weighted_alphas(tiles).items():
        every = max(1, len(alphas) // ALPHAS)
        kept[place] = alphas[::every], weights[::every]
    source = layered or _importance(prepared)
    return Needs(source.steps(price, prepared.ranges.extent), kept)


def _gain_of_last(prepared: Prepared, price: float) -> float:
    """By how many dB the last level looks better than the one before it, at coarse steps."""
    views = prepared.aim.ordering
    assert views is not None, "there are views"
    draft, last = TreePrefixes(prepared.coarse(price)), prepared.n_levels - 1
    cuts = [draft.of_level(level) for level in (last - 1, last)]
    before, after = map(views.psnr, draft.shown(cuts, prepared.aim.tree.shown_degree))
    return after - before


def _importance(prepared: Prepared) -> Importance:
    assert prepared.importance is not None, "there are views"
    return prepared.importance


def _in_prices(importance: Importance, price: float) -> F32:
    """(degree, n) what errors of entries cost, in prices of a bit."""
    assert importance.entries is not None, "the tree has a palette"
    found: F32 = (importance.entries / np.float64(price)).astype(np.float32)
    return found


def _of_core(tree: CodedTree) -> CodedTree:
    """The tree without its picks and its palette."""
    tiles = []
    for tile in tree.tiles:
        steps = [
            replace(
                step,
                picks=step.picks[:0],
                changed_picks=step.changed_picks[:0],
                error=step.error[:1],
                gain=step.gain[:1],
            )
            for step in tile.steps
        ]
        tiles.append(replace(tile, steps=tuple(steps)))
    quantisers = tuple(row[:N_GROUPS] for row in tree.quantisers)
    return replace(tree, sh_degree=0, quantisers=quantisers, tiles=tuple(tiles), entries=None)


def _moved(tile: CodedTile, way: Sequence[int]) -> CodedTile:
    """A tile elsewhere, by so many grid units along each axis."""
    x, y, z = (a + b for a, b in zip(tile.origin, way, strict=True))
    return replace(tile, origin=(x, y, z))


def _sharing(
    lifted: Lifted, splats: SplatParams, coarse: CoarseEntries
) -> tuple[EvolutionTree, SharedSh]:
    """The tree of splats with their SH in a palette, behind entries for coarse splats."""
    shared = SharedSh.of(splats)
    assert shared is not None, "it was looked for"
    tree = in_palette(lifted, shared.palette(splats.sh_degree), shared.vector_of, coarse)
    return tree, shared


def _prepared(job: TileJob, splats: SplatParams, tree: EvolutionTree) -> tuple[Prepared, int]:
    """The tree of a tile, arranged and weighed; and how many splats its views are for."""
    effort = Effort.of(job.effort)
    views = _views(job, splats)
    aim = TargetEncoder(
        tree,
        Settings.by_views(np.zeros((0, 0))),
        views,
        layers=job.n_layers,
        ordering=views.fewer(effort.n_ordering_views),
        measuring=None if effort.by_leaves else views.fewer(MEASURING),
        by_leaves=effort.by_leaves,
        seen=SEEN if effort.all_round else SEEN_OF_CIRCLE,
        n_tiles=1,
        n_levels=job.n_levels,
    )
    return aim.prepared, views.n_shown


def _splats(job: TileJob) -> SplatParams:
    """In an order that does not depend on that of the rows."""
    splats = SplatParams.from_channels(sorted_rows(job.rows, job.sh_degree).T)
    return bounded_opacities(splats)


def _views(job: TileJob, splats: SplatParams) -> Neighbourhood | NearAndWide:
    """Those of its neighbourhood; of a tile that is apart, views of its own as well."""
    of_block = _of_block(job)
    wide = _wide_views(job, splats, of_block) if len(of_block) else None
    if wide is not None and not is_apart(splats, of_block):
        return wide
    standing = _around(job, near_middle(splats))
    others = _stand_ins(job, [part for part in job.block if part[0] != job.tile], job.tile)
    near = Neighbourhood.of(splats, standing, len(splats), keep=KEEP, around=others)
    return near if wide is None else NearAndWide(near, wide)


def _wide_views(job: TileJob, splats: SplatParams, of_block: SplatParams) -> Neighbourhood:
    """Views of the neighbourhood, with panes of the other tiles."""
    standing = _standing(job, of_block)
    eyes = np.array([camera.position for camera in standing.cameras]) + job.origin
    panes = {tile: Path(path) for tile, path in job.panes}
    around = between(job.tile, job.split, panes, standing.cameras, eyes, standing.background)
    return Neighbourhood.of(splats, standing, job.n_around, keep=KEEP, between=around)


def _standing(job: TileJob, of_block: SplatParams) -> Standing:
    """Where cameras stand around a neighbourhood, seen from the origin of the tile."""
    own = {tile: offset for tile, _, offset in job.block}[job.tile]
    return _around(job, of_block).seen_from(np.array(own))


def _around(job: TileJob, splats: SplatParams) -> Standing:
    effort = Effort.of(job.effort)
    return Standing.around(
        splats,
        up=job.up,
        n_views=min(VIEWS, effort.n_views),
        all_round=effort.all_round,
        pixels=effort.pixels,
    )


def _of_block(job: TileJob) -> SplatParams:
    """What stands for the tiles of a neighbourhood, from the origin of the first."""
    return _stand_ins(job, job.block, job.block[0][0])


def _stand_ins(
    job: TileJob, parts: Sequence[tuple[int, str, tuple[float, float, float]]], origin: int
) -> SplatParams:
    """What stands for these tiles, from the origin of one of the neighbourhood."""
    offsets = {tile: np.array(offset) for tile, _, offset in job.block}
    found = [np.empty((0, n_channels(job.sh_degree)), np.float32)]
    for tile, path, _ in parts:
        rows = sorted_rows(path, job.sh_degree)
        rows[:, 0:3] += (offsets[tile] - offsets[origin]).astype(np.float32)
        found.append(rows)
    return enlarged(SplatParams.from_channels(np.concatenate(found).T), STAND_IN)


def sorted_rows(path: str, sh_degree: int) -> F32:
    """(n, D) rows of a file, sorted."""
    d = n_channels(sh_degree)
    rows = np.fromfile(path, "<f4").reshape(-1, d)
    order = np.argsort(np.ascontiguousarray(rows).view(f"S{4 * d}")[:, 0], kind="stable")
    return rows[order].astype(np.float32)


def _on_the_grid(tile: CodedTile, shifts: tuple[int, ...]) -> CodedTile:
    """A tile whose steps are 2**shifts of those of the stream, per class, in these."""
    if not any(shifts):
        return tile
    steps = []
    for step in tile.steps:
        by_channel = np.array([shifts[channel_class(c)] for c in range(len(step.psi))])[:, None]
        psi, adds = (
            step.psi.astype(np.int64) << by_channel,
            step.adds.astype(np.int64) << by_channel,
        )
        for group, part in enumerate(GROUP_CHANNELS):
            for numbers in (psi[part], adds[part]):
                if np.abs(numbers).max(initial=0) >= 1 << 23:
                    raise TooFineError(group)
        steps.append(replace(step, psi=psi.astype(np.int32), adds=adds.astype(np.int32)))
    return replace(tile, steps=tuple(steps))
