"""A tile in a closed loop: the integers that a decoder has, and psi that lead it to the float tree.

The encoder keeps the decoder's integers and aims at the float tree from there: psi corrects what
it can of the error of a parent, and what it cannot correct is passed on but not magnified.

Letters: D channels, n slots, P refines and splits of a step, S splits. Everything here is in grid
units unless a name says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.alpha_tables import joint_delta, nearest, serving_both, serving_second
from evogs_codec.encoding.apply_step import apply_step, loops, rows_of_splits
from evogs_codec.encoding.grids import Grid, TooFineError, largest_of_rows
from evogs_codec.encoding.packet_gains import LeafTracker
from evogs_codec.encoding.ranges import middle_of
from evogs_codec.encoding.rate_distortion import ErrorWeights
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.encoding.settings import Settings
from evogs_codec.encoding.sibling_refines import cheapest_differences
from evogs_codec.format.planes import MAX_STORED
from evogs_codec.model.arithmetic import (
    MAX_PRODUCT,
    MAX_X,
    SYMMETRIC,
    AlphaTable,
    Quantiser,
    StepPlan,
)
from evogs_codec.model.channels import (
    GROUP_CHANNELS,
    N_GROUPS,
    channel_class,
    group_of_class,
    n_channels,
)
from evogs_codec.model.coded_tree import CodedStep, CodedTile
from evogs_codec.model.splats import F64, I32, I64, U8
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = ["TileCoder"]

MAX_INTEGER = MAX_STORED // 2 - 1  # in 24 bits
LOSSLESS_SHARE = 0.999  # grid units that near-lossless coding leaves: 1 less what float64 may err


class TileCoder:
    """Codes one tile, step by step, beside the integers a decoder would have."""

    def __init__(
        self,
        tile: EvolutionTree,
        grid: Grid,
        alpha: dict[tuple[int, int], AlphaTable],
        settings: Settings,
        weights: Sequence[StepWeights | None] | None,
        price: float,
        tracker: LeafTracker | None,
    ) -> None:
        self.weights, self.price = weights, price
        self.tile = tile
        self.grid = grid
        self.alpha = alpha
        self.settings = settings
        total = sum(step.n_new for step in tile.steps)
        d = n_channels(tile.sh_degree)
        unit = grid.quantisers[0][0].step if settings.whole_origins else 1
        self.origin = unit * np.rint(middle_of(tile) * grid.scale[0:3, 0] / unit)
        self.target = np.zeros((d, total))  # the float tree on the grid, minus the origin
        self.x = np.zeros((d, total), np.int32)
        self.n = 0
        self.box = [np.full(3, MAX_X), np.full(3, -MAX_X)]
        self.tracker = tracker

    def code(self) -> CodedTile:
        """All steps of the tile, with its origin and its box."""
        steps: list[CodedStep] = []
        for number, step in enumerate(self.tile.steps):
            coded, plan = self._code_step(number, step)
            steps.append(coded)
            if self.settings.is_near_lossless:
                correction = self._correction(step, plan)
                if correction is not None:
                    steps.append(correction)
        box = self.box if self.n else [np.zeros(3), np.zeros(3)]
        if self.tracker is not None:
            found = self.tracker.estimates(self.x[:, : self.n])
            steps = [replace(s, error=e, gain=g) for s, (e, g) in zip(steps, found, strict=True)]
        return CodedTile(
            origin=_triple(self.origin),
            box_min=_triple(box[0]),
            box_max=_triple(box[1]),
            steps=tuple(steps),
        )

    def _code_step(self, number: int, step: Step) -> tuple[CodedStep, StepPlan]:
        grid, n = self.grid, self.n
        plan = StepPlan.of(step.slots, step.kinds, n, step.n_adds)
        new_adds = slice(n + plan.n_splits, plan.n_after)
        own = None if self.weights is None else self.weights[number]
        inherited = np.empty((len(self.x), 0))  # nobody asks for it where there are weights
        if own is None:
            inherited = np.abs(self.target[:, plan.split_slots] - self.x[:, plan.split_slots])
        self._advance_target(step, plan)
        is_kept = self.weights is not None and self.weights[number] is None
        aim = self.target if self.settings.closed_loop and not is_kept else None
        indices = np.zeros((N_GROUPS, plan.n_splits), np.uint8)
        psi = np.zeros(step.psi.shape, np.int32)
        stored = psi
        if own is not None and own.siblings is not None:
            stored = psi.copy()  # differences, whose sums are psi
        quantisers = grid.channel_quantisers[1 + step.level]
        for group, part in enumerate(GROUP_CHANNELS):
            table = self.alpha.get((step.level, group), SYMMETRIC)
            step_sizes = np.array([[q.step] for q in quantisers[part]], np.float64)
            if not plan.n_splits and not step.psi.shape[1]:
                break
            if aim is None:
                u = step.psi[part] * grid.scale[part]
                indices[group] = nearest(table, step.alpha[group].astype(np.float64))
                q = np.rint(u / step_sizes)
            else:
                s = slice(None) if plan.splits is None else plan.splits
                u, v = self._differences(aim, part, plan, step_sizes)
                weights = self._weights(number, part, step_sizes)
                if weights is None:
                    far = np.any(inherited[part] > step_sizes, axis=0) | (group == 0)
                    indices[group], u[:, s] = self._serve(u[:, s], v, table, far)
                else:
                    indices[group], u[:, s] = weights.choose(u[:, s], v, table, s)
                only_refines = not plan.n_splits and (own is None or own.siblings is None)
                if only_refines and step.psi.any() and not step.psi[part].any():
                    u[:] = 0  # refines of other groups leave this one, and its errors, as it is
                if weights is None:
                    q = np.rint(u)
                elif own is not None and own.siblings is not None:
                    stored[part], q = cheapest_differences(u, weights.targets, own.siblings)
                else:
                    q = weights.integers(u, table, indices[group], s)
            self._expect_in_range(q, group, 1 + step.level)
            if stored is not psi:
                self._expect_in_range(stored[part], group, 1 + step.level)
            psi[part] = q
            self._keep_products(group, part, psi, indices, plan, table, quantisers)
        adds = self._code_adds(step, new_adds, own)
        self._apply(plan, step.level, psi, indices, adds)
        coded = CodedStep(
            step.level,
            step.slots,
            step.kinds,
            indices,
            stored,
            adds,
            picks=step.picks,
            changed_picks=step.changed_picks,
            siblings=() if stored is psi else tuple(range(len(psi))),
        )
        if self.tracker is not None:
            self.tracker.note(self.x, self.n, step)
        return coded, plan

    def _differences(
        self, aim: F64, part: slice, plan: StepPlan, step_sizes: F64
    ) -> tuple[F64, F64]:
        """(C, P) and (C, S) of C1s and refined splats, and of C2s, from their parents, in steps."""
        compiled = loops()
        new = slice(plan.n_before, plan.n_before + plan.n_splits)
        if compiled is None:
            s = slice(None) if plan.splits is None else plan.splits
            parents = self.x[part][:, plan.targets].astype(np.float64)
            u = (aim[part][:, plan.targets] - parents) / step_sizes
            return u, (aim[part][:, new] - parents[:, s]) / step_sizes
        slots, splits = plan.target_slots, rows_of_splits(plan)
        u, v = (np.empty((len(step_sizes), n)) for n in (len(slots), plan.n_splits))
        compiled.differences(
            aim[part], self.x[part], slots, splits, step_sizes[:, 0], new.start, u, v
        )
        return u, v

    def _serve(
        self, u: F64, v: F64, table: AlphaTable, bounded: npt.NDArray[np.bool_]
    ) -> tuple[U8, F64]:
        """Indices (S,) of alphas and Delta (C, S) in steps, for children at P + u and P + v."""
        if self.settings.is_near_lossless:
            return serving_second(u, v, table), u
        indices = serving_both(u, v, table)
        return indices, joint_delta(u, v, table.values[indices], bounded)

    def _weights(self, number: int, part: slice, step_sizes: F64) -> ErrorWeights | None:
        """What errors of a group are worth in this step, if that is known."""
        own = None if self.weights is None else self.weights[number]
        if own is None:
            return None
        kinds = list(self.grid.classes[part])
        bits = np.square(step_sizes / self.grid.scale[part]) / self.price
        return ErrorWeights(own.targets[kinds] * bits, own.new[kinds] * bits)

    def _advance_target(self, step: Step, plan: StepPlan) -> None:
        """The float tree's state after the step, in grid units from the origin."""
        target, scale, n = self.target, self.grid.scale, self.n
        compiled = loops()
        if compiled is not None:
            groups = np.array([group_of_class(kind) for kind in self.grid.classes])
            slots, splits = plan.target_slots, rows_of_splits(plan)
            compiled.advance(target, slots, splits, step.psi, step.alpha, groups, scale[:, 0], n)
        else:
            parents = target[:, plan.targets]
            psi = step.psi * scale
            s = slice(None) if plan.splits is None else plan.splits
            for group, part in enumerate(GROUP_CHANNELS):
                alpha = step.alpha[group].astype(np.float64)
                target[part, n : n + plan.n_splits] = parents[part][:, s] - alpha * psi[part][:, s]
            target[:, plan.targets] = parents + psi
        added = step.adds * scale
        added[0:3] -= self.origin[:, None]
        target[:, n + plan.n_splits : plan.n_after] = added
        target[:, plan.drops] = 0

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
            if not self.settings.is_near_lossless:  # which corrects what another alpha does
                raise TooFineError(group)
            indices[group][over] = int(np.argmin(entries))
            if np.any(largest * int(entries.min()) > room):
                raise TooFineError(group)

    def _code_adds(self, step: Step, new: slice, own: StepWeights | None) -> I32:
        """Integers (D, A) of adds; 0 in classes that are to be empty."""
        quantisers = self.grid.channel_quantisers[0]
        if not step.n_adds:
            return np.zeros((len(quantisers), 0), np.int32)
        steps = np.array([[q.step] for q in quantisers], np.float64)
        q = np.rint(self.target[:, new] / steps)
        for group, part in enumerate(GROUP_CHANNELS):
            self._expect_in_range(q[part], group, 0)
        if own is not None and own.empty:
            q[[kind in own.empty for kind in self.grid.classes]] = 0
        return q.astype(np.int32)

    def _expect_in_range(self, q: F64 | I32, group: int, row: int) -> None:
        """Raise TooFineError if integers (C, n) of a group need more than 24 bits, or a Delta 28.

        `row` is that of their quantisers.
        """
        part, largest = GROUP_CHANNELS[group], largest_of_rows(q)
        over = np.flatnonzero(largest > MAX_INTEGER)
        if len(over):
            kinds = self.grid.classes[part]
            times: dict[int, float] = {}
            for channel in over.tolist():
                own = 2.0 ** math.ceil(math.log2(float(largest[channel]) / MAX_INTEGER))
                times[kinds[channel]] = max(own, times.get(kinds[channel], 1.0))
            raise TooFineError(group, row, times)
        quantisers = self.grid.channel_quantisers[row][part]
        if np.any(largest > np.array([k.max_q for k in quantisers])):
            raise TooFineError(group)

    def _apply(self, plan: StepPlan, level: int, psi: I32, indices: U8, adds: I32) -> None:
        """Do to `x` what a decoder does."""
        of_adds, of_psi = self.grid.quantisers[0], self.grid.quantisers[1 + level]
        tables = [self.alpha.get((level, group), SYMMETRIC) for group in range(N_GROUPS)]
        broken = apply_step(self.x, plan, of_psi, of_adds, tables, psi, indices, adds)
        if broken is not None:
            raise TooFineError(group_of_class(channel_class(broken)))
        self.x[:, plan.drops] = 0
        self.n = plan.n_after
        written = [self.x[0:3, plan.targets], self.x[0:3, plan.n_before : plan.n_after]]
        for part in written:
            if part.shape[1]:
                self.box[0] = np.minimum(self.box[0], part.min(1))
                self.box[1] = np.maximum(self.box[1], part.max(1))

    def _correction(self, step: Step, plan: StepPlan) -> CodedStep | None:
        """A refine of the C2s that are over a grid unit away: no alpha of the table serves them."""
        new = slice(plan.n_before, plan.n_before + plan.n_splits)
        off = self.target[:, new] - self.x[:, new]
        rows = np.flatnonzero(np.abs(off).max(0, initial=0) > LOSSLESS_SHARE)
        if not len(rows):
            return None
        slots = (plan.n_before + rows).astype(np.int32)
        kinds = np.full(len(rows), Kind.REFINE, np.uint8)
        psi = np.rint(off[:, rows]).astype(np.int32)
        adds = np.zeros((len(self.x), 0), np.int32)
        indices = np.zeros((N_GROUPS, 0), np.uint8)
        self._apply(StepPlan.of(slots, kinds, self.n, 0), step.level, psi, indices, adds)
        if self.tracker is not None:
            self.tracker.note(self.x, self.n)
        return CodedStep(step.level, slots, kinds, indices, psi, adds)


def _triple(values: F64 | I64) -> tuple[int, int, int]:
    x, y, z = (int(v) for v in values)
    return x, y, z
