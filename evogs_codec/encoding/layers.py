"""Layers of precision: all splats come at coarse steps first, then refinements of the leaves.

A level cannot look much more like the scene than its splats allow, however exact they are, so bits
are better spent on the splats of the next level until all are there. Each layer after the first is
a level of its own (spec 3.4) whose steps refine every leaf and split none.

Letters: K classes (spec 3.2), N leaves of a tile, B components.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from evogs_codec.encoding.late_level import LateLevel, can_be_late
from evogs_codec.encoding.layer_parts import (
    MAX_PARTS,
    first_ancestors,
    most_late_parts,
    parts_of_leaves,
)
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

__all__ = [
    "MAX_LAYERS",
    "N_LAYERS",
    "PRICE_RATIO",
    "Layered",
    "Layering",
    "expect_levels",
    "in_odd_numbers",
]

MAX_LAYERS = 8
N_LAYERS = 2  # by default
PRICE_RATIO = 192.0  # of the price of a bit, from a layer to the next: about 20 dB; by default
FINER_SHARED = 2.8  # than of psi of one leaf: steps of what siblings share, whose errors meet
PRICE_RATIO_BETWEEN = 36.0  # the same between later layers, where `scene.falls.steady` adds a third
EVENING_POWER = 0.5  # power of the weights of leaves in layers before the last: see `_evened`


@dataclass(frozen=True)
class Layering:
    """How a tree becomes layers.

    Attributes:
        n: layers, at least 1.
        ratio: of the price of a bit, from the first layer to the second.
        is_late: the last level of the tree comes with the second layer, if it can (`late_level`).
        between: of the price of a bit, from a later layer to the next.
    """

    n: int
    ratio: float = PRICE_RATIO
    is_late: bool = False
    between: float = PRICE_RATIO

    def prices(self, price: float) -> list[float]:
        """Of a bit, per layer; the last has `price`."""
        found = [price * self.between**k for k in reversed(range(self.n - 1))]
        return [found[0] * self.ratio, *found] if found else [price]


@dataclass(frozen=True, eq=False)
class _Tile:
    """A tile with the steps of its layers.

    Attributes:
        tree: the tile; psi of layers are 0, since a closed loop gives them what earlier ones left.
        n_first: steps of the first layer.
        places: of each step after these, which further layer and which part it refines; None of one
            that only makes room.
        leaves: (n_parts,) rows of the leaves that each part has, in the order of its records.
        siblings: (n_parts,) of these leaves.
        order: (n,) the number that each slot had before; None if all have theirs.
    """

    tree: EvolutionTree
    n_first: int
    places: Sequence[tuple[int, int] | None]
    leaves: Sequence[I64]
    siblings: Sequence[Siblings]
    order: I64 | None = None

    @staticmethod
    def of(
        tile: EvolutionTree, weights: F32, n_coarse: int, layering: Layering, n_tiles: int
    ) -> _Tile:
        """A tile, one of so many, of which this many levels are in the first layer."""
        is_late = tile.n_levels > n_coarse
        born_from, live = tile.lineage()
        ancestors = first_ancestors(born_from)
        slots: I64 = np.flatnonzero(live)
        most = most_late_parts(layering.n, n_tiles) if is_late else MAX_PARTS
        rows = parts_of_leaves(weights, ancestors[slots], most)
        late = order = None
        if is_late:
            part_of = np.zeros(len(live), np.int64)
            for k, part in enumerate(rows):
                part_of[ancestors[slots[part]]] = k
            late = LateLevel.of(tile, n_coarse, part_of[ancestors])
            tile, order, slots = late.tile, late.order, late.name[slots].astype(np.int64)
            born_from, _ = tile.lineage()
            rows = [part[np.argsort(slots[part])] for part in rows]
        parts = [slots[part] for part in rows]
        n_first = _n_until(tile, n_coarse)
        added = list(_steps(tile, n_first, parts, range(n_coarse, n_coarse + layering.n - 1), late))
        return _Tile(
            replace(tile, steps=(*tile.steps[:n_first], *(step for step, _ in added))),
            n_first,
            [place for _, place in added],
            rows,
            [Siblings.of(part, born_from) for part in parts],
            order,
        )


@dataclass(frozen=True, eq=False)
class Layered:
    """A tree whose leaves are refined in layers.

    Attributes:
        plain: its arranged tiles, without layers.
        n_coarse: levels of the first layer.
        importance: of the tree without layers.
        layering: how many layers there are, at which prices of a bit.
        n_elsewhere: tiles of the stream beside these.
    """

    plain: Sequence[EvolutionTree]
    n_coarse: int
    importance: Importance
    layering: Layering
    n_elsewhere: int = 0

    @staticmethod
    def of(
        tiles: Sequence[EvolutionTree],
        n_levels: int,
        importance: Importance,
        layering: Layering,
    ) -> Layered:
        """Layers after the first refine the most important leaves first."""
        is_late = layering.is_late and layering.n > 1 and can_be_late(tiles, n_levels)
        return Layered(tiles, n_levels - is_late, importance, layering)

    @cached_property
    def of_tiles(self) -> list[_Tile]:
        """Arranged, with the steps of the layers."""
        n_tiles = len(self.plain) + self.n_elsewhere
        return [
            _Tile.of(tile, weights, self.n_coarse, self.layering, n_tiles)
            for tile, weights in zip(self.plain, self.importance.leaves, strict=True)
        ]

    @property
    def coarse_tiles(self) -> list[EvolutionTree]:
        """With the steps of the first layer."""
        return [
            replace(tile, steps=tile.steps[: _n_until(tile, self.n_coarse)], quanta=())
            for tile in self.plain
        ]

    def coarse_weights(self, price: float, extent: float) -> list[list[StepWeights | None]]:
        """What `weights` are of the steps of `coarse_tiles`."""
        part = price / self.layering.prices(price)[0]
        found = []
        for tile, own in zip(
            self.plain,
            self.importance.at(price / part).raised(price / part, extent),
            strict=True,
        ):
            first = own[: _n_until(tile, self.n_coarse)]
            found.append([weights and weights.times(np.float32(part)) for weights in first])
        return found

    @property
    def tiles(self) -> list[EvolutionTree]:
        """With the steps of the layers."""
        return [tile.tree for tile in self.of_tiles]

    @property
    def n_levels(self) -> int:
        """With those of the layers."""
        return self.n_coarse + self.layering.n - 1

    @property
    def orders(self) -> list[I64 | None]:
        """Per tile, the number (n,) that each slot had before; None if all have theirs."""
        return [tile.order for tile in self.of_tiles]

    @cached_property
    def _makes_room(self) -> bool:
        """Whether some steps of the layers only make room."""
        return any(None in tile.places for tile in self.of_tiles)

    def steps(self, price: float, extent: float) -> F64:
        """(1 + n_levels, K) steps of adds, then of psi per level, in scene units.

        Those of the last coarse level are an odd number of those of a layer, nearly, as grids round
        them: what a coarse step leaves is then a whole number of the finer ones.
        """
        first, *others = self.layering.prices(price)
        table = self.importance.at(first).steps(first, extent)[: 1 + self.n_coarse]
        wanted = [
            self.importance.at(other).steps_of_leaves(other, extent) / FINER_SHARED
            for other in others
        ]
        found = np.vstack([table, *wanted])
        found[self.n_coarse :] = in_odd_numbers(found[self.n_coarse :])
        if self.importance.entries is not None:
            # No layer refines the entries of a palette: their steps are those of one layer.
            found[:, N_GROUPS:] = self.importance.at(price).steps(price, extent)[0, N_GROUPS:]
        return found

    def weights(self, price: float, extent: float) -> list[list[StepWeights | None]]:
        """What errors are worth at this price, per step of each tile: less in coarse layers."""
        factors = [price / other for other in self.layering.prices(price)[1:]]
        leaves = [
            self.importance.at(price / factor).raised_leaves(price / factor, extent)
            for factor in factors
        ]
        found = self.coarse_weights(price, extent)
        for number, tile in enumerate(self.of_tiles):
            own = found[number]
            for place in tile.places:
                if place is None:
                    own.append(None)
                    continue
                layer, part = place
                weights = leaves[layer][number][:, tile.leaves[part]] * np.float32(factors[layer])
                if layer < len(factors) - 1:
                    weights = _evened(weights)
                siblings = tile.siblings[part]
                own.append(StepWeights(self.n_coarse + layer, weights, weights[:, :0], siblings))
        return found

    def with_gains(self, tree: CodedTree) -> CodedTree:
        """The coded tree with gains of the layers: what they change, by its importance."""
        tiles = []
        shares = leaf_shares(tree)
        for number, (coded, tile) in enumerate(zip(tree.tiles, self.of_tiles, strict=True)):
            weights = self.importance.leaves[number] / max(shares[number], 1e-300)
            steps = list(coded.steps)
            for k, place in enumerate(tile.places, start=tile.n_first):
                if place is not None:
                    _, part = place
                    of_part = weights[:, tile.leaves[part]]
                    gain = self._gains(tree, steps[k], of_part, tile.siblings[part])
                    steps[k] = replace(steps[k], gain=gain)
            tiles.append(replace(coded, steps=tuple(steps)))
        return replace(tree, tiles=tuple(tiles))

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
        if self._makes_room:
            of_channels[GROUP_CHANNELS[3]] = 0
        return tuple(
            # Picks are estimated as those of other levels are.
            step.gain[column]
            if component == PICKS
            else float(of_channels[component_slice(component)].sum())
            for column, component in enumerate(tree.components.of_tiles)
        )


def in_odd_numbers(steps: F64) -> F64:
    """Steps (1 + layers, K) of the last coarse level and of the layers, as they are to be.

    Those of the last layer stay. Those of the coarse level become the odd number of these that
    comes nearest, of each class, and those of other layers are these over an odd number.
    """
    found: F64 = steps.copy()
    found[0] = steps[-1] * _nearest_odd(steps[0] / steps[-1])
    found[1:] = found[0] / _nearest_odd(found[0] / steps[1:])
    return found


def _nearest_odd(times: F64) -> F64:
    """Odd numbers, at least 1, nearest to others."""
    found: F64 = np.maximum(2 * np.rint((times - 1) / 2) + 1, 1)
    return found


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


def _n_until(tile: EvolutionTree, level: int) -> int:
    """Steps of a tile before a level."""
    return sum(step.level < level for step in tile.steps)


def _evened(weights: F32) -> F32:
    """Weights (K, P) of a layer before the last, nearer to their means.

    A number that matters little is worth no bit yet, and what it lacks goes on to the next layer as
    a large integer among small ones, which is dear. So it gets some of its bits early.
    """
    means = weights.mean(axis=1, keepdims=True)
    powers = np.power(weights, np.float32(EVENING_POWER))
    found: F32 = powers * (means / np.maximum(powers.mean(axis=1, keepdims=True), 1e-30))
    return found


def _steps(
    tile: EvolutionTree, n_first: int, parts: Sequence[I64], levels: range, late: LateLevel | None
) -> Iterator[tuple[Step, tuple[int, int] | None]]:
    """Steps that refine these slots at each of the levels, and their places.

    Where the last level is late, each part of the first of these has its room before it.
    """
    end = n_first
    for layer, level in enumerate(levels):
        for part, slots in enumerate(parts):
            if late is None or layer:
                psi = np.zeros((n_channels(tile.sh_degree), len(slots)))
                yield Step.of_refines(level, slots, psi), (layer, part)
                continue
            begin, end = end, end + late.n_rooms[part]
            for room in tile.steps[begin:end]:
                yield room, None
            step = Step.of_refines(level, slots, late.lacks[:, slots])
            picks = late.picks[slots] if len(late.picks) else late.picks
            yield replace(step, changed_picks=picks), (layer, part)
