"""The splats that a coded tree shows after some of its steps, without bytes.

They are those that a decoder would show: the same integers, made floats in the same way.

Letters: D channels, n slots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from evogs_codec.common.parallel import parallel_map
from evogs_codec.decoding.compiled.dispatch import loaded_kernels
from evogs_codec.decoding.float_view import float_picks, float_rows
from evogs_codec.encoding.apply_step import apply_step
from evogs_codec.model.arithmetic import StepPlan
from evogs_codec.model.channels import (
    CORE_SH,
    GROUP_CHANNELS,
    N_CORE,
    N_GEOMETRY,
    N_GROUPS,
    channel_class,
)
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.components import component_slice
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32, I32, I64, SplatParams
from evogs_codec.model.tree import Kind, take_picks

__all__ = ["Replayed", "leaves_of"]


class Replayed:
    """A coded tree whose steps are applied one by one, forwards."""

    def __init__(self, tree: CodedTree) -> None:
        self.tree = tree
        self._tiles = [_Tile(tree, tile) for tile in tree.tiles]
        self._rows = None if tree.entries is None else _rows_of_entries(tree, tree.entries)

    def after(self, n_steps: Sequence[int] | I64, sh_degree: int) -> SplatParams:
        """The leaves once each tile has so many steps, at least those that it has already.

        Args:
            n_steps: per tile, or (n_tiles, 1 + degree) of core and of each SH band.
            sh_degree: of the splats, at least that of the tree.
        """
        counts = np.asarray(n_steps, np.int64)
        rows = (counts if counts.ndim > 1 else counts[:, None]).tolist()
        todo: list[tuple[_Tile, list[int]]] = list(zip(self._tiles, rows, strict=True))
        n_slots = sum(tile.n_after(own[0]) for tile, own in todo)
        for _ in parallel_map(lambda one: one[0].advance(one[1]), todo, n_splats=n_slots):
            pass
        n_live = [tile.n_live for tile in self._tiles]
        n, n_coefficients = sum(n_live), (sh_degree + 1) ** 2
        groups = [np.empty((n, size), np.float32) for size in (3, 4, 3, 1)]
        n_stored = (min(sh_degree, self.tree.sh_degree) + 1) ** 2
        sh = np.zeros((n, 3 * n_coefficients), np.float32)
        groups.append(sh[:, : 3 * n_stored])
        ends = np.cumsum(n_live)

        def write(number: int) -> None:
            tile, end = self._tiles[number], int(ends[number])
            tile.write([group[end - tile.n_live : end] for group in groups], self._rows)

        for _ in parallel_map(write, range(len(self._tiles)), n_splats=n):
            pass
        means, quats, log_scales, opacity_logits, _ = groups
        return SplatParams(
            means, quats, log_scales, opacity_logits[:, 0], sh.reshape(n, n_coefficients, 3)
        )


def leaves_of(tree: CodedTree, sh_degree: int) -> SplatParams:
    """The leaves of a coded tree, of this SH degree."""
    return Replayed(tree).after([len(tile.steps) for tile in tree.tiles], sh_degree)


class _Tile:
    """A tile after some of its steps."""

    def __init__(self, tree: CodedTree, tile: CodedTile) -> None:
        self.tree, self.tile = tree, tile
        total = sum(step.n_new for step in tile.steps)
        self.x = np.zeros((len(tile.steps[0].psi) if tile.steps else 0, total), np.int32)
        self.live = np.zeros(total, bool)
        self.born_from = np.full(total, -1, np.int64)
        self.picks = np.zeros(total, np.int32)
        self.plans: list[StepPlan] = []
        self.n = self.n_live = 0
        # Channels of core and of each SH band, and how many steps they have.
        self.parts = [slice(0, min(N_CORE, len(self.x)))]
        self.parts += [component_slice(band) for band in range(1, 1 + _degree_of(len(self.x)))]
        self.n_steps = [0] * len(self.parts)

    def n_after(self, n_steps: int) -> int:
        """Slots after so many steps."""
        return sum(step.n_new for step in self.tile.steps[:n_steps])

    def advance(self, n_steps: Sequence[int]) -> None:
        """Apply the steps up to this number of them, of all channels or of each part."""
        counts = [*n_steps] * (len(self.parts) if len(n_steps) == 1 else 1)
        for step in self.tile.steps[len(self.plans) : counts[0]]:
            self._take(step)
        if len({*counts}) == len({*self.n_steps}) == 1:
            self._apply(slice(0, len(self.x)), self.n_steps[0], counts[0])
        else:
            for part, begin, end in zip(self.parts, self.n_steps, counts, strict=True):
                self._apply(part, begin, end)
        self.n_steps = [max(pair) for pair in zip(self.n_steps, counts, strict=True)]
        self.n_live = int(np.count_nonzero(self.live[: self.n]))

    def _take(self, step: CodedStep) -> None:
        """What a step does to slots, but for their channels."""
        plan = StepPlan.of(step.slots, step.kinds, self.n, int(step.adds.shape[1]))
        take_picks(step, self.picks, self.n)
        self.born_from[self.n : self.n + plan.n_splits] = step.slots[step.kinds == Kind.SPLIT]
        self.live[self.n : plan.n_after] = True
        self.live[plan.drops] = False
        self.plans.append(plan)
        self.n = plan.n_after

    def _apply(self, part: slice, begin: int, end: int) -> None:
        """Steps from `begin` to `end` to some channels."""
        of_adds = self.tree.quantisers[0]
        rows = range(part.start, part.stop)
        for step, plan in zip(self.tile.steps[begin:end], self.plans[begin:end], strict=True):
            of_psi = self.tree.quantisers[1 + step.level]
            tables = [self.tree.alpha_table(step.level, group) for group in range(N_GROUPS)]
            psi, adds = step.psi[part], step.adds[part]
            of = [channel - part.start for channel in step.siblings if channel in rows]
            if of:
                psi = psi.copy()
                born_from = self.born_from[: plan.n_before]
                psi[of] = Siblings.of(step.slots, born_from).sums(psi[of])
            broken = apply_step(
                self.x[part], plan, of_psi, of_adds, tables, psi, step.alpha, adds, part.start
            )
            assert broken is None, "the encoder keeps to the bounds of spec 7.3"

    def write(self, groups: Sequence[F32], rows: I32 | None) -> None:
        """Put the live splats into (n_live, size) arrays of each group."""
        live = self.live[: self.n]
        is_whole = bool(live.all())
        x = self.x[:, : self.n] if is_whole else np.compress(live, self.x[:, : self.n], axis=1)
        if len({*self.n_steps}) > 1:
            x = self._with_early_bands(x.copy() if is_whole else x, np.flatnonzero(live))
        kernels = loaded_kernels(self.n)
        write_rows = getattr(kernels, "float_rows", float_rows)
        write_picks = getattr(kernels, "float_picks", float_picks)
        origins = np.zeros(len(x), np.int64)
        origins[0:3] = self.tile.origin
        exponents = self.tree.grid_exponents
        for group in range(N_GROUPS):
            to, scale = groups[group], 2.0 ** -exponents[group]
            if group == N_GROUPS - 1 and rows is not None:
                picks = self.picks[: self.n]
                write_picks(x[CORE_SH], scale, picks if is_whole else picks[live], rows, to)
                continue
            first = GROUP_CHANNELS[group].start
            part = slice(first, first + to.shape[1])
            write_rows(x[part], origins[part], scale, to)

    def _with_early_bands(self, x: I32, slots: I64) -> I32:
        """The integers (D, n) of slots, whose SH bands are those of the last ancestor with steps.

        They are changed in place.
        """
        for part, n_steps in zip(self.parts[1:], self.n_steps[1:], strict=True):
            if n_steps == self.n_steps[0]:
                continue
            n, early = self.n_after(n_steps), slots.copy()
            while (late := early >= n).any():
                early[late] = self.born_from[early[late]]
            np.take(self.x[part], early, axis=1, out=x[part], mode="wrap")  # -1: not there yet
            x[part, early < 0] = 0
        return x


def _degree_of(n_rows: int) -> int:
    """SH degree of so many channels; 0 of none."""
    return max(math.isqrt((n_rows - N_GEOMETRY) // 3) - 1, 0) if n_rows else 0


def _rows_of_entries(tree: CodedTree, entries: I32) -> I32:
    """(1 + E, C) the integers that each pick shows: zeros for the pick 0."""
    rows = np.zeros((1 + entries.shape[1], len(entries)), np.int32)
    for channel, row in enumerate(entries):
        kind = channel_class(N_CORE + channel)
        rows[1:, channel] = tree.quantisers[0][kind].delta(row)
    return rows
