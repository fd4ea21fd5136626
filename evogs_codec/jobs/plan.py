"""The plan: what all tiles of a stream share, from surveys of a few of them.

The header, the quantisers and the tables of alphas are of the whole stream. A tile whose numbers
need less takes whole multiples of the steps, powers of two.

Letters: K classes (spec 3.2), L levels with those of layers, T tiles.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evogs_codec.encoding.alpha_tables import tables_of
from evogs_codec.encoding.grids import (
    AccuracyWarning,
    Grid,
    TooFineError,
    coarse_step,
    grid_exponents,
    warn_if_coarser,
    with_fewer_units,
)
from evogs_codec.encoding.late_level import gains_little
from evogs_codec.encoding.layers import in_odd_numbers
from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.sensitivity import steps_of_entries
from evogs_codec.encoding.settings import Settings
from evogs_codec.io.files import write_atomic
from evogs_codec.jobs.partition import Partition
from evogs_codec.jobs.scratch_files import arrays_of
from evogs_codec.lifting.coarse_entries import CoarseEntries
from evogs_codec.model.arithmetic import AlphaTable, Quantiser
from evogs_codec.model.channels import N_GROUPS, group_of_class
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F32, F64, I64

__all__ = ["Needs", "Plan", "Sharing", "Survey", "surveyed", "worth_of_entries"]

MAX_SURVEYED, SURVEYED_EVERY = 8, 4  # tiles at most; of few, one in so many
MIN_SHARE = 1 / 8  # of the splats of the largest tile: fewer do not decide the steps of all
TIMES_ALIKE = 2.0  # times the size of splats in another tile: hardly larger
RANGE_ROOM = 2.0  # times the largest number of a splat: parents and errors of coarse levels
MAX_SHIFT = 20
MAX_ADD = 0.99 * (1 << 23)  # steps of an add, which has 24 bits
# Of the size of its splats is the step of the positions of a tile: moved by a tenth.
STEP_OF_SIZE = 0.2


@dataclass(frozen=True, eq=False)
class Needs:
    """What a tile would have on its own.

    Attributes:
        steps: (1 + L, K) of adds, then of psi per level, scene units.
        alphas: per (level, group), (n,) alphas and (n,) what they weigh.
    """

    steps: F64
    alphas: Mapping[tuple[int, int], tuple[F64, F64]]

    def arrays(self, name: str) -> dict[str, Any]:
        """As arrays whose names begin with this one."""
        return {f"{name}-steps": self.steps} | {
            f"{name}-{kind}-{level}-{group}": row
            for (level, group), found in self.alphas.items()
            for kind, row in zip(("alpha", "weight"), found, strict=True)
        }

    @staticmethod
    def of_arrays(name: str, found: Mapping[str, Any]) -> Needs:
        """From what `arrays` gave."""
        begin = f"{name}-alpha-"
        places = sorted(
            tuple(map(int, key.removeprefix(begin).split("-")))
            for key in found
            if key.startswith(begin)
        )
        alphas = {
            (a, b): (found[f"{begin}{a}-{b}"], found[f"{name}-weight-{a}-{b}"]) for a, b in places
        }
        return Needs(found[f"{name}-steps"], alphas)


@dataclass(frozen=True, eq=False)
class Sharing:
    """What a tile tells of a palette.

    Attributes:
        coarse: (C, n) SH above band 0 of some of its coarse splats.
        worth: (degree,) of all numbers of entries in a band, in prices of a bit.
        bits_of_picks, bits_of_psi: an estimate; one or the other is stored.
    """

    coarse: F32
    worth: F64
    bits_of_picks: float
    bits_of_psi: float


@dataclass(frozen=True, eq=False)
class Survey:
    """What a tile tells of the stream.

    Attributes:
        plain: what it needs.
        late: the same if its last level comes late (`late_level`); None if it cannot.
        gain: dB by which the last level looks better, at coarse steps, than the one before it.
        sharing: of a palette, if splats share their SH.
    """

    plain: Needs
    late: Needs | None = None
    gain: float = np.inf
    sharing: Sharing | None = None

    def write(self, path: Path) -> None:
        """To a file that `read` reads."""
        arrays = self.plain.arrays("plain")
        if self.late is not None:
            arrays |= self.late.arrays("late") | {"gain": np.array(self.gain)}
        if self.sharing is not None:
            arrays |= {
                "coarse": self.sharing.coarse,
                "worth": self.sharing.worth,
                "bits": np.array([self.sharing.bits_of_picks, self.sharing.bits_of_psi]),
            }
        write_atomic(path, lambda file: np.savez(file, allow_pickle=False, **arrays))

    @staticmethod
    def read(path: Path) -> Survey:
        """From a file that `write` wrote."""
        with arrays_of(path) as found:
            late = Needs.of_arrays("late", found) if "gain" in found else None
            gain = float(found["gain"]) if "gain" in found else np.inf
            sharing = None
            if "coarse" in found:
                sharing = Sharing(found["coarse"], found["worth"], *found["bits"].tolist())
            return Survey(Needs.of_arrays("plain", found), late, gain, sharing)


@dataclass(frozen=True)
class Plan:
    """What all tiles share.

    Attributes:
        sh_degree, info: of the scene.
        n_levels: with those of layers.
        exponents: of the grids.
        steps: (1 + L, K) scene units.
        quantisers: nearest to the steps, once they are raised.
        raised: (1 + L, K) powers of two by which steps are coarser, since a tile has numbers that
            24 bits do not hold otherwise. What they are off, records of later rows correct.
        alpha: tables per (level, group).
        settings: how tiles are quantised.
        n_free: rows of steps before those that are odd multiples of one another.
        is_late: the last level of the tree of a tile comes late.
        coarse: entries for coarse splats of a palette; None without one.
    """

    sh_degree: int
    info: SceneInfo
    n_levels: int
    exponents: tuple[int, ...]
    steps: F64
    quantisers: tuple[tuple[Quantiser, ...], ...]
    raised: I64
    alpha: dict[tuple[int, int], AlphaTable]
    settings: Settings
    n_free: int = 0
    is_late: bool = False
    coarse: CoarseEntries | None = None

    @staticmethod
    def of(
        partition: Partition,
        surveys: Sequence[Survey],
        n_coarse: int,
        info: SceneInfo,
        *,
        has_palette: bool = False,
    ) -> Plan:
        """From the surveys of the tiles that `surveyed` names.

        Args:
            partition: of the scene.
            surveys: of these tiles.
            n_coarse: levels of the tree of a tile.
            info: metadata.
            has_palette: SH above band 0 are in one, as the surveys tell it.

        Raises:
            NotRepresentableError: numbers are too large for any grid.
        """
        late = [survey.late for survey in surveys if survey.late is not None]
        gains = [survey.gain for survey in surveys if survey.late is not None]
        is_late = bool(late) and gains_little(float(np.mean(gains)))
        needs = late if is_late else [survey.plain for survey in surveys]
        steps = _shared_steps(np.stack([need.steps for need in needs]), n_coarse - is_late)
        finest = min(partition.size(tile) for tile in range(len(partition.counts)))
        steps[-1, 0] = min(steps[-1, 0], max(STEP_OF_SIZE * finest, 1e-12))
        sharings = [survey.sharing for survey in surveys if survey.sharing is not None]
        if has_palette:
            worth = worth_of_entries(partition, sharings)
            steps[:, N_GROUPS:] = steps_of_entries(worth, 1.0)
            some = np.concatenate([sharing.coarse for sharing in sharings], axis=1)
        settings = Settings.by_views(steps)
        ranges = Ranges(
            extent=1.0,
            largest=tuple((RANGE_ROOM * partition.largest).tolist()),
            furthest=float(np.abs(partition.tree.origins).max()),
            psi=(),
        )
        places = sorted({place for need in needs for place in need.alphas})
        pooled = {place: _pooled(place, needs) for place in places}
        plan = Plan(
            sh_degree=partition.sh_degree,
            info=info,
            n_levels=len(steps) - 1,
            exponents=grid_exponents(settings, ranges, steps),
            steps=steps,
            quantisers=(),
            raised=_raised(steps, float(partition.largest[0])),
            alpha=tables_of(pooled, settings),
            settings=settings,
            n_free=n_coarse - is_late,
            is_late=is_late,
            coarse=CoarseEntries.of(some, partition.n_vectors) if has_palette else None,
        )
        return plan._with_quantisers()

    @property
    def name(self) -> str:
        """Of what may change until all tiles fit: grids, and what steps are raised by."""
        exponents = "_".join(map(str, self.exponents))
        if not self.raised.any():
            return exponents
        return f"{exponents}_{hashlib.sha256(self.raised.tobytes()).hexdigest()[:12]}"

    def with_less_of(self, error: TooFineError) -> Plan:
        """The plan for tiles of which one has a number that is too large.

        A row of steps is raised; or the grid of a group has half as many units.

        Raises:
            NotRepresentableError: there is no such grid.
        """
        if error.row is None:
            exponents = with_fewer_units(self.exponents, error.group)
            return replace(self, exponents=exponents)._with_quantisers()
        raised = self.raised.copy()
        for kind, times in error.times.items():
            row = error.row
            wanted = times * self._got(row, kind) / self.steps[row, kind]
            raised[row, kind] = max(raised[row, kind] + 1, math.ceil(math.log2(wanted)))
        return replace(self, raised=raised)._with_quantisers()

    def coarser(self, steps: F64) -> I64:
        """(1 + L, K) powers of two by which a tile that has these steps has coarser ones.

        They are beside those of the quantisers, which a grid may have coarser than the plan. Steps
        that are odd multiples of one another stay so, but where some are raised.
        """
        of_plan = self.steps * 2.0**self.raised
        for row, kind in np.ndindex(len(of_plan), len(self.quantisers[0])):
            of_plan[row, kind] = max(of_plan[row, kind], self._got(row, kind))
        ratio = np.log2(np.maximum(steps, 1e-300) / of_plan) + self.raised
        ratio[self.n_free :] = ratio[self.n_free :].min(axis=0)
        found: I64 = np.clip(np.rint(ratio) - self.raised, 0, MAX_SHIFT).astype(np.int64)
        if self.coarse is not None:
            found[:, N_GROUPS:] = 0  # of entries, which are of all tiles
        return found

    def grid(self, shifts: I64) -> Grid:
        """The grid of a tile whose steps are 2**shifts (1 + L, K) of those of the plan."""
        quantisers = tuple(
            tuple(Quantiser(q.mantissa, q.shift + shift) for q, shift in zip(row, own, strict=True))
            for row, own in zip(self.quantisers, shifts.tolist(), strict=True)
        )
        return replace(self._grid(), quantisers=quantisers)

    def coded(self, grid: Grid, tiles: Sequence[CodedTile]) -> CodedTree:
        """Tiles on a grid as a tree; entries of a palette are not known yet."""
        entries = None
        if self.coarse is not None:
            entries = np.empty((len(self.coarse.values), 0), np.int32)
        return CodedTree(
            sh_degree=self.sh_degree,
            n_levels=self.n_levels,
            grid_exponents=grid.exponents,
            quantisers=grid.quantisers,
            alpha=self.alpha,
            tiles=tuple(tiles),
            info=self.info,
            entries=entries,
        )

    def grid_of_entries(self, steps: F64) -> Grid:
        """The grid of the plan with these steps (degree,) of the entries of a palette."""
        table = self.steps.copy()
        table[:, N_GROUPS:] = steps
        return replace(self, steps=table)._grid()

    def warn_if_coarser(self) -> None:
        """Warn the caller of `encode_files` where leaves are coarser than was asked for."""
        warn_if_coarser(self._grid(), self.steps, self.settings)
        rows = {0, self.n_levels} if self.n_levels == 1 else {self.n_levels}  # that leaves end in
        raised = {(row, int(kind)) for row in rows for kind in np.flatnonzero(self.raised[row])}
        for row, kind in sorted(raised):
            text = coarse_step(
                group_of_class(kind), self._got(row, kind), float(self.steps[row, kind])
            )
            warnings.warn(text, AccuracyWarning, stacklevel=4)

    def _got(self, row: int, kind: int) -> float:
        """The step that a row has on the grid, scene units."""
        return self.quantisers[row][kind].step * 2.0 ** -self.exponents[group_of_class(kind)]

    def _grid(self) -> Grid:
        stored = 0 if self.coarse is not None else self.sh_degree  # of the numbers of splats
        return Grid.of(stored, self.exponents, self.steps * 2.0**self.raised, self.settings)

    def _with_quantisers(self) -> Plan:
        return replace(self, quantisers=self._grid().quantisers)


def surveyed(partition: Partition) -> I64:
    """The tiles that are surveyed: evenly among all in order of the size of their splats.

    Each is in the middle of those that it stands for. Where some have far smaller splats than
    others, it is the first of these: tiles may have coarser steps than the stream, not finer ones.
    Those of few splats are left out.
    """
    n = len(partition.counts)
    order = np.array(sorted(range(n), key=lambda tile: (partition.size(tile), tile)))
    some: I64 = order[partition.counts[order] >= max(1, MIN_SHARE * partition.counts.max())]
    n_surveyed = min(MAX_SURVEYED, -(-len(some) // SURVEYED_EVERY))
    if not len(some):
        return some
    parts = np.arange(n_surveyed) / n_surveyed
    places = parts * (len(some) - 1)
    if partition.size(some[-1]) <= TIMES_ALIKE * partition.size(some[0]):
        places = (parts + 0.5 / n_surveyed) * len(some)
    return np.unique(some[places.astype(int)])


def worth_of_entries(partition: Partition, sharings: Sequence[Sharing]) -> F64:
    """(degree,) the mean of all entries, in prices of a bit, from that of surveyed tiles."""
    counts = partition.counts[surveyed(partition)]
    scale = partition.counts.sum() / max(counts.sum(), 1)
    worth: F64 = scale * np.sum([sharing.worth for sharing in sharings], axis=0)
    return worth / max(partition.n_vectors, 1)


def _pooled(place: tuple[int, int], needs: Sequence[Needs]) -> tuple[F64, F64]:
    """The alphas of a level and group of all tiles, and what they weigh."""
    found = [need.alphas[place] for need in needs if place in need.alphas]
    alphas, weights = zip(*found, strict=True)
    return np.concatenate(alphas), np.concatenate(weights)


def _raised(steps: F64, largest: float) -> I64:
    """`Plan.raised` for adds whose positions are so large: the rest is found as tiles are coded."""
    raised = np.zeros(steps.shape, np.int64)
    raised[0, 0] = max(0, math.ceil(math.log2(max(largest, 1e-300) / (MAX_ADD * steps[0, 0]))))
    return raised


def _shared_steps(steps: F64, n_coarse: int) -> F64:
    """(1 + L, K) steps that suit tiles with `steps` (S, 1 + L, K).

    The median; where a tile needs less than about 0.7 of it, a half, a quarter and so on. Those of
    the last coarse level are an odd number of those of a layer, as in `layers`.
    """
    shared: F64 = np.median(steps, axis=0)
    lacks = np.log2(shared / steps).max(axis=(0, 1))
    shared /= 2.0 ** np.maximum(np.ceil(lacks - 0.5), 0)
    shared[n_coarse:] = in_odd_numbers(shared[n_coarse:])
    return shared
