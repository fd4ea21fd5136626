"""Layers of precision: all splats come at coarse steps first, then refinements of the leaves.

A level cannot look much more like the scene than its splats allow, however exact they are, so bits
are better spent on the splats of the next level until all are there. Each layer after the first is
a level of its own (spec 3.4) whose steps refine every leaf and split none.

Letters: K classes (spec 3.2), N leaves of a tile, B components.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from evogs_codec.encoding.late_level import LateLevel, can_be_late
from evogs_codec.encoding.packet_order import leaf_shares
from evogs_codec.encoding.sensitivity import Importance, StepWeights
from evogs_codec.errors import InputError
from evogs_codec.format.write_directory import MAX_LEVELS
from evogs_codec.model.channels import (
    GROUP_CHANNELS,
    N_GROUPS,
    channel_class,
    group_of_class,
    n_channels,
)
from evogs_codec.model.coded_tree import CodedStep, CodedTree
from evogs_codec.model.components import PICKS, component_slice
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32, F64, I64
from evogs_codec.model.tree import EvolutionTree, Step

__all__ = ["MAX_LAYERS", "N_LAYERS", "Layered", "Layering", "expect_levels"]

MAX_LAYERS = 8
N_LAYERS = 2  # by default
RATIO = 128.0  # of the price of a bit, from a layer to the next: about 20 dB; by default
FINER = 2.8  # than of psi of one leaf: steps of what siblings share, whose errors meet
PARTS, LEAST = 16, 2048  # steps of a layer of a tile at most, and leaves of each at least
FAMILY = 256  # leaves of neighbouring ancestors that are in the same step: siblings need each other


@dataclass(frozen=True)
class Layering:
    """How a tree becomes layers.

    Attributes:
        n: layers, at least 1.
        ratio: of the price of a bit, from a layer to the next.
        is_late: the last level of the tree comes with the second layer, if it can (`late_level`).
    """

    n: int
    ratio: float = RATIO
    is_late: bool = False


@dataclass(frozen=True, eq=False)
class Layered:
    """A tree whose leaves are refined in layers.

    Attributes:
        tiles: arranged, with the steps of the layers, whose psi are 0: a closed loop gives them
            what earlier layers left.
        n_levels: with those of the layers.
        n_coarse: levels of the first layer.
        importance: of the tree without layers.
        leaves: (n_parts,) per tile, rows of the tile's leaves that each step of a layer refines.
        siblings: (n_parts,) per tile, of these leaves.
        ratio: of the price of a bit, from a layer to the next.
        rooms: per tile, steps before those of the layers that only make room: of the last level of
            the tree, if it comes late (`late_level`), as the first level of the second layer.
    """

    tiles: Sequence[EvolutionTree]
    n_levels: int
    n_coarse: int
    importance: Importance
    leaves: Sequence[Sequence[I64]]
    siblings: Sequence[Sequence[Siblings]]
    ratio: float
    rooms: Sequence[int]

    @staticmethod
    def of(
        tiles: Sequence[EvolutionTree],
        n_levels: int,
        importance: Importance,
        layering: Layering,
    ) -> Layered:
        """Layers after the first refine the most important leaves first."""
        n_layers = layering.n
        is_late = layering.is_late and n_layers > 1 and can_be_late(tiles, n_levels)
        n_coarse = n_levels - is_late
        levels = range(n_coarse, n_coarse + n_layers - 1)
        found, parts, siblings, rooms = [], [], [], []
        for tile, weights in zip(tiles, importance.leaves, strict=True):
            slots, born_from, ancestors = _leaves_of(tile)
            rows = _parts(weights, ancestors)
            late = LateLevel.of(tile, n_coarse) if is_late and tile.steps else None
            coarse = tile if late is None else late.tile
            steps = _steps(coarse, slots, rows, levels, late)
            found.append(replace(coarse, steps=(*coarse.steps, *steps)))
            parts.append(rows)
            siblings.append([Siblings.of(slots[part], born_from) for part in rows])
            rooms.append(0 if late is None else late.n_rooms)
        n_all = n_coarse + n_layers - 1
        return Layered(found, n_all, n_coarse, importance, parts, siblings, layering.ratio, rooms)

    def prices(self, price: float) -> list[float]:
        """Of a bit, per layer; the last has `price`."""
        n_layers = 1 + self.n_levels - self.n_coarse
        return [price * self.ratio**k for k in reversed(range(n_layers))]

    def steps(self, price: float, extent: float) -> F64:
        """(1 + n_levels, K) steps of adds, then of psi per level, in scene units.

        Those of a layer are those of the last level over an odd number, nearly, as grids round
        them: what a coarse step of that level leaves is then a whole number of the finer ones.
        """
        first, *others = self.prices(price)
        table = self.importance.steps(first, extent)[: 1 + self.n_coarse]
        rows = [table]
        for other in others:
            wanted = self.importance.steps_of_leaves(other, extent) / FINER
            odd = 2 * np.rint((table[-1] / wanted - 1) / 2) + 1
            rows.append((table[-1] / np.maximum(odd, 1))[None])
        found: F64 = np.concatenate(rows)
        if self.importance.entries is not None:
            # No layer refines the entries of a palette: their steps are those of one layer.
            found[:, N_GROUPS:] = self.importance.steps(price, extent)[0, N_GROUPS:]
        return found

    def weights(self, price: float, extent: float) -> list[list[StepWeights | None]]:
        """What errors are worth at this price, per step of each tile: less in coarse layers."""
        parts = [price / other for other in self.prices(price)]
        first, *others = [np.float32(part) for part in parts]
        coarse = self.importance.raised(price / parts[0], extent)
        leaves = [self.importance.raised_leaves(price / part, extent) for part in parts[1:]]
        found: list[list[StepWeights | None]] = []
        for number, rows in enumerate(self.leaves):
            own = [w and w.times(first) for w in coarse[number][: self._n_first(number)]]
            own += [None] * self.rooms[number]
            for k, (other, weights) in enumerate(zip(others, leaves, strict=True)):
                less = weights[number] * other
                own += [
                    StepWeights(self.n_coarse + k, less[:, part], less[:, :0], siblings)
                    for part, siblings in zip(rows, self.siblings[number], strict=True)
                ]
            found.append(own)
        return found

    def with_gains(self, tree: CodedTree) -> CodedTree:
        """The coded tree with gains of the layers: what they change, by its importance."""
        tiles = []
        shares = leaf_shares(tree)
        for number, (tile, rows) in enumerate(zip(tree.tiles, self.leaves, strict=True)):
            weights = self.importance.leaves[number] / max(shares[number], 1e-300)
            n_first = self._n_first(number) + self.rooms[number]
            steps = list(tile.steps[:n_first])
            for k, step in enumerate(tile.steps[n_first:]):
                part = k % len(rows)
                gain = self._gains(tree, step, weights[:, rows[part]], self.siblings[number][part])
                steps.append(replace(step, gain=gain))
            tiles.append(replace(tile, steps=tuple(steps)))
        return replace(tree, tiles=tuple(tiles))

    def _n_first(self, tile: int) -> int:
        """Steps of a tile in the first layer."""
        return sum(step.level < self.n_coarse for step in self.tiles[tile].steps)

    def _gains(
        self, tree: CodedTree, step: CodedStep, weights: F32, siblings: Siblings
    ) -> tuple[float, ...]:
        """(B,) mean squared error that a step of a layer takes off, per component.

        What shows splats that were hidden is no error of theirs.
        """
        of_channels = np.zeros(len(step.psi))
        psi = step.psi.copy()
        of_siblings = list(step.siblings)
        psi[of_siblings] = siblings.sums(psi[of_siblings])
        for c in range(len(psi)):
            kind = channel_class(c)
            unit = (
                tree.quantisers[1 + step.level][kind].step
                * 2.0 ** -(tree.grid_exponents[group_of_class(kind)])
            )
            of_channels[c] = unit**2 * float(weights[kind] @ np.square(psi[c].astype(np.float32)))
        if any(self.rooms):
            of_channels[GROUP_CHANNELS[3]] = 0
        return tuple(
            # Picks are estimated as those of other levels are.
            step.gain[column]
            if component == PICKS
            else float(of_channels[component_slice(component)].sum())
            for column, component in enumerate(tree.components.of_tiles)
        )


def expect_levels(n_levels: int, n_layers: int) -> None:
    """Refuse layers that a stream has no levels for.

    Raises:
        InputError: they are too many beside the levels of the tree.
    """
    found = n_levels + n_layers - 1
    if found > MAX_LEVELS:
        raise InputError(
            f"a tree of {n_levels} levels in {n_layers} layers has {found} levels: a stream has at"
            f" most {MAX_LEVELS}"
        )


def _leaves_of(tile: EvolutionTree) -> tuple[I64, I64, I64]:
    """Slots (N,) of the leaves, where all slots were born from, and the first ancestors (N,)."""
    born_from, live = tile.lineage()
    ancestors = np.where(born_from < 0, np.arange(len(born_from)), born_from)
    while (born_from[ancestors] >= 0).any():
        ancestors = ancestors[ancestors]  # twice as far back each time
    slots = np.flatnonzero(live)
    return slots, born_from, ancestors[slots]


def _parts(weights: F32, ancestors: I64) -> list[I64]:
    """Rows of leaves with weights (K, N) for each step of a layer, the most important first.

    Leaves of one first ancestor (N,) are in the same step, and those of neighbours are.
    """
    n = weights.shape[1]
    if not n:
        return [np.empty(0, np.int64)]
    order = np.argsort(ancestors, kind="stable")
    begins = np.flatnonzero(np.diff(ancestors[order], prepend=-1))  # of the leaves of an ancestor
    starts = begins[np.flatnonzero(np.diff(begins // FAMILY, prepend=-1))]
    means = np.maximum(weights.mean(axis=1, keepdims=True), np.float32(1e-30))
    of_families = np.add.reduceat((weights / means).mean(axis=0)[order], starts)
    of_families /= np.diff(np.append(starts, n))
    n_parts = min(PARTS, max(1, n // LEAST))
    families = np.split(order, starts[1:])
    first = np.argsort(-of_families, kind="stable")
    return [
        np.sort(np.concatenate([families[k] for k in part]))
        for part in np.array_split(first, n_parts)
        if len(part)
    ]


def _steps(
    tile: EvolutionTree, slots: I64, parts: Sequence[I64], levels: range, late: LateLevel | None
) -> Iterator[Step]:
    """Steps that refine these parts of the leaves at each of the levels."""
    for level in levels:
        for part in parts:
            if late is not None and level == levels.start:
                step = Step.of_refines(level, slots[part], late.lacks[:, slots[part]])
                picks = late.picks[slots[part]] if len(late.picks) else late.picks
                yield replace(step, changed_picks=picks)
            else:
                psi = np.zeros((n_channels(tile.sh_degree), len(part)))
                yield Step.of_refines(level, slots[part], psi)
