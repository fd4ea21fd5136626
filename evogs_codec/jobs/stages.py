"""The stages of a tile: it is drawn for its neighbours, some are surveyed, and each is encoded.

Letters: K classes (spec 3.2), L levels with those of layers.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from evogs_codec.encoding.alpha_tables import weighted_alphas
from evogs_codec.encoding.grids import TooFineError
from evogs_codec.encoding.late_level import can_be_late
from evogs_codec.encoding.layers import Layered, Layering
from evogs_codec.encoding.packet_order import gains_of_tile
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.quantise import tiles_on
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.write import write
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.panes import Panes
from evogs_codec.jobs.picks import Unnumbered, unnumbered_of
from evogs_codec.jobs.plan import Needs, Plan, Survey
from evogs_codec.jobs.surroundings import price_of
from evogs_codec.jobs.tile_job import TileJob
from evogs_codec.jobs.weighed import Weighed, in_prices
from evogs_codec.model.channels import N_GROUPS, channel_class, group_of_class
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.splats import I32, I64, SplatParams
from evogs_codec.model.tree import EvolutionTree
from evogs_codec.scene.effort import Effort
from evogs_codec.scene.prefixes import TreePrefixes

__all__ = ["code_tile", "draw_tile", "survey_tile"]

MAX_ALPHAS = 4096  # of a level and group that a survey keeps


def draw_tile(job: TileJob, out: str) -> None:
    """Write the `Panes` of a tile to a file."""
    standing = job.around_block(SplatParams.joined(job.stand_ins()))
    Panes.of(job.splats(), standing.cameras, standing.options).write(Path(out))


def survey_tile(job: TileJob, out: str, *, known: Weighed | None = None) -> None:
    """Write the `Survey` of a tile to a file; `known` is the tile."""
    tile = known or Weighed.of(job)
    prepared, n_shown = tile.prepared, tile.n_shown
    price = Effort.of(job.effort).price * price_of(n_shown)
    late = None
    gain = np.inf
    looks = prepared.layered is not None and Effort.of(job.effort).looks
    if looks and job.may_be_late and can_be_late(prepared.tiles, job.n_levels):
        layered = _layered(prepared, job, is_late=True)
        late = _needs(prepared, layered, layered.tiles, price)
        gain = _gain_of_last(prepared, price)
    plain = _needs(prepared, prepared.layered, prepared.tiles, price)
    sharing = tile.sharing(job.splats(), price) if job.shares else None
    if job.drawn is not None:
        tile.keep_drawn(Path(job.drawn))
    Survey(plain, late, gain, sharing).write(Path(out))


def code_tile(
    job: TileJob, plan: Plan, out: str, *, known: Weighed | None = None
) -> TooFineError | None:
    """Write the stream of a tile to a file, and its gains beside it, which `merge` reads.

    With a palette the stream is of core alone, and beside it is what the tile picks (`Unnumbered`).

    Args:
        job: the tile.
        plan: what all tiles have in common.
        out: the file.
        known: the tile without a palette.

    Returns:
        None; or what is too fine for a number of the tile, and nothing is written.
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
    except TooFineError as error:
        return _of_plan(error, own)
    try:
        tile = _on_the_grid(found[0], own)
    except TooFineError as error:
        return error.with_traceback(None)  # which has the whole tree
    coded = plan.coded(grid, found)
    coded = layered.with_gains(coded) if layered else coded
    coded = prepared.gains.rescale(coded) if prepared.gains else coded
    gains = gains_of_tile(coded, coded.tiles[0])
    moved = _moved(tile, [round(x * 2.0 ** plan.exponents[0]) for x in job.origin])
    of_stream = replace(coded, tiles=(moved,), quantisers=plan.quantisers)
    if shared is not None:
        picks = Unnumbered.of(tile, shared.keys, in_prices(importance, price))
        picks.write(unnumbered_of(Path(out)))
        of_stream = _of_core(of_stream)
    data = write(of_stream, zstd_level=Effort.of(job.effort).zstd_level)
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
        every = max(1, len(alphas) // MAX_ALPHAS)
        kept[place] = alphas[::every], weights[::every]
    source = layered or _importance(prepared)
    return Needs(source.steps(price, prepared.ranges.extent), kept)


def _gain_of_last(prepared: Prepared, price: float) -> float:
    """By how many dB the last level looks better than the one before it, at coarse steps."""
    views = prepared.task.ordering
    assert views is not None, "there are views"
    draft, last = TreePrefixes(prepared.coarse(price)), prepared.n_levels - 1
    cuts = [draft.of_level(level) for level in (last - 1, last)]
    before, after = map(views.psnr, draft.shown(cuts, prepared.task.tree.shown_degree))
    return after - before


def _importance(prepared: Prepared) -> Importance:
    assert prepared.importance is not None, "there are views"
    return prepared.importance


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


def _on_the_grid(tile: CodedTile, shifts: I64) -> CodedTile:
    """A tile whose steps are 2**shifts (1 + L, K) of those of the stream, in these.

    Raises:
        TooFineError: a number has more than 24 bits then.
    """
    if not shifts.any():
        return tile
    steps = []
    for step in tile.steps:
        classes = [channel_class(c) for c in range(len(step.psi))]
        psi, adds = (
            _shifted(numbers, shifts[row, classes], row)
            for numbers, row in ((step.psi, 1 + step.level), (step.adds, 0))
        )
        steps.append(replace(step, psi=psi, adds=adds))
    return replace(tile, steps=tuple(steps))


def _of_plan(error: TooFineError, shifts: I64) -> TooFineError:
    """An error of a tile on the grid with these shifts, as one of the steps of the stream."""
    if error.row is None:
        return TooFineError(error.group)
    times = {kind: own * 2.0 ** int(shifts[error.row, kind]) for kind, own in error.times.items()}
    return TooFineError(error.group, error.row, times)


def _shifted(numbers: I32, by: I64, row: int) -> I32:
    """Integers (D, n) times 2**by (D,), which quantisers of a row have."""
    found = numbers.astype(np.int64) << by[:, None]
    largest = np.abs(found).max(axis=1, initial=0)
    for channel in np.flatnonzero(largest >= 1 << 23).tolist():
        times = 2.0 ** math.ceil(math.log2((largest[channel] + 1) / (1 << 23)))
        kind = channel_class(channel)
        raise TooFineError(group_of_class(kind), row, {kind: times})
    return found.astype(np.int32)
