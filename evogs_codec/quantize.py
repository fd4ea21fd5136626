"""Quantising a tree in a closed loop: floats to the integers of a stream (spec 3.1, 5.3, 5.4, 7.3).

The encoder keeps the decoder's integers and aims at the float tree from there: psi mends what it
can of the error of a parent, and what it cannot mend is passed on but not magnified.

Letters: D channels, n slots, P refines and splits of a step, S splits. Everything here is in grid
units unless a name says otherwise.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from evogs_codec.coded import (
    CodedStep,
    CodedTile,
    CodedTree,
    channel_class,
    component_slice,
)
from evogs_codec.directory import UNKNOWN_ERROR, SceneInfo, n_classes
from evogs_codec.planes import MAX_STORED
from evogs_codec.refine import (
    MAX_PRODUCT,
    MAX_X,
    AlphaTable,
    Quantiser,
    RangeError,
    StepPlan,
    apply_channel,
)
from evogs_codec.settings import Settings
from evogs_codec.splats import F64, GROUP_CHANNELS, GROUPS, I32, I64, U8, n_channels
from evogs_codec.tree import N_GROUPS, EvolutionTree, Kind, Step

__all__ = ["AccuracyWarning", "NotRepresentable", "quantise"]

FINEST_STEP = 16  # grid units of the finest step: steps are then right to a few per cent
MAX_STATE = 1 << 27  # |X| aimed at: leaves room for errors and for Delta of adds (R-7.3-1)
MAX_EXACT = 1 << 22  # near-lossless: differences of two states fit 24 bits
ALPHA_RATE = 0.2  # error, in squared steps, that a bit of an alpha index is worth
NEAR = 0.999  # grid units that near-lossless coding leaves: 1 less what float64 may err
SAMPLE = 4096  # leaves of a tile that the error estimates look at


class NotRepresentable(ValueError):
    """The tree has numbers that no grid of the format holds."""


def quantise(
    tiles: Sequence[EvolutionTree],
    n_levels: int,
    settings: Settings,
    *,
    info: SceneInfo | None = None,
    progress: Callable[[float], None] | None = None,
) -> CodedTree:
    """The coded tree of arranged tiles.

    Raises:
        NotRepresentable: values too large for any grid.
    """
    sh_degree = tiles[0].sh_degree
    ranges = _Ranges.of(tiles, n_levels)
    steps = _steps(settings, ranges, n_levels)
    exponents = _grid_exponents(settings, ranges, steps)
    report = progress or (lambda _: None)
    while True:
        grid = _Grid.of(sh_degree, n_levels, exponents, steps, settings)
        alpha = _alpha_tables(tiles, settings)
        coded = []
        try:
            for k, tile in enumerate(tiles):
                report(k / len(tiles))
                coded.append(_TileCoder(tile, grid, alpha, settings).code())
        except _TooFine as error:
            if exponents[error.group] <= -16:
                raise NotRepresentable(
                    f"a value of group {error.group} is too large for any grid"
                ) from None
            exponents = tuple(e - (g == error.group) for g, e in enumerate(exponents))
            continue
        break
    _warn_if_coarser(grid, steps, settings)
    return CodedTree(
        sh_degree=sh_degree,
        n_levels=n_levels,
        grid_exponents=exponents,
        quantisers=grid.quantisers,
        alpha=alpha,
        tiles=tuple(coded),
        info=info or SceneInfo(),
    )


class AccuracyWarning(UserWarning):
    """Values span so much that a grid is coarser than the step asked for."""


def _warn_if_coarser(grid: _Grid, steps: F64, settings: Settings) -> None:
    if settings.near_lossless:
        return
    for group in range(N_GROUPS):
        asked = float(steps[:, group].min())
        got = min(row[group].step for row in grid.quantisers) * 2.0 ** -grid.exponents[group]
        if got > 1.1 * asked:
            warnings.warn(
                f"{GROUPS[group]}: values span so much that the step is {got:.3g}, not {asked:.3g}:"
                " drop outliers or use more tiles",
                AccuracyWarning,
                stacklevel=3,
            )


class _TooFine(Exception):  # noqa: N818  (not an error: the caller tries a coarser grid)
    """A number of this group leaves its range on its grid."""

    def __init__(self, group: int) -> None:
        super().__init__(group)
        self.group = group


# --- grids and steps -----------------------------------------------------------------------------


@dataclass(frozen=True)
class _Ranges:
    """What the grids must hold, in scene units.

    Attributes:
        extent: robust extent of the scene: the longest axis of its 1st to 99th percentiles.
        largest: per group the largest magnitude of a state; positions from the tile's middle.
        psi: [level][class] range of psi; [n_levels] of adds.
        middles: per tile the middle of its positions.
    """

    extent: float
    largest: tuple[float, ...]
    psi: tuple[tuple[float, ...], ...]

    @staticmethod
    def of(tiles: Sequence[EvolutionTree], n_levels: int) -> _Ranges:
        classes = n_classes(tiles[0].sh_degree)
        channels = [channel_class(c) for c in range(n_channels(tiles[0].sh_degree))]
        largest = [0.0] * N_GROUPS
        psi = np.zeros((n_levels + 1, classes, 2))
        leaves = []
        for tile in tiles:
            middle = _middle(tile)
            state = None
            for step, state in zip(tile.steps, tile.states(), strict=True):
                values = state.values
                for group, part in enumerate(GROUP_CHANNELS):
                    rows = values[part] - middle[:, None] if group == 0 else values[part]
                    if rows.size:
                        largest[group] = max(largest[group], float(np.abs(rows).max()))
                for row, numbers in ((step.level, step.psi), (n_levels, step.adds)):
                    if numbers.shape[1]:
                        for c, kind in enumerate(channels):
                            low, high = float(numbers[c].min()), float(numbers[c].max())
                            psi[row, kind, 0] = min(psi[row, kind, 0], low)
                            psi[row, kind, 1] = max(psi[row, kind, 1], high)
            if state is not None:
                leaves.append(state.values[0:3][:, state.live][:, ::16])
        points = np.concatenate([np.zeros((3, 0)), *leaves], axis=1)
        spread = np.ptp(np.percentile(points, (1, 99), axis=1), axis=0) if points.size else [0.0]
        return _Ranges(
            extent=float(np.max(spread)) or 1.0,
            largest=tuple(largest),
            psi=tuple(tuple(np.ptp(row, axis=1)) for row in psi),
        )


def _middle(tile: EvolutionTree) -> F64:
    """(3,) middle of the box of the adds of a tile; 0 without adds."""
    adds = [step.adds[0:3] for step in tile.steps if step.n_adds]
    if not adds:
        return np.zeros(3)
    low = np.min([part.min(1) for part in adds], axis=0).astype(np.float64)
    high = np.max([part.max(1) for part in adds], axis=0).astype(np.float64)
    return (low + high) / 2


def _steps(settings: Settings, ranges: _Ranges, n_levels: int) -> F64:
    """(1 + n_levels, classes) steps in scene units: of adds, then of psi per level."""
    classes = len(ranges.psi[0])
    if settings.range_bits:
        by_level = np.array([ranges.psi[n_levels], *ranges.psi[:n_levels]])
        by_level[:, 4:] = by_level[:, 4:].max(1, keepdims=True)  # a range per group
        by_level[0] /= 256
        # Where nothing changes any step will do: one that asks for no finer grid.
        by_level = np.where(by_level > 0, by_level, np.maximum(by_level.max(0), 1e-6))
        return by_level / (2**settings.range_bits - 1)
    base = np.array(settings.steps[:classes])
    if settings.relative:
        base[0] *= ranges.extent
    factor = np.array(settings.coarser[:classes])
    parts = np.where(factor > 0, factor, 1.0) ** np.arange(n_levels - 1, -1, -1)[:, None]
    shared = np.where(np.arange(classes) == 0, parts.sum(0), np.sqrt(np.square(parts).sum(0)))
    psi = base * parts / np.where(factor > 0, shared, 1.0)
    return np.concatenate([psi[:1] * settings.adds, psi])


def _grid_exponents(settings: Settings, ranges: _Ranges, steps: F64) -> tuple[int, ...]:
    """G per group: fine enough for the steps, coarse enough for the values."""
    exponents = []
    for group in range(N_GROUPS):
        finest = float(steps[:, group if group < 4 else slice(4, None)].min())
        limit = MAX_EXACT if settings.near_lossless else MAX_STATE
        room = limit / max(ranges.largest[group], 1e-300)
        wanted = 40 if settings.near_lossless else math.ceil(math.log2(FINEST_STEP / finest))
        exponent = min(wanted, math.floor(math.log2(room)), 40)
        if exponent < -16:
            raise NotRepresentable(
                f"a value of {ranges.largest[group]:.3g} is too large for any grid"
            )
        exponents.append(max(exponent, -16))
    return tuple(exponents)


def _quantiser(step: float) -> Quantiser:
    """The quantiser whose step is nearest to `step` grid units, at least 1."""
    shift = max(0, math.ceil(math.log2(max(step, 1.0) / 65535)))
    return Quantiser(max(1, round(step / (1 << shift))), min(shift, 24))


@dataclass(frozen=True)
class _Grid:
    """Grids and quantisers of a stream."""

    sh_degree: int
    exponents: tuple[int, ...]
    quantisers: tuple[tuple[Quantiser, ...], ...]
    scale: F64  # (D, 1) grid units of a scene unit
    classes: tuple[int, ...]  # per channel

    @staticmethod
    def of(
        sh_degree: int,
        n_levels: int,
        exponents: tuple[int, ...],
        steps: F64,
        settings: Settings,
    ) -> _Grid:
        classes = tuple(channel_class(c) for c in range(n_channels(sh_degree)))
        by_class = np.array([2.0 ** exponents[min(k, 4)] for k in range(steps.shape[1])])
        units = np.ones_like(steps) if settings.near_lossless else steps * by_class
        return _Grid(
            sh_degree=sh_degree,
            exponents=exponents,
            quantisers=tuple(tuple(_quantiser(u) for u in row) for row in units.tolist()),
            scale=np.array([[2.0 ** exponents[min(k, 4)]] for k in classes]),
            classes=classes,
        )

    def channel_quantisers(self, row: int) -> list[Quantiser]:
        return [self.quantisers[row][kind] for kind in self.classes]


# --- alpha ---------------------------------------------------------------------------------------


def _alpha_tables(
    tiles: Sequence[EvolutionTree], settings: Settings
) -> dict[tuple[int, int], AlphaTable]:
    """Tables per (level, group); none where alpha is 1."""
    tables = {}
    levels = sorted({step.level for tile in tiles for step in tile.steps})
    for level in levels:
        steps = [step for tile in tiles for step in tile.steps if step.level == level]
        for group, part in enumerate(GROUP_CHANNELS):
            alphas = np.concatenate([np.empty(0), *(step.alpha[group] for step in steps)])
            weights = np.concatenate([np.empty(0), *(_psi_energy(step, part) for step in steps)])
            table = _alpha_table(alphas[weights > 0], weights[weights > 0], settings)
            if table is not None:
                tables[level, group] = table
    return tables


def _psi_energy(step: Step, part: slice) -> F64:
    """(S,) squared length of psi of the splits, in a group."""
    is_split = step.kinds[step.kinds != Kind.DROP] == Kind.SPLIT
    energy: F64 = np.square(step.psi[part][:, is_split], dtype=np.float64).sum(0)
    return energy


def _alpha_table(alphas: F64, weights: F64, settings: Settings) -> AlphaTable | None:
    """The table of some alphas: exact if they are few, fitted otherwise; None if all are 1."""
    values, counts = np.unique(alphas, return_counts=True)
    if len(values) == 0 or (len(values) == 1 and values[0] == 1.0):
        return None
    exact_limit = 256 if settings.near_lossless else 64
    if len(values) <= exact_limit:
        for shift in range(13):
            scaled = values * (1 << shift)
            if np.all(scaled == np.rint(scaled)) and np.abs(scaled).max() < 1 << 15:
                order = np.argsort(-counts, kind="stable")  # the frequent ones first
                return AlphaTable(shift, tuple(int(a) for a in scaled[order]))
    shift = settings.alpha_bits
    largest = ((1 << 15) - 1) / (1 << shift)
    clipped = np.clip(alphas, -largest, largest)  # a choice of table, not of values: see _choose
    if not settings.closed_loop:  # uniform, as the psi
        centres = np.linspace(clipped.min(), clipped.max(), 256)
    else:
        centres = _lloyd(clipped, weights, settings.n_alpha)
    entries = np.unique(np.rint(centres * (1 << shift)).astype(np.int64))
    if settings.near_lossless:
        entries = np.unique(np.concatenate([[0], entries[:255]]))
    return AlphaTable(shift, tuple(int(a) for a in entries))


def _lloyd(values: F64, weights: F64, n: int) -> F64:
    """n centres of weighted values (Lloyd's algorithm from quantiles)."""
    order = np.argsort(values, kind="stable")
    x, w = values[order], np.sqrt(weights[order])
    w = np.minimum(w, np.quantile(w, 0.9))  # a few huge psi must not take all entries
    total = np.cumsum(w)
    centres = np.unique(np.interp((np.arange(n) + 0.5) / n * total[-1], total, x))
    sums = np.concatenate([[0.0], np.cumsum(w * x)])
    masses = np.concatenate([[0.0], total])
    for _ in range(20):
        edges = np.searchsorted(x, (centres[1:] + centres[:-1]) / 2)
        edges = np.concatenate([[0], edges, [len(x)]])
        mass = np.diff(masses[edges])
        some = mass > 0
        centres = np.diff(sums[edges])[some] / mass[some]
    return centres


# --- the closed loop -----------------------------------------------------------------------------


class _TileCoder:
    """Codes one tile, step by step, beside the integers a decoder would have."""

    def __init__(
        self,
        tile: EvolutionTree,
        grid: _Grid,
        alpha: dict[tuple[int, int], AlphaTable],
        settings: Settings,
    ) -> None:
        self.tile = tile
        self.grid = grid
        self.alpha = alpha
        self.settings = settings
        total = sum(step.n_new for step in tile.steps)
        d = n_channels(tile.sh_degree)
        self.origin = np.rint(_middle(tile) * grid.scale[0:3, 0])
        self.target = np.zeros((d, total))  # the float tree on the grid, minus the origin
        self.x = np.zeros((d, total), np.int32)
        self.n = 0
        self.box = [np.full(3, MAX_X), np.full(3, -MAX_X)]
        self.history = _History(tile, grid)

    def code(self) -> CodedTile:
        steps: list[CodedStep] = []
        for step in self.tile.steps:
            coded, plan = self._code_step(step)
            steps.append(coded)
            if self.settings.near_lossless:
                mend = self._mend(step, plan)
                if mend is not None:
                    steps.append(mend)
        box = self.box if self.n else [np.zeros(3), np.zeros(3)]
        errors = self.history.errors(self.x[:, : self.n])
        steps = [replace(s, error=e) for s, e in zip(steps, errors, strict=True)]
        return CodedTile(
            origin=_triple(self.origin),
            box_min=_triple(box[0]),
            box_max=_triple(box[1]),
            steps=tuple(steps),
        )

    def _code_step(self, step: Step) -> tuple[CodedStep, StepPlan]:
        grid, n = self.grid, self.n
        plan = StepPlan.of(step.slots, step.kinds, n, step.n_adds)
        new_splits = slice(n, n + plan.n_splits)
        new_adds = slice(n + plan.n_splits, plan.n_after)
        inherited = np.abs(self.target[:, plan.split_slots] - self.x[:, plan.split_slots])
        self._advance_target(step, plan)
        aim = self.target if self.settings.closed_loop else None
        indices = np.zeros((N_GROUPS, plan.n_splits), np.uint8)
        psi = np.zeros(step.psi.shape, np.int32)
        quantisers = grid.channel_quantisers(1 + step.level)
        for group, part in enumerate(GROUP_CHANNELS):
            table = self.alpha.get((step.level, group), AlphaTable(0, (1,)))
            step_sizes = np.array([[q.step] for q in quantisers[part]], np.float64)
            if not plan.n_splits and not step.psi.shape[1]:
                break
            parents = self.x[part][:, plan.targets].astype(np.float64)
            if aim is None:
                u = step.psi[part] * grid.scale[part]
                alpha = step.alpha[group].astype(np.float64)
                indices[group] = _nearest(table, alpha)
            else:
                u = aim[part][:, plan.targets] - parents
                s = slice(None) if plan.splits is None else plan.splits
                v = aim[part][:, new_splits] - parents[:, s]
                indices[group] = self._choose(u[:, s], v, table, step_sizes)
                alpha = table.values()[indices[group]]
                if not self.settings.near_lossless:
                    far = (inherited[part] > step_sizes).any(0) | (group == 0)
                    u[:, s] = _joint(u[:, s], v, alpha, far)
            q = np.rint(u / step_sizes)
            limit = np.array([[min(k.max_q, MAX_STORED // 2 - 1)] for k in quantisers[part]])
            if np.any(np.abs(q) > limit):
                raise _TooFine(group)
            psi[part] = q
            self._keep_products(group, part, psi, indices, plan, table, quantisers)
        adds = self._code_adds(step, new_adds)
        self._apply(plan, step, psi, indices, adds)
        coded = CodedStep(step.level, step.slots, step.kinds, indices, psi, adds)
        self.history.note(self.x, self.n)
        return coded, plan

    def _advance_target(self, step: Step, plan: StepPlan) -> None:
        """The float tree's state after the step, in grid units from the origin."""
        target, scale, n = self.target, self.grid.scale, self.n
        parents = target[:, plan.targets]
        psi = step.psi * scale
        s = slice(None) if plan.splits is None else plan.splits
        for group, part in enumerate(GROUP_CHANNELS):
            second = parents[part][:, s] - step.alpha[group].astype(np.float64) * psi[part][:, s]
            target[part, n : n + plan.n_splits] = second
        target[:, plan.targets] = parents + psi
        added = step.adds * scale
        added[0:3] -= self.origin[:, None]
        target[:, n + plan.n_splits : plan.n_after] = added
        target[:, plan.drops] = 0

    def _choose(self, u: F64, v: F64, table: AlphaTable, steps: F64) -> U8:
        """(S,) index of the alpha that serves both children best, its bits counted in.

        With the best Delta, the joint squared error of C1 and C2 is |v + alpha u|^2 / (1 + alpha^2);
        rounding adds (1 + alpha^2) / 12 of a squared step per channel.
        """
        values = table.values()
        if len(values) == 1:
            return np.zeros(u.shape[1], np.uint8)
        u, v = u / steps, v / steps
        uu, uv, vv = (u * u).sum(0), (u * v).sum(0), (v * v).sum(0)
        rounding = len(steps) / 12.0
        if self.settings.near_lossless:  # C1 is exact, alpha serves C2 alone
            cost = [vv + 2 * a * uv + a * a * uu for a in values]
            return np.argmin(cost, axis=0).astype(np.uint8)
        bits = np.zeros(len(values))
        index = np.zeros(u.shape[1], np.uint8)
        for _ in range(2):
            best = np.full(u.shape[1], np.inf)
            for k, a in enumerate(values):
                cost_k = (vv + 2 * a * uv + a * a * uu) / (1 + a * a) + (1 + a * a) * rounding
                cost_k += ALPHA_RATE * bits[k]
                better = cost_k < best
                best[better] = cost_k[better]
                index[better] = k
            counts = np.bincount(index, minlength=len(values))
            bits = -np.log2((counts + 0.5) / (counts.sum() + 0.5 * len(values)))
        return index

    def _keep_products(
        self,
        group: int,
        part: slice,
        psi: I32,
        indices: U8,
        plan: StepPlan,
        table: AlphaTable,
        quantisers: Sequence[Quantiser],
    ) -> None:
        """Make sure of R-7.3-2: where a product is too large take the smallest alpha."""
        if not plan.n_splits:
            return
        s = slice(None) if plan.splits is None else plan.splits
        steps = np.array([[q.step] for q in quantisers[part]])
        largest = np.abs(psi[part][:, s] * steps).max(0)
        room = MAX_PRODUCT - ((1 << table.shift) >> 1)
        entries = np.abs(np.array(table.entries, np.int64))
        over = largest * entries[indices[group]] > room
        if over.any():
            indices[group][over] = int(np.argmin(entries))
            if np.any(largest * int(entries.min()) > room):
                raise _TooFine(group)

    def _code_adds(self, step: Step, new: slice) -> I32:
        quantisers = self.grid.channel_quantisers(0)
        if not step.n_adds:
            return np.zeros((len(quantisers), 0), np.int32)
        steps = np.array([[q.step] for q in quantisers], np.float64)
        q = np.rint(self.target[:, new] / steps)
        for channel, quantiser in enumerate(quantisers):
            if np.abs(q[channel]).max() > min(quantiser.max_q, MAX_STORED // 2 - 1):
                raise _TooFine(min(self.grid.classes[channel], 4))
        return q.astype(np.int32)

    def _apply(self, plan: StepPlan, step: Step, psi: I32, indices: U8, adds: I32) -> None:
        """Do to `x` what a decoder does."""
        of_psi = self.grid.channel_quantisers(1 + step.level)
        of_adds = self.grid.channel_quantisers(0)
        for channel, kind in enumerate(self.grid.classes):
            group = min(kind, 4)
            table = self.alpha.get((step.level, group), AlphaTable(0, (1,)))
            a = np.array(table.entries, np.int32)[indices[group]]
            try:
                largest = apply_channel(
                    self.x[channel],
                    plan,
                    of_psi[channel].delta(psi[channel]),
                    a,
                    table.shift,
                    of_adds[channel].delta(adds[channel]),
                )
            except RangeError:
                raise _TooFine(group) from None
            if largest > MAX_X:
                raise _TooFine(group)
        self.n = plan.n_after
        written = [self.x[0:3, plan.targets], self.x[0:3, plan.n_before : plan.n_after]]
        for part in written:
            if part.shape[1]:
                self.box[0] = np.minimum(self.box[0], part.min(1))
                self.box[1] = np.maximum(self.box[1], part.max(1))

    def _mend(self, step: Step, plan: StepPlan) -> CodedStep | None:
        """A refine of the C2s that are over a grid unit away: no alpha of the table serves them."""
        new = slice(plan.n_before, plan.n_before + plan.n_splits)
        off = np.rint(self.target[:, new] - self.x[:, new])
        distance = np.abs(self.target[:, new] - self.x[:, new]).max(0, initial=0)
        rows = np.flatnonzero(distance > NEAR)
        if not len(rows):
            return None
        slots = (plan.n_before + rows).astype(np.int32)
        kinds = np.full(len(rows), Kind.REFINE, np.uint8)
        d = len(self.x)
        psi = off[:, rows].astype(np.int32)
        none = np.zeros((d, 0), np.int32)
        alpha = np.zeros((N_GROUPS, 0), np.uint8)
        mend = Step(
            step.level,
            slots,
            kinds,
            psi.astype(np.float32),
            alpha.astype(np.float32),
            none.astype(np.float32),
        )
        self._apply(StepPlan.of(slots, kinds, self.n, 0), mend, psi, alpha, none)
        self.history.note(self.x, self.n)
        return CodedStep(step.level, slots, kinds, alpha, psi, none)


def _joint(u: F64, v: F64, alpha: F64, bounded: npt.NDArray[np.bool_]) -> F64:
    """Delta that serves both children, C1 = P + u and C2 = P + v, best.

    The least squared error. For a positive alpha that can be 1.2 times the error of the parent in
    one child, which grows along a chain; so where `bounded`, the least largest error instead, which
    is no more than the parent's (it has to go somewhere: C1 and C2 stay on a line through P).
    """
    least_squares = (u - alpha * v) / (1.0 + alpha * alpha)
    least_largest = (u - v) / (1.0 + np.maximum(alpha, 0.0))
    return np.where(bounded & (alpha > 0), least_largest, least_squares)


def _nearest(table: AlphaTable, alpha: F64) -> U8:
    """(S,) index of the entry nearest to each alpha."""
    values = table.values()
    order = np.argsort(values)
    middles = (values[order][1:] + values[order][:-1]) / 2
    return order[np.searchsorted(middles, alpha)].astype(np.uint8)


def _triple(values: F64 | I64) -> tuple[int, int, int]:
    x, y, z = (int(v) for v in values)
    return x, y, z


class _History:
    """Snapshots after every step, for the error estimates of the packet entries (spec 5.6)."""

    def __init__(self, tile: EvolutionTree, grid: _Grid) -> None:
        self.grid = grid
        self.snapshots: list[I32] = []
        total = sum(step.n_new for step in tile.steps)
        self.born_from = np.full(total, -1, np.int64)
        live = np.zeros(total, bool)
        n = 0
        for step in tile.steps:
            parents = step.slots[step.kinds == Kind.SPLIT]
            self.born_from[n : n + len(parents)] = parents
            live[n : n + step.n_new] = True
            live[step.slots[step.kinds == Kind.DROP]] = False
            n += step.n_new
        leaves = np.flatnonzero(live)
        # The sampled leaves and, from then on, whatever slot stands for each of them.
        self.leaves = leaves[:: max(1, len(leaves) // SAMPLE)]
        self.ancestors = self._ancestors()

    def _ancestors(self) -> I64:
        """(A, L) slots of the ancestors of the sampled leaves, nearest first, -1 after the last."""
        rows = [self.leaves]
        while np.any(rows[-1] >= 0):
            rows.append(np.where(rows[-1] >= 0, self.born_from[rows[-1]], -1))
        return np.stack(rows)

    def note(self, x: I32, n: int) -> None:
        """Remember what stands for each sampled leaf: (D, L), NaN-free; absent ones are marked."""
        exists = (self.ancestors >= 0) & (self.ancestors < n)
        first = np.argmax(exists, axis=0)
        slot = self.ancestors[first, np.arange(exists.shape[1])]
        found = exists.any(0)
        snapshot = np.where(found, x[:, np.where(found, slot, 0)], np.iinfo(np.int32).min)
        self.snapshots.append(snapshot.astype(np.int32))

    def errors(self, final: I32) -> list[tuple[int, ...]]:
        """Per step, per component: the estimate of spec 5.6 in grid units."""
        last = final[:, self.leaves].astype(np.float64)
        if not last.shape[1]:
            return [(UNKNOWN_ERROR,) * (self.grid.sh_degree + 1)] * len(self.snapshots)
        # A splat that is still missing is as far off as it is large.
        log_radius = last[7:10].max(0) / self.grid.scale[7]
        radius = np.exp(np.minimum(log_radius, 80)) * self.grid.scale[0]
        out = []
        for snapshot in self.snapshots:
            missing = snapshot[0] == np.iinfo(np.int32).min
            square = np.square(snapshot[0:3] - last[0:3]).sum(0)
            square[missing] = np.square(np.minimum(radius[missing], 1e9))
            errors = [math.sqrt(square.mean())]
            for component in range(1, self.grid.sh_degree + 1):
                part = component_slice(component)
                shown = np.where(missing, 0, snapshot[part])
                errors.append(math.sqrt(np.square(shown - last[part]).mean()))
            out.append(tuple(min(round(e), UNKNOWN_ERROR - 1) for e in errors))
        return out
