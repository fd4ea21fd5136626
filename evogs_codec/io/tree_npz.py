"""The uncompressed `.tree.npz` that third-party trainers hand over.

Roots are `means quats log_scales opacity_logits sh`. Level i has `L{i}_slot`, `L{i}_kind`,
`L{i}_generation`, `L{i}_psi_*` and `L{i}_alpha`, a row per record. Generations apply in rising
order; inside one, a C2 and an add take the next free slot in *row* order, while a `Step` numbers
all its C2s in slot order and then its adds. Reading therefore renumbers slots.

The levels are 1, 2, ... `L0_*` is an extension: records that refine the roots within level 0. It
is written only for trees that have such steps. So is `quanta`: it is of trees that were trained in
integers.

Letters: N roots, M records of a level, K SH coefficients, D channels (`splats`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from itertools import count
from typing import Any, BinaryIO, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.common.printable import shown
from evogs_codec.io.files import write_atomic
from evogs_codec.io.makers import MADE_BY
from evogs_codec.io.safe_npz import Npz
from evogs_codec.model.channels import N_GROUPS, n_channels, n_classes
from evogs_codec.model.splats import F32, I64, SplatParams, sh_degree_of
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = ["FORMAT", "read_tree", "write_tree"]

PathLike: TypeAlias = "str | os.PathLike[str]"

FORMAT = "evogs-tree 1"
MAX_SLOTS = 2**31 - 1  # slots are int32
MAX_DIGITS = 18  # of a level; Python reads no number of 4301
ADD_SLOT = -1  # what `slot` holds for an add


def read_tree(path: PathLike) -> EvolutionTree:
    """The tree of a `.tree.npz`; slots are renumbered to those of `EvolutionTree`.

    Raises:
        InputError: the file cannot be read or breaks a rule; the message names key and row.
    """
    with Npz(path) as npz:
        if (found := npz.text("format")) != FORMAT:
            raise npz.error("format", f"is '{shown(found)}', expected '{FORMAT}'")
        roots = _read_roots(npz)
        degree = roots.sh_degree
        steps = [Step.of_adds(0, roots.channels())]
        slots = _Slots(len(roots))
        for level in _levels(npz):
            steps += _read_level(npz, level, degree, slots)
        n_levels = steps[-1].level + 1
        quanta = _read_quanta(npz, n_levels, degree) if "quanta" in npz.names else ()
    return EvolutionTree(degree, tuple(steps), quanta)


def write_tree(path: PathLike, tree: EvolutionTree, *, made_by: str = "") -> None:
    """Write `tree` so that `read_tree` returns a tree with the same leaves at every level.

    Steps without records are not kept, except that every level stays. `made_by` is the command
    that the file names as its maker.

    Raises:
        OSError: the file cannot be written.
        ValueError: the tree has a palette, which the file has no place for.
    """
    if tree.palette is not None:
        raise ValueError("a .tree.npz has no palette: write the tree as it was lifted")
    d = n_channels(tree.sh_degree)
    steps = list(tree.steps)
    n_roots = int(bool(steps) and steps[0].level == 0)
    roots = steps[0].adds if n_roots else np.empty((d, 0), np.float32)
    arrays: dict[str, npt.NDArray[Any]] = {"format": np.array(FORMAT)}
    arrays |= _splat_arrays("", roots)
    for level in range(tree.n_levels):
        of_level = [step for step in steps[n_roots:] if step.level == level]
        if level or of_level:
            arrays |= _level_arrays(level, of_level, d)
    if tree.quanta:
        arrays["quanta"] = np.array(tree.quanta, np.float32)
    if made_by:
        arrays[MADE_BY] = np.array(made_by)

    def save(stream: BinaryIO) -> None:
        np.savez(stream, allow_pickle=False, **arrays)

    write_atomic(path, save)


# --------------------------------------------------------------------------------------- reading


class _Slots:
    """The slots while levels are read: which are live, and where the tree has them.

    Room doubles, so that a generation of a few records does not copy all slots.

    Attributes:
        n: slots there are.
    """

    def __init__(self, n_roots: int) -> None:
        self.n = n_roots
        self._tree_slot: I64 = np.arange(n_roots, dtype=np.int64)
        self._live = np.ones(n_roots, bool)

    def __len__(self) -> int:
        return self.n

    @property
    def tree_slot(self) -> I64:
        """(n,) the tree's number of each slot of the file."""
        return self._tree_slot[: self.n]

    @property
    def live(self) -> npt.NDArray[np.bool_]:
        """(n,) by slot of the file; may be written to."""
        return self._live[: self.n]

    def extend(self, tree_slots: I64) -> None:
        """New live slots with these numbers in the tree, in the order of the file."""
        end = self.n + len(tree_slots)
        if end > len(self._live):
            room = np.empty(max(end, 2 * len(self._live)) - self.n, np.int64)
            self._tree_slot = np.concatenate([self.tree_slot, room])
            self._live = np.concatenate([self.live, np.ones(len(room), bool)])
        self._tree_slot[self.n : end] = tree_slots
        self.n = end


def _read_roots(npz: Npz) -> SplatParams:
    shape = npz.shape("sh")
    if len(shape) != 3:
        raise npz.error("sh", f"has shape {shape}, expected (N, K, 3)")
    try:
        degree = sh_degree_of(shape[1])
    except ValueError as error:
        raise npz.error("sh", str(error)) from None
    _check_splat_shapes(npz, "", _n_rows(npz.shape("means")), degree)
    roots = _splats(npz, "")
    _check_finite(npz, "", roots, np.arange(len(roots)))
    return roots


def _levels(npz: Npz) -> range:
    """The levels that have keys: 1 to the last, and 0 where the roots have records too."""
    matches = (re.fullmatch(r"L([0-9]+)_.+", name) for name in npz.names)
    digits = {match[1] for match in matches if match}
    longest = max(digits, key=len, default="")
    if len(longest) > MAX_DIGITS:
        raise npz.error(f"L{shown(longest)}", f"is a level of {len(longest)} digits")
    found = {int(number) for number in digits}
    if not found:
        return range(0)
    last = max(found)
    gap = next(level for level in count(1) if level not in found)
    if gap < last:
        raise npz.error(f"L{gap}_slot", f"is missing, but there is a level {last}")
    return range(0 if 0 in found else 1, last + 1)


def _read_quanta(npz: Npz, n_levels: int, degree: int) -> tuple[tuple[float, ...], ...]:
    npz.check_shape("quanta", (1 + n_levels, n_classes(degree)))
    found = npz.floats("quanta")
    wrong = np.flatnonzero(~(np.isfinite(found) & (found > 0)).all(axis=1))
    if len(wrong):
        raise npz.error("quanta", f"row {wrong[0]} has a number that is not finite and above 0")
    return tuple(map(tuple, found.tolist()))


def _read_level(npz: Npz, level: int, degree: int, slots: _Slots) -> list[Step]:
    """One step per generation; one empty step where the level has no records."""
    prefix = f"L{level}_"
    m = _n_rows(npz.shape(prefix + "slot"))
    for name in ("slot", "kind", "generation"):
        npz.check_shape(prefix + name, (m,))
    npz.check_shape(prefix + "alpha", (m, N_GROUPS))
    _check_splat_shapes(npz, prefix + "psi_", m, degree)

    slot = npz.integers(prefix + "slot", ADD_SLOT, MAX_SLOTS)
    kind = npz.integers(prefix + "kind", Kind.REFINE, Kind.ADD)
    generation = npz.integers(prefix + "generation", 0, MAX_SLOTS)
    psi = _splats(npz, prefix + "psi_")
    alpha = npz.floats(prefix + "alpha")
    wrong = np.flatnonzero((slot == ADD_SLOT) != (kind == Kind.ADD))
    if len(wrong):
        row = wrong[0]
        expected = "-1 for an add" if kind[row] == Kind.ADD else "the slot of a splat"
        raise npz.error(prefix + "slot", f"row {row} is {slot[row]}, expected {expected}")
    _check_finite(npz, prefix + "psi_", psi, np.flatnonzero(kind != Kind.DROP))
    split_rows = np.flatnonzero(kind == Kind.SPLIT)
    _check_rows(npz, prefix + "alpha", alpha[split_rows], split_rows)

    channels = psi.channels()
    steps = []
    for rows in _generations(generation):
        named = rows[kind[rows] != Kind.ADD]
        _check_slots(npz, prefix + "slot", slot, named, slots)
        steps.append(_step(level, rows, (slot, kind), channels, alpha, slots))
    return steps or [Step.of_adds(level, channels[:, :0])]


def _generations(generation: I64) -> Iterator[I64]:
    """Rows of each generation, in rising order of generation and in row order inside one."""
    order = np.argsort(generation, kind="stable")
    starts = np.flatnonzero(np.diff(generation[order])) + 1
    if len(order):
        yield from np.split(order, starts)


def _check_slots(npz: Npz, key: str, slot: I64, named: I64, slots: _Slots) -> None:
    """Refuse slots that no live splat has before the generation, and slots named twice in it."""
    n = len(slots)
    wrong = named[slot[named] >= n]
    if len(wrong):
        row = wrong[0]
        raise npz.error(
            key, f"row {row} is {slot[row]}, but before its generation there are {n} slots"
        )
    dead = named[~slots.live[slot[named]]]
    if len(dead):
        raise npz.error(key, f"row {dead[0]} is {slot[dead[0]]}, which was dropped earlier")
    order = named[np.argsort(slot[named], kind="stable")]
    twice = order[1:][np.diff(slot[order]) == 0]
    if len(twice):
        row = twice.min()
        raise npz.error(key, f"row {row} is {slot[row]}, as an earlier row of its generation")


def _step(
    level: int,
    rows: I64,
    columns: tuple[I64, I64],
    psi: F32,
    alpha: F32,
    slots: _Slots,
) -> Step:
    """The step of one generation, whose new slots are entered in `slots`.

    Args:
        level: its label.
        rows: rows of the generation, in row order.
        columns: slot and kind, each (M,).
        psi: (D, M).
        alpha: (M, 5).
        slots: the slots before the generation; extended.
    """
    slot, kind = columns
    adds = rows[kind[rows] == Kind.ADD]
    named = rows[kind[rows] != Kind.ADD]
    named = named[np.argsort(slots.tree_slot[slot[named]])]
    splits = named[kind[named] == Kind.SPLIT]
    step = Step(
        level,
        slots.tree_slot[slot[named]].astype(np.int32),
        kind[named].astype(np.uint8),
        psi[:, named[kind[named] != Kind.DROP]],
        np.ascontiguousarray(alpha[splits].T),
        psi[:, adds],
    )
    # The tree numbers C2s in slot order, then adds; the file numbers both in row order.
    makers = np.concatenate([splits, adds])
    numbers = len(slots) + np.arange(len(makers), dtype=np.int64)
    slots.live[slot[named[kind[named] == Kind.DROP]]] = False
    slots.extend(numbers[np.argsort(_rank(rows, makers))])
    return step


def _rank(rows: I64, some: I64) -> I64:
    """Place in `rows` (which rises) of each of `some`."""
    return np.searchsorted(rows, some).astype(np.int64)


_FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")


def _check_splat_shapes(npz: Npz, prefix: str, n: int, degree: int) -> None:
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, (degree + 1) ** 2, 3))
    for name, shape in zip(_FIELDS, shapes, strict=True):
        npz.check_shape(prefix + name, shape)


def _splats(npz: Npz, prefix: str) -> SplatParams:
    return SplatParams(*(npz.floats(prefix + name) for name in _FIELDS))


def _check_finite(npz: Npz, prefix: str, splats: SplatParams, rows: I64) -> None:
    if splats.take(rows).finite().all():
        return
    for name in _FIELDS:
        _check_rows(npz, prefix + name, getattr(splats, name)[rows], rows)


def _check_rows(npz: Npz, key: str, values: F32, rows: I64) -> None:
    """Refuse `values`, those of `rows`, unless all are finite."""
    bad = rows[np.nonzero(~np.isfinite(values))[0]]
    if len(bad):
        raise npz.error(key, f"row {bad[0]} has a number that is not finite in float32")


def _n_rows(shape: tuple[int, ...]) -> int:
    """Rows of an array; a scalar has none, and the check of its shape will say so."""
    return shape[0] if shape else 0


# --------------------------------------------------------------------------------------- writing


def _level_arrays(level: int, steps: list[Step], d: int) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a level; its steps are generations 0, 1, ..."""
    slot, kind, generation = [], [], []
    psi, alpha = [np.empty((d, 0), np.float32)], [np.empty((0, N_GROUPS), np.float32)]
    for k, step in enumerate(steps):
        r, m = len(step.slots), len(step.slots) + step.n_adds
        slot += [step.slots, np.full(step.n_adds, ADD_SLOT)]
        kind += [step.kinds, np.full(step.n_adds, Kind.ADD)]
        generation.append(np.full(m, k))
        full_psi = np.zeros((d, m), np.float32)
        full_psi[:, :r][:, step.kinds != Kind.DROP] = step.psi
        full_psi[:, r:] = step.adds
        full_alpha = np.zeros((m, N_GROUPS), np.float32)
        full_alpha[:r][step.kinds == Kind.SPLIT] = step.alpha.T
        psi.append(full_psi)
        alpha.append(full_alpha)
    prefix = f"L{level}_"
    # One byte holds 256 generations; a level with more steps takes the integers it needs.
    generation_type = np.uint8 if len(steps) <= 256 else np.int32
    return {
        prefix + "slot": np.concatenate([np.empty(0), *slot]).astype(np.int32),
        prefix + "kind": np.concatenate([np.empty(0), *kind]).astype(np.uint8),
        prefix + "generation": np.concatenate([np.empty(0), *generation]).astype(generation_type),
        **_splat_arrays(prefix + "psi_", np.concatenate(psi, axis=1)),
        prefix + "alpha": np.concatenate(alpha),
    }


def _splat_arrays(prefix: str, channels: F32) -> dict[str, npt.NDArray[Any]]:
    splats = SplatParams.from_channels(channels)
    return {prefix + name: getattr(splats, name) for name in _FIELDS}
