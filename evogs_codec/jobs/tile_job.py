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
from evogs_codec.encoding.packet_order import gains_of_tile
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.quantise import quantise_on
from evogs_codec.encoding.settings import ALPHA_BITS, N_ALPHA, Settings, StepTable
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.encoding.write import write
from evogs_codec.io.files import write_atomic
from evogs_codec.io.finite import bounded_opacities
from evogs_codec.jobs.partition import STAND_IN
from evogs_codec.jobs.plan import Plan, Survey
from evogs_codec.jobs.surroundings import Neighbourhood, enlarged, price_of
from evogs_codec.lifting.lift import lift
from evogs_codec.model.channels import GROUP_CHANNELS, channel_class, n_channels
from evogs_codec.model.coded_tree import CodedTile
from evogs_codec.model.splats import F32, F64, SplatParams
from evogs_codec.scene.effort import Effort

__all__ = ["TileJob", "code_tile", "sorted_rows", "survey_tile"]

VIEWS = 12  # of a tile, by which its numbers are weighed
ALPHAS = 4096  # of a level and group that a survey keeps
# Prices of a bit that it costs to move a splat by its own size: few are moved by a fifth of it.
KEEP = 20.0
SEEN = 0.95  # of the worth of a number; stand-ins show less of what is hidden than splats do
SEEN_OF_CIRCLE = 0.9  # the same, where no view stands below or far above


@dataclass(frozen=True)
class TileJob:
    """A tile, and how it is encoded.

    Attributes:
        rows: file of (n, D) float32, positions from `origin`.
        sh_degree: of its splats.
        origin: scene units.
        stand_ins: file of the splats that stand for the tile in the views of others.
        around: the same of each other tile of the neighbourhood, and where the origins of these
            tiles are from that of this one.
        n_around: splats of the neighbourhood, those of this tile among them.
        n_levels: of the tree.
        n_layers: of precision.
        up: what is up in views, an axis or a vector.
        effort: as of `encode_scene`.
    """

    rows: str
    sh_degree: int
    origin: tuple[float, float, float]
    stand_ins: str
    around: tuple[tuple[str, tuple[float, float, float]], ...]
    n_around: int
    n_levels: int
    n_layers: int
    up: str | tuple[float, float, float]
    effort: str | int = "default"


def survey_tile(job: TileJob, out: str) -> None:
    """Write the `Survey` of a tile to a file."""
    prepared, n_shown = _prepared(job)
    kept = {}
    for place, (alphas, weights) in weighted_alphas(prepared.tiles).items():
        every = max(1, len(alphas) // ALPHAS)
        kept[place] = alphas[::every], weights[::every]
    Survey(_steps(prepared, price_of(n_shown)), kept).write(Path(out))


def code_tile(job: TileJob, plan: Plan, out: str) -> int | None:
    """Write the stream of a tile to a file, and its gains beside it (`gains_of`).

    Returns:
        None; or the group whose grid is too fine for a number of the tile, and nothing is written.
    """
    prepared, n_shown = _prepared(job)
    price, extent = price_of(n_shown), prepared.ranges.extent
    own = plan.coarser(_steps(prepared, price))
    layered, importance = prepared.layered, prepared.importance
    assert importance is not None, "there are views"
    weights = layered.weights(price, extent) if layered else importance.raised(price, extent)
    tiles = layered.tiles if layered else prepared.tiles
    try:
        coded = quantise_on(
            tiles, plan.grid(own), plan.alpha, plan.settings, weights=weights, price=price
        )
        tile = _on_the_grid(coded.tiles[0], own)
    except TooFineError as error:
        return error.group
    coded = layered.with_gains(coded) if layered else coded
    coded = prepared.shown.rescale(coded) if prepared.shown else coded
    gains = gains_of_tile(coded, coded.tiles[0])
    moved = _moved(tile, [round(x * 2.0 ** plan.exponents[0]) for x in job.origin])
    of_stream = replace(coded, tiles=(moved,), quantisers=plan.quantisers, info=plan.info)
    data = write(of_stream, effort=Effort.of(job.effort).level)
    found = io.BytesIO()
    # What views gain counts as much as all the splats for which they are.
    np.save(found, np.concatenate([[[n_shown] * gains.steps.shape[1]], gains.steps]))
    write_atomic(f"{out}.gains", found.getvalue())
    write_atomic(out, data)
    return None


def _moved(tile: CodedTile, way: Sequence[int]) -> CodedTile:
    """A tile elsewhere, by so many grid units along each axis."""
    x, y, z = (a + b for a, b in zip(tile.origin, way, strict=True))
    return replace(tile, origin=(x, y, z))


def _prepared(job: TileJob) -> tuple[Prepared, int]:
    """The tile, lifted, arranged and weighed; and how many splats its views are for."""
    splats = _splats(job)
    own, around = _stand_ins([(job.stand_ins, (0.0,) * 3)], job), _stand_ins(job.around, job)
    effort = Effort.of(job.effort)
    n_views = min(VIEWS, effort.n_views)
    views = Neighbourhood.of(
        splats,
        own,
        around,
        job.n_around,
        up=job.up,
        n_views=n_views,
        all_round=effort.all_round,
        keep=KEEP,
    ).within(effort.pixels)
    aim = TargetEncoder(
        lift(splats, job.n_levels, n_neighbours=effort.n_neighbours),
        Settings(StepTable(()), n_alpha=N_ALPHA, alpha_bits=ALPHA_BITS),
        views,
        layers=job.n_layers,
        ordering=views.fewer(effort.n_band_views),
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


def _stand_ins(
    files: Sequence[tuple[str, tuple[float, float, float]]], job: TileJob
) -> SplatParams:
    """What stands for tiles, whose origins are so far from that of the job."""
    parts = [np.empty((0, n_channels(job.sh_degree)), np.float32)]
    for path, offset in files:
        rows = sorted_rows(path, job.sh_degree)
        rows[:, 0:3] += np.array(offset, np.float32)
        parts.append(rows)
    return enlarged(SplatParams.from_channels(np.concatenate(parts).T), STAND_IN)


def sorted_rows(path: str, sh_degree: int) -> F32:
    """(n, D) rows of a file, sorted."""
    d = n_channels(sh_degree)
    rows = np.fromfile(path, "<f4").reshape(-1, d)
    order = np.argsort(np.ascontiguousarray(rows).view(f"S{4 * d}")[:, 0], kind="stable")
    return rows[order].astype(np.float32)


def _steps(prepared: Prepared, price: float) -> F64:
    """(1 + L, K) that the tile would have on its own, in scene units."""
    source = prepared.layered or prepared.importance
    assert source is not None, "there are views, or what stands for them"
    return source.steps(price, prepared.ranges.extent)


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
