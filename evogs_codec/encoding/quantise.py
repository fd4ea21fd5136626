"""Quantising a tree: floats to the integers of a stream (spec 7.3), on a grid that holds them.

tree, settings -> grid, tables of alpha -> each tile in a `closed_loop` -> CodedTree
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from evogs_codec.common.parallel import parallel_map
from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.encoding.alpha_tables import alpha_tables
from evogs_codec.encoding.closed_loop import TileCoder
from evogs_codec.encoding.coarse_leaves import warn_of_coarse_leaves
from evogs_codec.encoding.grids import (
    Grid,
    TooFineError,
    grid_exponents,
    warn_if_coarser,
    warn_if_moved,
    with_a_coarser_row,
    with_fewer_units,
)
from evogs_codec.encoding.packet_gains import LeafTracker
from evogs_codec.encoding.palette_entries import coded_entries, quantised_entries, renumbered
from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.encoding.settings import Settings
from evogs_codec.model.arithmetic import AlphaTable
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32
from evogs_codec.model.tree import EvolutionTree

__all__ = ["quantise", "quantise_on", "tiles_on"]


def quantise(
    tiles: Sequence[EvolutionTree],
    n_levels: int,
    settings: Settings,
    *,
    weights: Sequence[Sequence[StepWeights | None]] | None = None,
    entry_weights: F32 | None = None,
    price: float = 1.0,
    ranges: Ranges | None = None,
    info: SceneInfo | None = None,
    estimates: bool = True,
    progress: Progress | None = None,
) -> CodedTree:
    """The coded tree of arranged tiles.

    Args:
        tiles: what to quantise.
        n_levels: of the tree.
        settings: how.
        weights: importance of each step of each tile; then bits are saved where they do little. A
            step that has None keeps its alphas and multiples of steps as they are.
        entry_weights: (degree, n) likewise of the entries of a palette, per SH band.
        price: mean squared error that a bit is worth.
        ranges: of the tiles, if they are known.
        info: metadata.
        estimates: steps have errors and gains; without, their packets have no order.
        progress: called with the stage "quantise" and the part of it that is done.

    Raises:
        NotRepresentableError: values too large for any grid.
    """
    sh_degree = tiles[0].sh_degree
    ranges = ranges or Ranges.of(tiles, n_levels)
    steps = settings.accuracy.wanted_steps(ranges, n_levels)
    exponents = grid_exponents(settings, ranges, steps)
    alpha = alpha_tables(tiles, settings)
    own = steps
    while True:
        grid = Grid.of(sh_degree, exponents, own, settings)
        try:
            coded = quantise_on(
                tiles,
                grid,
                alpha,
                settings,
                weights=weights,
                entry_weights=entry_weights,
                price=price,
                info=info,
                estimates=estimates,
                progress=progress,
            )
        except TooFineError as error:
            if error.row is None or not settings.closed_loop or settings.is_near_lossless:
                exponents = with_fewer_units(exponents, error.group)
            else:
                own = with_a_coarser_row(own, grid, error)
            continue
        if own is steps:
            warn_if_coarser(grid, steps, settings)
        else:
            warn_of_coarse_leaves(tiles, grid.quantisers, grid.exponents, steps, weights)
        warn_if_moved(steps, settings, ranges)
        return coded


def quantise_on(
    tiles: Sequence[EvolutionTree],
    grid: Grid,
    alpha: dict[tuple[int, int], AlphaTable],
    settings: Settings,
    *,
    weights: Sequence[Sequence[StepWeights | None]] | None = None,
    entry_weights: F32 | None = None,
    price: float = 1.0,
    info: SceneInfo | None = None,
    estimates: bool = True,
    progress: Progress | None = None,
) -> CodedTree:
    """`quantise` on a grid that is known, with these tables of alphas.

    Raises:
        TooFineError: a number leaves its range on this grid.
    """
    palette = tiles[0].palette
    if palette is not None:
        q = quantised_entries(palette, grid, entry_weights, price)
    coded = tiles_on(
        tiles,
        grid,
        alpha,
        settings,
        weights=weights,
        price=price,
        estimates=estimates,
        progress=progress,
    )
    tree = CodedTree(
        sh_degree=tiles[0].shown_degree,
        n_levels=len(grid.quantisers) - 1,
        grid_exponents=grid.exponents,
        quantisers=grid.quantisers,
        alpha=alpha,
        tiles=tuple(coded),
        info=info or SceneInfo(),
    )
    if palette is None:
        return tree
    entries = coded_entries(q, palette.n_coarse, coded)
    return replace(
        tree,
        tiles=tuple(renumbered(tile, entries.number) for tile in coded),
        entries=entries.q,
        entry_levels=entries.levels,
        entry_uses=entries.uses,
    )


def tiles_on(
    tiles: Sequence[EvolutionTree],
    grid: Grid,
    alpha: dict[tuple[int, int], AlphaTable],
    settings: Settings,
    *,
    weights: Sequence[Sequence[StepWeights | None]] | None = None,
    price: float = 1.0,
    estimates: bool = True,
    progress: Progress | None = None,
) -> list[CodedTile]:
    """The tiles of `quantise_on`, whose picks are among the entries of the palette of the trees.

    Raises:
        TooFineError: a number leaves its range on this grid.
    """
    report = progress or no_progress

    def code(number: int) -> CodedTile:
        own = None if weights is None else weights[number]
        tracker = LeafTracker(tiles[number], grid) if estimates else None
        return TileCoder(tiles[number], grid, alpha, settings, own, price, tracker).code()

    coded = []
    for one in parallel_map(code, range(len(tiles))):
        coded.append(one)
        report("quantise", len(coded) / len(tiles))
    return coded
