"""Polishing: integers of the last level, moved by gradient descent until pictures err less.

Rounding is decided number by number, as if errors did not meet; in pictures they add up or cancel.
Descent finds integers whose errors cancel, and counts the bits that larger integers take. Zeros
stay zero: they save most of the bits.

Letters: D channels, n slots of a tile, N splats, P refines and splits of a step, S splits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.encoding.pictures import Pictures
from evogs_codec.encoding.write import write
from evogs_codec.format.planes import MAX_STORED
from evogs_codec.model.arithmetic import RangeError, StepPlan, apply_channel
from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS, channel_class, group_of_class
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32, F64, I32, SplatParams
from evogs_codec.model.tree import take_picks

__all__ = ["polished"]

RATE, LAST_RATE = 0.1, 0.01  # of an integer, at the first and the last iteration
BETA1, BETA2, EPS = 0.9, 0.99, 1e-20
MIN_MEAN = 0.3  # mean |q| of a row, below which no bits are told from


def polished(
    tree: CodedTree,
    pictures: Pictures,
    price: float,
    iterations: int,
    progress: Callable[[float], None],
) -> CodedTree:
    """The tree with integers of its last level that pictures like better.

    Args:
        tree: as `quantise` makes it.
        pictures: of the scene.
        price: mean squared error of pictures that a bit is worth.
        iterations: a view each.
        progress: called with the part that is done.

    Hints (`CodedStep.error`, `gain`) stay those of the tree as it was.
    """
    last = tree.n_levels - 1
    steps = [step for tile in tree.tiles for step in tile.steps]
    if last == 0 or not any(step.level == last and step.psi.any() for step in steps):
        return tree
    data = write(tree, zstd_level=1, digests=False)
    before = decode(data, lambda directory: Cut.of_level(directory, last - 1))
    tiles = [
        _Tile(
            tree,
            tile,
            state.x[:, : state.n_slots],
            state.live[: state.n_slots],
            state.born_from[: state.n_slots],
        )
        for tile, state in zip(tree.tiles, before.tiles, strict=True)
    ]
    picked = [tile.picked() for tile in tiles]  # palettes do not move
    for t in range(iterations):
        leaves = [tile.leaves() for tile in tiles]
        shown = [np.concatenate(parts) for parts in zip(leaves, picked, strict=True)]
        splats = SplatParams.from_channels(np.concatenate(shown, axis=1))
        slopes = pictures.loss_gradient(splats, t)[: len(leaves[0])] / np.float32(price)  # in bits
        rate = RATE * (LAST_RATE / RATE) ** (t / iterations)
        ends = np.cumsum([part.shape[1] for part in leaves])
        for tile, part in zip(tiles, np.split(slopes, ends[:-1], axis=1), strict=True):
            tile.descend(part, rate, t + 1)
        progress((t + 1) / iterations)
    return replace(tree, tiles=tuple(tile.coded() for tile in tiles))


class _Tile:
    """A tile whose last level moves: in scene units, while it does."""

    def __init__(
        self,
        tree: CodedTree,
        tile: CodedTile,
        x: I32,
        live: npt.NDArray[np.bool_],
        born_from: I32,
    ) -> None:
        """From the (D, n) slots before the last level, which are live, whence they were born."""
        self.tree, self.tile, self.before, self.stays = tree, tile, x, False
        level, n = tree.n_levels - 1, x.shape[1]
        self.kinds = [channel_class(c) for c in range(len(x))]
        steps = [step for step in tile.steps if step.level == level]
        n_after = n + sum(step.alpha.shape[1] + step.adds.shape[1] for step in steps)
        self.x = np.zeros((len(x), n_after), np.float32)
        self.live = np.ones(n_after, bool)
        self.live[:n] = live
        scale = (
            2.0 ** -np.array([tree.grid_exponents[group_of_class(k)] for k in self.kinds])[:, None]
        )
        origin = np.zeros((len(x), 1))
        origin[0:3, 0] = tile.origin
        self.x[:, :n] = (x + origin) * scale
        self.moving: list[_Moving] = []
        for step in steps:
            plan = StepPlan.of(step.slots, step.kinds, n, step.adds.shape[1])
            adds = step.adds * self._units(0) + origin
            self.x[:, n + plan.n_splits : plan.n_after] = adds * scale
            self.live[plan.drops] = False
            tables = [tree.alpha_table(level, group).values for group in range(N_GROUPS)]
            alpha = [table[row] for table, row in zip(tables, step.alpha, strict=True)]
            sizes = self._units(1 + level) * scale
            siblings = Siblings.of(plan.target_slots, born_from) if step.siblings else None
            for earlier in self.moving:
                earlier.moves &= ~np.isin(earlier.plan.target_slots, plan.target_slots)
            self.moving.append(_Moving.of(step, plan, sizes, np.stack(alpha), siblings))
            n = plan.n_after

    def leaves(self) -> F32:
        """(D, N) what a decoder has, nearly: products of alpha are not rounded."""
        x = self.x.copy()
        try:
            for moving in self.moving:
                if not self.stays:
                    moving.check()
                moving.apply(x)
        except RangeError:
            self._put_back()
            return self.leaves()
        return x[:, self.live]

    def _put_back(self) -> None:
        """Every step as it was, for good."""
        self.stays = True
        level = self.tree.n_levels - 1
        rest = [step for step in self.tile.steps if step.level == level]
        for moving, step in zip(self.moving, rest, strict=True):
            moving.stay_at(step.psi)

    def picked(self) -> F32:
        """(C, N) SH of the leaves that a palette has; none of a tree without one."""
        palette = self.tree.palette()
        if palette is None:
            return np.empty((0, int(np.count_nonzero(self.live))), np.float32)
        picks, n = np.zeros(len(self.live), np.int32), 0
        for step in self.tile.steps:
            take_picks(step, picks, n)
            n += step.n_new
        return palette.sh_of(picks[self.live])

    def descend(self, slopes: F32, rate: float, t: int) -> None:
        """An iteration, from the slopes (D, N) of the leaves."""
        g = np.zeros_like(self.x)
        g[:, self.live] = slopes
        for moving in reversed(self.moving):
            moving.descend(g, rate, t)

    def coded(self) -> CodedTile:
        """The tile with the integers of now, or as it was if they are too large for the format."""
        try:
            return self.tile if self.stays else self._moved()
        except RangeError:
            return self.tile

    def _moved(self) -> CodedTile:
        level, n = self.tree.n_levels - 1, self.before.shape[1]
        x = np.zeros(self.x.shape, np.int32)
        x[:, :n] = self.before
        low, high = (np.array(box)[:, None] for box in (self.tile.box_min, self.tile.box_max))
        steps = [step for step in self.tile.steps if step.level < level]
        rest = self.tile.steps[len(steps) :]
        for moving, step in zip(self.moving, rest, strict=True):
            moving.check()
            psi = moving.psi()
            for c, kind in enumerate(self.kinds):
                table = self.tree.alpha_table(level, group_of_class(kind))
                a = np.array(table.entries, np.int32)[step.alpha[group_of_class(kind)]]
                of_psi, of_adds = (self.tree.quantisers[row][kind] for row in (1 + level, 0))
                deltas = of_psi.delta(psi[c]), of_adds.delta(step.adds[c])
                apply_channel(x[c], moving.plan, deltas[0], a, table.shift, deltas[1])
            x[:, moving.plan.drops] = 0
            steps.append(replace(step, psi=moving.integers()))
            written = (
                x[0:3, moving.plan.targets],
                x[0:3, moving.plan.n_before : moving.plan.n_after],
            )
            positions = np.concatenate([low, *written, high], axis=1)
            low, high = (f(positions, axis=1, keepdims=True) for f in (np.min, np.max))
        box_min, box_max = ((int(a), int(b), int(c)) for a, b, c in (low[:, 0], high[:, 0]))
        return replace(self.tile, box_min=box_min, box_max=box_max, steps=tuple(steps))

    def _units(self, row: int) -> F64:
        """(D, 1) grid units of a q, of adds or of psi of a level."""
        quantisers = self.tree.quantisers[row]
        return np.array([[quantisers[kind].step] for kind in self.kinds], np.float64)


@dataclass
class _Moving:
    """A step of the last level.

    Attributes:
        plan: where it acts.
        q: (D, P) what descends; the integers are the nearest to them.
        moves: (D, P) which do: those that are not zero, of records that no later step refines, and
            of a tile that does not stay as it was.
        sizes: (D, 1) of a q, in scene units.
        bits: (D, 1) by which an integer costs more than its neighbour towards 0.
        alpha: (5, S).
        m, v: moments, as of Adam.
        siblings: where q are their differences.
    """

    plan: StepPlan
    q: F32
    moves: npt.NDArray[np.bool_]
    sizes: F32
    bits: F32
    alpha: F32
    m: F32
    v: F32
    siblings: Siblings | None

    @staticmethod
    def of(
        step: CodedStep, plan: StepPlan, sizes: F64, alpha: F64, siblings: Siblings | None
    ) -> _Moving:
        """A step that has not moved yet."""
        q = step.psi.astype(np.float32)
        mean = np.abs(q).mean(axis=1, keepdims=True) if q.size else np.ones((len(q), 1))
        bits = 1 / np.log(2) / np.maximum(mean, MIN_MEAN)  # of a Laplace distribution
        m, v = np.zeros((2, *q.shape), np.float32)
        f32 = [x.astype(np.float32) for x in (sizes, bits, alpha)]
        return _Moving(plan, q, step.psi != 0, f32[0], f32[1], f32[2], m, v, siblings)

    def integers(self) -> I32:
        """(D, P)."""
        return np.rint(self.q).astype(np.int32)

    def psi(self) -> I32:
        """(D, P) what a decoder makes of the integers.

        Raises:
            RangeError: a sum of siblings is too large.
        """
        integers = self.integers()
        return integers if self.siblings is None else self.siblings.sums(integers)

    def check(self) -> None:
        """Refuse integers that are too large to be stored.

        Raises:
            RangeError: they are.
        """
        if np.abs(self.q).max(initial=0) > MAX_STORED // 2 - 1:
            raise RangeError("an integer needs more bits than are stored")

    def stay_at(self, integers: I32) -> None:
        """Have these (D, P) from now on."""
        self.q, self.moves = integers.astype(np.float32), np.zeros_like(self.moves)
        self.m, self.v = np.zeros((2, *self.q.shape), np.float32)

    def apply(self, x: F32) -> None:
        """Parents become children, in place; paper equations 3 to 5.

        Raises:
            RangeError: as `psi`.
        """
        plan, s = self.plan, self._splits
        integers = self.psi()
        for group, part in enumerate(GROUP_CHANNELS):
            psi = integers[part] * self.sizes[part]
            parents = x[part, plan.targets]
            x[part, self._new] = parents[:, s] - self.alpha[group] * psi[:, s]
            x[part, plan.targets] = parents + psi

    def descend(self, g: F32, rate: float, t: int) -> None:
        """Follow the slopes (D, n) after the step, in place of which come those before it."""
        plan, s = self.plan, self._splits
        stride = np.float32(rate / (1 - BETA1**t) * np.sqrt(1 - BETA2**t))
        for group, part in enumerate(GROUP_CHANNELS):
            first, second = g[part, plan.targets], g[part, self._new]
            slope = first.copy()
            slope[:, s] -= self.alpha[group] * second
            first[:, s] += second
            g[part, plan.targets] = first
            if self.siblings is not None:
                slope = self.siblings.slopes(slope)
            slope = self.sizes[part] * slope + self.bits[part] * np.sign(np.rint(self.q[part]))
            slope *= self.moves[part]
            m, v = self.m[part], self.v[part]
            m += (1 - BETA1) * (slope - m)
            v += (1 - BETA2) * (np.square(slope) - v)
            self.q[part] -= stride * m / (np.sqrt(v) + EPS)

    @property
    def _splits(self) -> npt.NDArray[np.int64] | slice:
        return slice(None) if self.plan.splits is None else self.plan.splits

    @property
    def _new(self) -> slice:
        return slice(self.plan.n_before, self.plan.n_before + self.plan.n_splits)
