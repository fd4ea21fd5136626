"""A tree that is to meet a target: arranged and weighed once, quantised as often as it takes."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.encoding.alpha_tables import with_used_entries
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.at_once import at_once
from evogs_codec.encoding.coarse_leaves import warn_of_coarse_leaves
from evogs_codec.encoding.drawn import Drawn
from evogs_codec.encoding.grids import AccuracyWarning
from evogs_codec.encoding.held_steps import Run, held
from evogs_codec.encoding.joined_steps import composed, joined_tiles
from evogs_codec.encoding.layers import Layered, Layering, expect_levels
from evogs_codec.encoding.measured_gains import MeasuredGains, nothing_of
from evogs_codec.encoding.pictures import Pictures, Telling
from evogs_codec.encoding.polish import polished
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.sensitivity import SEEN_SHARE, Importance, StepWeights, cuts_of
from evogs_codec.encoding.settings import ALPHA_BITS, N_ALPHA, Settings, StepTable
from evogs_codec.format.directory import Directory
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.components import component_classes
from evogs_codec.model.packet_id import PacketId
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, I64, SplatParams
from evogs_codec.model.tree import EvolutionTree

__all__ = ["EncodeTask", "Prepared"]


@dataclass(frozen=True)
class EncodeTask:
    """A tree, and by what it is encoded.

    Attributes:
        tree: any.
        settings: of which the level of Zstandard counts, and the steps where there are no views.
        views: of the splats that the tree is of, or None.
        polish: iterations of `polished`, where views decide; 0 for none.
        layers: of precision (`layers`), where views decide.
        leaf_error: (5,) per group, the largest distance of the tree's leaves from the splats that
            they stand for: `TargetEncoder.within` adds it to the error of the stream.
        ordering: a few views by which packets are put in order, where those that are drawn for the
            sensitivity do not tell; `views` by default.
        measuring: a few views by which is measured what estimates miss; None: it is not.
        by_leaves: only the last level is drawn, and only for what its numbers are worth.
        seen: part of the worth of a number that the views decide.
        drawn: what the views tell, where it is known.
        n_tiles, info, progress: as of `encode`.
        n_levels: of the tree at least, where a tile may have fewer.
        empty: packets of SH bands whose numbers are all 0, of the streams that are made.
        order: of the packets of these; None: that of `packet_order`.
    """

    tree: EvolutionTree
    settings: Settings
    views: Pictures | None = None
    polish: int = 0
    layers: int = 1
    leaf_error: tuple[float, ...] = (0.0,) * len(GROUPS)
    ordering: Pictures | None = None
    measuring: Pictures | None = None
    by_leaves: bool = False
    seen: float = SEEN_SHARE
    drawn: Drawn | None = None
    n_tiles: int | None = None
    info: SceneInfo | None = None
    progress: Progress | None = None
    n_levels: int = 1
    empty: frozenset[PacketId] = frozenset()
    order: tuple[PacketId, ...] | None = None


class Prepared:
    """A tree arranged once, and quantised as often as it takes."""

    def __init__(self, task: EncodeTask) -> None:
        self.task = task
        self.orders: Sequence[I64 | None] | None = None  # of slots, as of `EncodedScene`
        self.is_at_once = False
        self.written: tuple[bytes, CodedTree] | None = None  # the last stream, and what it is of
        self.n_levels = max(task.tree.n_levels, task.n_levels)
        if (task.polish or task.layers > 1) and task.views is None:
            raise ValueError(f"{'polishing needs' if task.polish else 'layers need'} views")
        if task.layers > 1:
            expect_levels(self.n_levels, task.layers)  # before anything is rendered
        self.polishes = task.polish > 0 and (self.n_levels > 1 or task.layers > 1)
        report = task.progress or no_progress
        report("arrange", 0.0)
        self.tiles = arrange(task.tree, task.n_tiles)
        self.ranges = Ranges.of(self.tiles, self.n_levels)
        self.importance = self.drawn = self.gains = self.layered = None
        if task.views is not None:
            report("draw", 0.0)
            if not task.by_leaves:  # levels are looked at later
                self._leaves = task.tree.shared_leaves()  # held, so that they are made once
            self.drawn = task.drawn or _drawn(task, task.views, self.tiles, self.n_levels)
            self.gains = self.drawn.gains
            self.importance = Importance.of_cuts(
                self.tiles, self.n_levels, self.drawn.cuts, seen=task.seen
            )
            if task.by_leaves:
                self.importance = self.importance.as_others()
            if task.measuring is not None and task.tree.n_leaves:
                self.importance = self.importance.measured(
                    self.tiles, task.measuring, self.ranges.extent, self.drawn.factors
                )
            if task.layers > 1 and task.tree.n_leaves:
                self.layered = Layered.of(
                    self.tiles, self.n_levels, self.importance, Layering(task.layers)
                )

    def holding(self, runs: Sequence[Run], layering: Layering) -> Prepared:
        """The same with other layers, or one, and without prefixes that end in runs of steps.

        The steps of a run are joined where that makes them fewer, and held back otherwise.
        """
        other = copy(self)
        if self.importance is None:
            return other
        for run in sorted(runs, key=lambda run: run.first, reverse=True):  # places of others stay
            other._end_prefixes_outside(run)
        if self.layered is not None and layering.n == 1:
            other.layered = None
        elif self.layered is not None:
            assert other.importance is not None, "it has that of this one"
            other.layered = Layered.of(other.tiles, self.n_levels, other.importance, layering)
        if any(tile is not own for tile, own in zip(other.tiles, self.tiles, strict=True)):
            other.ranges = Ranges.of(other.tiles, self.n_levels)
        return other

    def _end_prefixes_outside(self, run: Run) -> None:
        """Join the steps of a run, or hold them back."""
        own = self.importance
        assert own is not None, "views decide"
        found = joined_tiles(self.tiles, own.weights, run)
        if found is None:
            pairs = zip(self.tiles, own.weights, strict=True)
            tiles, weights = zip(*(held(*pair, [run]) for pair in pairs), strict=True)
            self.tiles, self.importance = list(tiles), replace(own, weights=weights)
            return
        self.tiles = [one.tile for one in found]
        self.orders = composed(self.orders or [None] * len(found), [one.order for one in found])
        leaves = tuple(one.leaves(of) for one, of in zip(found, own.leaves, strict=True))
        self.importance = replace(own, weights=tuple(one.weights for one in found), leaves=leaves)

    def at_once(self) -> Prepared:
        """The same with all leaves in the place of the roots at once, in one layer."""
        other = copy(self)
        if self.importance is None:
            return other
        own = self.importance
        found = list(map(at_once, self.tiles, own.weights, own.leaves))
        other.tiles = [tile for tile, _, _ in found]
        other.importance = replace(own, weights=tuple(weights for _, weights, _ in found))
        orders = [order for _, _, order in found]
        other.orders = composed(self.orders or [None] * len(orders), orders)
        other.is_at_once = True
        other.layered = None
        other.ranges = Ranges.of(other.tiles, self.n_levels)
        return other

    def coded(self, at: float) -> CodedTree:
        """At a price of a bit, or at a factor of the steps."""
        if self.importance is None:
            return self.quantised(self.task.settings.finer(1 / at))
        return self.quantised(self._settings(at), self._weights(at), at)

    def leaving_empty(self, task: EncodeTask) -> Prepared:
        """The same for an task that differs in its empty packets and the order of all."""
        other = copy(self)
        other.task = task
        return other

    def coarse(self, price: float) -> CodedTree:
        """What `coded` has of the first layer, with the same integers and no gains.

        Raises:
            ValueError: there is one layer.
        """
        if self.layered is None:
            raise ValueError("one layer has no coarse part")
        weights = self.layered.coarse_weights(price, self.ranges.extent)
        tiles = self.layered.coarse_tiles
        return self._quantised(tiles, self._settings(price), weights, price, estimates=False)

    def _weights(self, price: float) -> Sequence[Sequence[StepWeights | None]]:
        """Of the steps of each tile at a price of a bit."""
        assert self.importance is not None, "a price needs views"
        source = self.layered.weights if self.layered else self.importance.at(price).raised
        return _emptied(source(price, self.ranges.extent), self.task.empty)

    def _settings(self, price: float) -> Settings:
        """The settings, with steps by a price of a bit."""
        source = self.layered or (self.importance and self.importance.at(price))
        assert source is not None, "a price needs views"
        return replace(
            self.task.settings,
            accuracy=StepTable.of(source.steps(price, self.ranges.extent)),
            n_alpha=N_ALPHA,
            alpha_bits=ALPHA_BITS,
        )

    def polished(self, price: float) -> CodedTree:
        """At a price of a bit, the integers of the last level moved by pictures."""
        views, report = self.task.views, self.task.progress or no_progress
        assert views is not None, "polishing has views"
        return polished(
            self.coded(price), views, price, self.task.polish, lambda part: report("polish", part)
        )

    def quantised(
        self,
        settings: Settings,
        weights: Sequence[Sequence[StepWeights | None]] | None = None,
        price: float = 1.0,
    ) -> CodedTree:
        """With these settings."""
        tiles = self.layered.tiles if self.layered else self.tiles
        coded = self._quantised(tiles, settings, weights, price)
        if self.layered is not None:
            coded = self.layered.with_gains(coded)
        return self.gains.rescale(coded) if self.gains else coded

    def _quantised(
        self,
        tiles: Sequence[EvolutionTree],
        settings: Settings,
        weights: Sequence[Sequence[StepWeights | None]] | None,
        price: float,
        *,
        estimates: bool = True,
    ) -> CodedTree:
        """Steps of the tiles, all or the first."""
        with warnings.catch_warnings():
            # Of a search, and of drafts; of what is made, `warn_of_span` warns once.
            warnings.simplefilter("ignore", AccuracyWarning)
            coded = quantise(
                tiles,
                self.layered.n_levels if self.layered else self.n_levels,
                settings,
                weights=weights,
                entry_weights=self.importance.entries if weights and self.importance else None,
                price=price,
                ranges=self.ranges,  # layers move nothing
                info=self.task.info,
                estimates=estimates,
            )
        return with_used_entries(coded) if estimates else coded

    def warn_of_span(self, price: float, made: Directory) -> None:
        """Warn where values span so much that steps are coarser than this price of a bit asks.

        Args:
            price: of a bit.
            made: of the stream that was made.
        """
        n_levels = self.layered.n_levels if self.layered else self.n_levels
        steps = self._settings(price).accuracy.wanted_steps(self.ranges, n_levels)
        tiles = self.layered.tiles if self.layered else self.tiles
        weights = self._weights(price)
        warn_of_coarse_leaves(tiles, made.quantisers, made.grid_exponents, steps, weights)

    def wanted_steps(self) -> F64:
        """(1 + n_levels, K) steps of the settings."""
        return self.task.settings.accuracy.wanted_steps(self.ranges, self.n_levels)


def _emptied(
    weights: Sequence[Sequence[StepWeights | None]], empty: Collection[PacketId]
) -> Sequence[Sequence[StepWeights | None]]:
    """Weights of the steps of each tile with 0 for all numbers of these packets."""
    if not empty:
        return weights
    found = [list(steps) for steps in weights]
    for tile, component, step in empty:
        own = found[tile][step]
        if own is not None:
            found[tile][step] = own.without({kind for kind, _ in component_classes(component)})
    return found


def _drawn(
    task: EncodeTask, views: Pictures, tiles: Sequence[EvolutionTree], n_levels: int
) -> Drawn:
    """What the numbers of arranged tiles are worth, and what packets gain where that is drawn."""
    report = task.progress or no_progress
    weigh = partial(cuts_of, tiles, n_levels, seen=task.seen, progress=report)
    if task.by_leaves:
        return Drawn(weigh(views.sensitivity, first=n_levels - 1), None)
    if task.ordering is None or not isinstance(views, Telling):
        cuts = weigh(views.sensitivity)
        return Drawn(cuts, MeasuredGains.of(task.tree, task.ordering or views))
    told: list[float] = []

    def sensitivity(splats: SplatParams) -> F32:
        if len(told) == n_levels:  # of the last level, which nobody asks how it looks
            return views.sensitivity(splats)
        found, decibels = views.sensitivity_and_psnr(splats)
        told.append(decibels)
        return found

    sensitivity(nothing_of(task.tree.leaves(0)))
    cuts = weigh(sensitivity)
    shown = told if len(told) == n_levels else None  # of each level before, that has splats
    return Drawn(cuts, MeasuredGains.of(task.tree, task.ordering, shown))
