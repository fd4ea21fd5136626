"""`EvolutionTree`: a list of steps over slots, in floating point (spec 3; paper equation 5).

A tree has no pointers. Each `Step` holds records that change the leaf set, which lives in an array
of slots: `refine` (C = P + psi), `split` (C1 = P + psi takes the slot, C2 = P - alpha * psi the
next free one), `drop` (the slot is empty from here on) and `add` (a new splat in the next free
slot).

Letters: R records of a step that name a slot, P <= R of them with a psi, S <= P splits, A adds,
D channels (`splats`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import islice
from typing import Protocol
from weakref import WeakKeyDictionary, ref

import numpy as np
import numpy.typing as npt

from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS, n_channels
from evogs_codec.model.components import Components
from evogs_codec.model.palette import Palette
from evogs_codec.model.splats import F32, F64, I32, I64, U8, SplatParams

__all__ = ["EvolutionTree", "Kind", "Slots", "Step", "columns_of"]


class Kind(IntEnum):
    """What a record does to the slots (spec 3.3); the numbers are those of the stream."""

    REFINE = 0
    SPLIT = 1
    DROP = 2
    ADD = 3


def columns_of(kinds: U8, rows: npt.NDArray[np.integer]) -> tuple[I64, I64]:
    """Which columns of psi, and of alpha, some records of a step have.

    Args:
        kinds: (R,) of all its records.
        rows: which of them, in any order.

    Returns:
        (P,) columns of psi, of the refines and splits of `rows`, and (S,) of alpha, of the splits.
    """
    has_psi, is_split = kinds != Kind.DROP, kinds == Kind.SPLIT
    psi = (np.cumsum(has_psi) - 1)[rows[has_psi[rows]]]
    alpha = (np.cumsum(is_split) - 1)[rows[is_split[rows]]]
    return psi, alpha


def _no_picks() -> I32:
    return np.empty(0, np.int32)


@dataclass(frozen=True, eq=False)
class Step:
    """Records applied together.

    Attributes:
        level: label of the step; never falls along a tree.
        slots: (R,) int32, strictly increasing, slots that are live before the step.
        kinds: (R,) uint8 of `Kind.REFINE`, `SPLIT`, `DROP`.
        psi: (D, P) float32, a column per refine or split, in slot order.
        alpha: (5, S) float32, a column per split, rows in group order.
        adds: (D, A) float32, a column per add.
        picks: of a tree with a palette, (n_new,) int32 of each C2, then of each add; (0,) if each
            C2 takes that of its parent and adds have none, and without a palette.
        changed_picks: (P,) int32 of the refined splats and the C1s; (0,) if they keep theirs.
    """

    level: int
    slots: I32
    kinds: U8
    psi: F32
    alpha: F32
    adds: F32
    picks: I32 = field(default_factory=_no_picks)
    changed_picks: I32 = field(default_factory=_no_picks)

    @property
    def n_adds(self) -> int:
        """A."""
        return int(self.adds.shape[1])

    @property
    def n_new(self) -> int:
        """Slots the step makes: a C2 per split, then the adds."""
        return int(self.alpha.shape[1]) + self.n_adds

    @staticmethod
    def of_adds(level: int, adds: F32) -> Step:
        """A step that only adds the columns of `adds` (D, A)."""
        d = len(adds)
        return Step(
            level,
            np.empty(0, np.int32),
            np.empty(0, np.uint8),
            np.empty((d, 0), np.float32),
            np.empty((N_GROUPS, 0), np.float32),
            adds,
        )

    @staticmethod
    def of_splits(
        level: int, slots: npt.NDArray[np.integer], psi: F32 | F64, alpha: F32 | F64
    ) -> Step:
        """A step that splits `slots` (S,), in increasing order, by psi (D, S) and alpha (5, S)."""
        return Step(
            level,
            slots.astype(np.int32),
            np.full(len(slots), Kind.SPLIT, np.uint8),
            psi.astype(np.float32),
            alpha.astype(np.float32),
            np.empty((len(psi), 0), np.float32),
        )

    @staticmethod
    def of_refines(level: int, slots: npt.NDArray[np.integer], psi: F64) -> Step:
        """A step that adds psi (D, P) to `slots` (P,), in increasing order."""
        return Step(
            level,
            slots.astype(np.int32),
            np.full(len(slots), Kind.REFINE, np.uint8),
            psi.astype(np.float32),
            np.empty((N_GROUPS, 0), np.float32),
            np.empty((len(psi), 0), np.float32),
        )


class Picking(Protocol):
    """A step of a tree, in floats or in integers."""

    @property
    def slots(self) -> I32: ...
    @property
    def kinds(self) -> U8: ...
    @property
    def picks(self) -> I32: ...
    @property
    def changed_picks(self) -> I32: ...


@dataclass(frozen=True, eq=False)
class Slots:
    """State of the slots after some steps: `values` (D, n) float64, `live` (n,) bool.

    With a palette also `picks` (n,).
    """

    values: F64
    live: npt.NDArray[np.bool_]
    palette: Palette | None = None
    picks: I32 = field(default_factory=_no_picks)

    def splats(self) -> SplatParams:
        """The live splats in slot order."""
        core = SplatParams.from_channels(self.values[:, self.live])
        if self.palette is None:
            return core
        rest = self.palette.rows_of(self.picks[self.live])
        sh = np.concatenate([core.sh, rest.reshape(len(core), -1, 3)], axis=1)
        return replace(core, sh=sh)


@dataclass(frozen=True, eq=False)
class EvolutionTree:
    """Steps over slots; step 0 holds only adds (spec 3.4).

    Attributes:
        sh_degree: 0..3, of the channels of the steps; 0 of a tree with a palette.
        steps: in order.
        quanta: of a tree that was trained in integers, (1 + n_levels, 5 + sh_degree): the steps of
            quantisers (spec 5.3) that its adds and the psi of each level are multiples of, per
            class (spec 3.2). Else empty.
        palette: the SH above band 0, where splats share them.

    Raises:
        ValueError: on construction, if a step breaks a rule, or quanta have another shape or are
            not finite and above 0; the message names step and rule.
    """

    sh_degree: int
    steps: tuple[Step, ...]
    quanta: tuple[tuple[float, ...], ...] = ()
    palette: Palette | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        object.__setattr__(self, "quanta", tuple(map(tuple, self.quanta)))
        live = np.ones(sum(step.n_new for step in self.steps), bool)
        level = n = 0
        for k, step in enumerate(self.steps):
            _check_step(step, k, live[:n], level, n_channels(self.sh_degree))
            if self.palette is not None:
                _check_picks(step, k, self.palette)
            live[step.slots[step.kinds == Kind.DROP]] = False
            level, n = step.level, n + step.n_new
        if self.quanta:
            shape = (1 + self.n_levels, N_GROUPS + self.sh_degree)
            found = np.array(self.quanta) if len(set(map(len, self.quanta))) == 1 else np.empty(0)
            if found.shape != shape or not np.all(np.isfinite(found) & (found > 0)):
                raise ValueError(f"quanta are not {shape} finite numbers above 0")

    def __repr__(self) -> str:
        return (
            f"EvolutionTree({self.n_leaves} leaves, {self.n_levels} levels,"
            f" {len(self.steps)} steps, SH degree {self.shown_degree})"
        )

    @property
    def shown_degree(self) -> int:
        """SH degree of the splats."""
        return self.sh_degree if self.palette is None else self.palette.degree

    @property
    def components(self) -> Components:
        """Those of a stream of the tree (spec 3.5, 12)."""
        return Components(self.shown_degree, self.palette is not None)

    @property
    def n_levels(self) -> int:
        """Levels 0..N, that is N + 1; a tree without steps has none."""
        return self.steps[-1].level + 1 if self.steps else 0

    @property
    def n_leaves(self) -> int:
        """Live splats after the last step."""
        new = sum(step.n_new for step in self.steps)
        return new - sum(int(np.count_nonzero(step.kinds == Kind.DROP)) for step in self.steps)

    def lineage(self) -> tuple[I64, npt.NDArray[np.bool_]]:
        """(n,) the slot that each slot was born from, -1 for adds; (n,) which are live at last."""
        n = 0
        born_from = np.full(sum(step.n_new for step in self.steps), -1)
        live = np.ones(len(born_from), bool)
        for step in self.steps:
            parents = step.slots[step.kinds == Kind.SPLIT]
            born_from[n : n + len(parents)] = parents
            live[step.slots[step.kinds == Kind.DROP]] = False
            n += step.n_new
        return born_from, live

    def states(self, channels: slice = slice(None)) -> Iterator[Slots]:
        """The slots after each step, evaluated in float64.

        The arrays of one state are overwritten by the next: copy what is kept.

        Args:
            channels: the only ones that `values` has; fewer take less time.
        """
        rows = range(n_channels(self.sh_degree))[channels]
        total = sum(step.n_new for step in self.steps)
        values = np.zeros((len(rows), total), np.float64)
        live = np.zeros(total, bool)
        picks = np.zeros(total, np.int32)
        n = 0
        for step in self.steps:
            take_picks(step, picks, n)
            n = _apply(step, values, rows, live, n)
            yield Slots(values[:, :n], live[:n], self.palette, picks[:n])

    def leaves(self, level: int | None = None) -> SplatParams:
        """Splats a renderer draws at `level` (the last one by default), in slot order.

        Raises:
            ValueError: the tree has no such level.
        """
        last = self.n_levels - 1
        level = last if level is None else level
        if not 0 <= level <= last:
            raise ValueError(f"level {level} is not one of 0..{last}")
        n_steps = sum(step.level <= level for step in self.steps)
        if not n_steps:
            return SplatParams.from_channels(np.zeros((n_channels(self.shown_degree), 0)))
        return next(islice(self.states(), n_steps - 1, None)).splats()

    def shared_leaves(self) -> SplatParams:
        """`leaves` of the last level, one object as long as somebody has it: not to be changed."""
        known = _leaves.get(self)
        found = known() if known else None
        if found is None:
            found = self.leaves()
            _leaves[self] = ref(found)
        return found

    def levels(self, first: int = 0) -> Iterator[SplatParams]:
        """`leaves` of each level, from `first` on."""
        states = self.states()
        shown = SplatParams.from_channels(np.zeros((n_channels(self.shown_degree), 0)))
        for level in range(first, self.n_levels):
            here = range(first + 1) if level == first else (level,)
            n_steps = sum(step.level in here for step in self.steps)
            if n_steps:
                shown = next(islice(states, n_steps - 1, None)).splats()
            yield shown

    @staticmethod
    def of_splats(splats: SplatParams) -> EvolutionTree:
        """The tree with one level whose roots are `splats`."""
        return EvolutionTree(splats.sh_degree, (Step.of_adds(0, splats.channels()),))


# Of trees, the `shared_leaves` that somebody still has.
_leaves: WeakKeyDictionary[EvolutionTree, ref[SplatParams]] = WeakKeyDictionary()


def take_picks(step: Picking, picks: I32, n: int) -> None:
    """Give slots the picks of a step, in place; n slots were there before, others have pick 0."""
    parents = step.slots[step.kinds == Kind.SPLIT]
    new = step.picks if len(step.picks) else picks[parents]
    if len(step.changed_picks):
        picks[step.slots[step.kinds != Kind.DROP]] = step.changed_picks
    picks[n : n + len(new)] = new


def alpha_channels(alpha: F32 | F64, d: int) -> F64:
    """(5, S) alpha per group spread over the D channels: (D, S) float64."""
    out = np.empty((d, alpha.shape[1]), np.float64)
    for group, channels in enumerate(GROUP_CHANNELS):
        out[channels] = alpha[group]
    return out


def _apply(step: Step, values: F64, rows: range, live: npt.NDArray[np.bool_], n: int) -> int:
    """Apply `step` in place to the channels `rows` of `n` used slots; returns the new count."""
    has_psi = step.kinds != Kind.DROP
    is_split = step.kinds[has_psi] == Kind.SPLIT
    splits = slice(None) if is_split.all() else np.flatnonzero(is_split)
    target = step.slots[has_psi].astype(np.intp)  # once: numpy would for each channel
    new = slice(n, n + step.alpha.shape[1])
    for alpha, group in zip(step.alpha.astype(np.float64), GROUP_CHANNELS, strict=True):
        channels = _common(range(len(step.psi))[group], rows)
        if not alpha.size and not step.psi[channels].any():
            continue  # as of the layers of precision
        own = slice(channels.start - rows.start, channels.stop - rows.start)
        for x, psi in zip(values[own], step.psi[channels].astype(np.float64), strict=True):
            parents = x.take(target)
            x[target] = parents + psi
            np.subtract(parents[splits], alpha * psi[splits], out=x[new])
    values[:, new.stop : n + step.n_new] = step.adds[rows.start : rows.stop]
    live[n : n + step.n_new] = True
    dropped = step.slots[~has_psi]
    live[dropped] = False
    values[:, dropped] = 0.0
    return n + step.n_new


def _common(a: range, b: range) -> slice:
    """What is in two ranges of steps of 1."""
    begin = min(max(a.start, b.start), b.stop)
    return slice(begin, max(begin, min(a.stop, b.stop)))


def _check_step(step: Step, k: int, live: npt.NDArray[np.bool_], level: int, d: int) -> None:
    """Raise `ValueError` unless `step` may follow a state with these live slots."""
    r = len(step.slots)
    if step.level < level:
        raise ValueError(f"step {k}: level {step.level} after level {level}")
    if k == 0 and r:
        raise ValueError("step 0: only adds are allowed")
    if step.kinds.shape != (r,) or np.any(step.kinds > Kind.DROP):
        raise ValueError(f"step {k}: kinds must be {r} values of refine, split or drop")
    n_psi = int(np.count_nonzero(step.kinds != Kind.DROP))
    n_splits = int(np.count_nonzero(step.kinds == Kind.SPLIT))
    _check_numbers(step.psi, (d, n_psi), f"step {k}: psi")
    _check_numbers(step.alpha, (N_GROUPS, n_splits), f"step {k}: alpha")
    _check_numbers(step.adds, (d, step.n_adds), f"step {k}: adds")
    if not r:
        return
    if np.any(np.diff(step.slots.astype(np.int64)) <= 0):
        raise ValueError(f"step {k}: slots must be strictly increasing")
    if step.slots[0] < 0 or step.slots[-1] >= len(live):
        raise ValueError(f"step {k}: slots must be in 0..{len(live) - 1}")
    if not live[step.slots].all():
        dead = int(step.slots[~live[step.slots]][0])
        raise ValueError(f"step {k}: slot {dead} was dropped earlier")


def _check_picks(step: Step, k: int, palette: Palette) -> None:
    n_psi, n_entries = step.psi.shape[1], palette.entries.shape[1]
    if step.picks.shape not in ((0,), (step.n_new,)):
        raise ValueError(f"step {k}: {len(step.picks)} picks of {step.n_new} new slots")
    if len(step.changed_picks) and len(step.picks) < step.n_new:
        raise ValueError(f"step {k}: picks change, and new slots have none")
    if step.changed_picks.shape not in ((0,), (n_psi,)):
        raise ValueError(f"step {k}: {len(step.changed_picks)} changed picks of {n_psi} slots")
    for picks in (step.picks, step.changed_picks):
        if picks.size and not 0 <= picks.min() <= picks.max() <= n_entries:
            raise ValueError(f"step {k}: picks must be in 0..{n_entries}")


def _check_numbers(array: F32, shape: tuple[int, ...], name: str) -> None:
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has a value that is not finite")
