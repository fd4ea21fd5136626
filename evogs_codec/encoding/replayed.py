"""The splats that a coded tree shows after some of its steps, without bytes.

They are those that a decoder would show: the same integers, made floats in the same way.

Letters: D channels, n slots.
"""

from __future__ import annotations

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
    N_GROUPS,
    channel_class,
)
from evogs_codec.model.coded_tree import CodedStep, CodedTile, CodedTree
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.splats import F32, I32, SplatParams
from evogs_codec.model.tree import Kind, take_picks

__all__ = ["Replayed"]


class Replayed:
    """A coded tree whose steps are applied one by one, forwards."""

    def __init__(self, tree: CodedTree) -> None:
        self.tree = tree
        self._tiles = [_Tile(tree, tile) for tile in tree.tiles]
        self._rows = None if tree.entries is None else _rows_of_entries(tree, tree.entries)

    def after(self, n_steps: Sequence[int], sh_degree: int) -> SplatParams:
        """The leaves once each tile has so many steps, at least those that it has already.

        Args:
            n_steps: per tile.
            sh_degree: of the splats, at least that of the tree.
        """
        todo = list(zip(self._tiles, n_steps, strict=True))
        n_slots = sum(tile.n_after(n) for tile, n in todo)
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


class _Tile:
    """A tile after some of its steps."""

    def __init__(self, tree: CodedTree, tile: CodedTile) -> None:
        self.tree, self.tile = tree, tile
        total = sum(step.n_new for step in tile.steps)
        self.x = np.zeros((len(tile.steps[0].psi) if tile.steps else 0, total), np.int32)
        self.live = np.zeros(total, bool)
        self.born_from = np.full(total, -1, np.int64)
        self.picks = np.zeros(total, np.int32)
        self.n_steps = self.n = self.n_live = 0

    def n_after(self, n_steps: int) -> int:
        """Slots after so many steps."""
        return sum(step.n_new for step in self.tile.steps[:n_steps])

    def advance(self, n_steps: int) -> None:
        """Apply the steps up to this number of them."""
        for step in self.tile.steps[self.n_steps : n_steps]:
            self._apply(step)
        self.n_steps = max(self.n_steps, n_steps)
        self.n_live = int(np.count_nonzero(self.live[: self.n]))

    def _apply(self, step: CodedStep) -> None:
        plan = StepPlan.of(step.slots, step.kinds, self.n, int(step.adds.shape[1]))
        psi = step.psi
        if step.siblings:
            of = list(step.siblings)
            psi = psi.copy()
            psi[of] = Siblings.of(step.slots, self.born_from[: self.n]).sums(psi[of])
        of_adds, of_psi = self.tree.quantisers[0], self.tree.quantisers[1 + step.level]
        tables = [self.tree.alpha_table(step.level, group) for group in range(N_GROUPS)]
        broken = apply_step(self.x, plan, of_psi, of_adds, tables, psi, step.alpha, step.adds)
        assert broken is None, "the encoder keeps to the bounds of spec 7.3"
        take_picks(step, self.picks, self.n)
        n_splits = plan.n_splits
        self.born_from[self.n : self.n + n_splits] = step.slots[step.kinds == Kind.SPLIT]
        self.live[self.n : plan.n_after] = True
        self.live[plan.drops] = False
        self.n = plan.n_after

    def write(self, groups: Sequence[F32], rows: I32 | None) -> None:
        """Put the live splats into (n_live, size) arrays of each group."""
        live = self.live[: self.n]
        is_whole = bool(live.all())
        x = self.x[:, : self.n] if is_whole else np.compress(live, self.x[:, : self.n], axis=1)
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


def _rows_of_entries(tree: CodedTree, entries: I32) -> I32:
    """(1 + E, C) the integers that each pick shows: zeros for the pick 0."""
    rows = np.zeros((1 + entries.shape[1], len(entries)), np.int32)
    for channel, row in enumerate(entries):
        kind = channel_class(N_CORE + channel)
        rows[1:, channel] = tree.quantisers[0][kind].delta(row)
    return rows
