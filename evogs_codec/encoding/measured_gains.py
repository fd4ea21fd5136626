"""What levels and SH bands gain in pictures of a scene, measured.

How much a coarse level errs in pictures depends on how large splats are in them and on what lies
beside what: estimates (`packet_gains`) are right within a level, but five times off between scenes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np

from evogs_codec.encoding.packet_order import leaf_shares
from evogs_codec.encoding.pictures import Pictures, Recolouring
from evogs_codec.model.channels import N_CORE
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.splats import F32, F64, I64, SplatParams
from evogs_codec.model.tree import EvolutionTree, Slots

__all__ = ["N_ORDERING_VIEWS", "MeasuredGains", "nothing_of", "psnr_of_sh"]

N_ORDERING_VIEWS = 6  # enough to put packets in order
MIN_GAIN = 1e-12  # mean squared error that anything gains, so that its estimates still order it


@dataclass(frozen=True, eq=False)
class MeasuredGains:
    """What pictures of a tree gain, in mean squared error.

    Attributes:
        levels: (n_levels,) by the level after the one before, or after nothing, with all SH.
        bands: (degree,) by SH bands 1.., of the last level, after the bands below; with a palette
            (1,), by all of them together.
        bands_of_levels: (n_levels,) by all SH bands of a level, after those of the level before:
            of the last splats, that have no other SH than their ancestors of that level.
    """

    levels: F64
    bands: F64
    bands_of_levels: F64

    @staticmethod
    def of(
        tree: EvolutionTree, pictures: Pictures, shown: Sequence[float] | None = None
    ) -> MeasuredGains:
        """Of a tree whose leaves are the scene of the pictures.

        Args:
            tree: what is shown.
            pictures: of its leaves.
            shown: PSNR of nothing, and of each level but the last, where it is known.
        """
        if shown is None:
            coarse = islice(tree.levels(), max(tree.n_levels - 1, 0))
            cuts = (nothing_of(tree.shared_leaves()), *coarse)
            shown = [pictures.psnr(cut) for cut in cuts]
        return MeasuredGains(-np.diff(_errors(shown)), *_of_bands(tree, pictures))

    def with_bands_of(self, tree: EvolutionTree, pictures: Pictures) -> MeasuredGains:
        """Those of a tree that differs in its SH above band 0 alone, or in having a palette."""
        return MeasuredGains(self.levels, *_of_bands(tree, pictures))

    def rescale(self, tree: CodedTree) -> CodedTree:
        """The tree with gains that add up to these, shared out as they were.

        Where pictures show nothing the estimates stay.
        """
        if not self.levels.sum() > 0:
            return tree
        n_levels = len(self.levels)  # those beyond are layers, whose gains are measured already
        estimated = np.zeros((tree.n_levels, len(tree.components.of_tiles)))
        for share, tile in zip(leaf_shares(tree), tree.tiles, strict=True):
            for step in tile.steps:
                estimated[step.level] += share * np.array(step.gain)
        factors = np.ones_like(estimated)
        estimated = estimated[:n_levels]
        factors[:n_levels, 0] = np.maximum(self.levels, MIN_GAIN) / np.maximum(
            estimated[:, 0], MIN_GAIN
        )
        factors[:n_levels, 1:] = _shared_out(estimated[:, 1:], self.bands_of_levels, self.bands)
        tiles = []
        for tile in tree.tiles:
            steps = [
                replace(step, gain=tuple((factors[step.level] * step.gain).tolist()))
                for step in tile.steps
            ]
            tiles.append(replace(tile, steps=tuple(steps)))
        return replace(tree, tiles=tuple(tiles))


def _of_bands(tree: EvolutionTree, pictures: Pictures) -> tuple[F64, F64]:
    """`bands` and `bands_of_levels` of `MeasuredGains`."""
    leaves = tree.shared_leaves()
    degrees = range(tree.sh_degree if tree.palette is None else 1)
    plain = (leaves.sh[:, : (k + 1) ** 2] for k in degrees)
    found = psnr_of_sh(pictures, leaves, chain(plain, _early_sh(tree) if degrees else ()))
    bands, early = [*islice(found, len(degrees))], [*found]
    of_levels = -np.diff(_errors([*bands[:1], *early])) if bands else np.zeros(tree.n_levels)
    return -np.diff(_errors(bands)), of_levels


def psnr_of_sh(pictures: Pictures, splats: SplatParams, each: Iterable[F32]) -> Iterator[float]:
    """PSNR of splats with each SH (N, K, 3) in place of theirs, dB."""
    if isinstance(pictures, Recolouring):
        return pictures.psnr_of_sh(splats, each)
    return (pictures.psnr(replace(splats, sh=sh)) for sh in each)


def nothing_of(splats: SplatParams) -> SplatParams:
    """None of the splats."""
    return splats.take(np.zeros(0, np.int64))


def _early_sh(tree: EvolutionTree) -> Iterator[F32]:
    """(N, K, 3) SH of the leaves, per level but the last.

    Bands from 1 on are those of their ancestors of the level, 0 where there are none yet.
    """
    born_from, live = tree.lineage()
    leaves, sh = np.flatnonzero(live), tree.shared_leaves().sh
    states, state = tree.states(slice(N_CORE, None)), None
    for level in range(tree.n_levels - 1):
        n_steps = sum(step.level == level for step in tree.steps)
        state = next(islice(states, n_steps - 1, None)) if n_steps else state
        early = np.zeros_like(sh)
        if state is not None:
            ancestors = leaves.copy()
            n_slots = len(state.live)
            while (late := ancestors >= n_slots).any():
                ancestors[late] = born_from[ancestors[late]]
            bands = _bands_of(state, np.maximum(ancestors, 0))
            bands[ancestors < 0] = 0
            early[:, 1:] = bands.reshape(early[:, 1:].shape)
        early[:, 0] = sh[:, 0]
        yield early


def _bands_of(state: Slots, slots: I64) -> F32:
    """(n, C) SH above band 0 of slots (n,), of a state that has no other channels."""
    if state.palette is not None:
        return state.palette.rows_of(state.picks[slots])
    return state.values.astype(np.float32).T.take(slots, axis=0)


def _shared_out(estimated: F64, rows: F64, columns: F64) -> F64:
    """Factors (n, m) of estimates (n, m) with the sums `columns` (m,), nearly, and `rows` (n,)."""
    by_column = np.maximum(columns, MIN_GAIN) / np.maximum(estimated.sum(0), MIN_GAIN)
    of_rows = (estimated * by_column).sum(1)
    return np.outer(np.maximum(rows, MIN_GAIN) / np.maximum(of_rows, MIN_GAIN), by_column)


def _errors(decibels: Sequence[float]) -> list[float]:
    """Mean squared error of each PSNR, and 0 at last."""
    return [*(10 ** (-one / 10) for one in decibels), 0.0]
