"""Blocks: leaves that were split, or refined, together, and what follows from them.

A `Collinear` block is the paper's C1 = P + psi, C2 = P - alpha * psi, with alpha learned (option
D), one (option C), or one but for sizes and opacities (mixed trees). A `Free` block has two
independent children: C1 = P + psi, C2 = P + psi' (option B), or without P (option A). C1 takes the
slot of P, C2 the next free one. A `Refined` block has one child, C = P + psi. `evolve` makes the
leaves of all blocks of a level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from evogs_codec import InputError, SplatParams
from reference_trainer.models import kernels
from reference_trainer.models.adam import GROUPS, Variable, splat_variables
from reference_trainer.models.saved import Arrays, taken, taken_number
from reference_trainer.models.tensors import SplatTensors

__all__ = ["Block", "Collinear", "Free", "Refined", "evolve", "restored", "rows_of"]

Array = npt.NDArray[Any]
I64 = npt.NDArray[np.int64]
Context: TypeAlias = Any  # torch gives it no type
Argument: TypeAlias = Any
# Their places are in checkpoints.
KINDS = ("learned", "fixed", "residuals", "children", "refined", "shrinking")
# Of collinear ones: groups whose alpha is trained.
LEARNED = {"learned": GROUPS, "fixed": (), "shrinking": ("scale", "opacity")}


class Block(Protocol):
    """m leaves split together.

    Attributes:
        slots: (m,) rising, slots of the parents and then of the C1s.
        first: slot of the first C2.
        n_new: slots that it makes: m, or none.
    """

    slots: I64
    first: int

    @property
    def n_new(self) -> int:
        """Slots that it makes."""

    @property
    def kind(self) -> str:
        """Of `KINDS`."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        """What is trained."""

    def tensors(self) -> list[Tensor]:
        """What it is evolved with, as inputs of a torch function."""

    def evolve(self, group: int, values: Array) -> None:
        """Parents become children, in one group of the values (S, d) of the slots."""

    def pull_back(self, group: int, g: Array, grads: list[Array]) -> None:
        """The gradient after `evolve` becomes that before; fills those to `tensors`."""

    def evolve_rows(self, values: Tensor, rows: Tensor) -> None:
        """`evolve` of all groups, values (S, D), by torch's own operations; `rows` are `slots`."""

    def pull_back_rows(self, g: Tensor, rows: Tensor) -> list[Tensor]:
        """The gradient (S, D) after `evolve_rows` becomes that before.

        Returns the gradients to `tensors`.
        """

    def changes(self, parents: Array) -> tuple[Array, Array]:
        """C1 - P and C2 - P, (m, D) each, for parents (m, D), in channel order."""

    def arrays(self, prefix: str) -> Arrays:
        """All of it, for a checkpoint."""


@dataclass
class Collinear:
    """C1 = P + psi, C2 = P - alpha * psi.

    Attributes:
        psi: a variable per group.
        alpha: (m, 5), one column per group.
        kind: of `LEARNED`.
    """

    slots: I64
    first: int
    psi: tuple[Variable, ...]
    alpha: Variable
    kind: str

    @staticmethod
    def of(
        slots: I64,
        first: int,
        psi: SplatParams,
        alpha: Array,
        kind: str,
        device: torch.device,
    ) -> Collinear:
        """A new block."""
        factors = Variable.of(torch.tensor(alpha, device=device), "alpha")
        factors.value.requires_grad_(bool(LEARNED[kind]))
        psis = splat_variables(SplatTensors.of(psi, device))
        return Collinear(slots, first, psis, factors, kind)

    @property
    def n_new(self) -> int:
        """A C2 each."""
        return len(self.slots)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """psi, and alpha where it is learned."""
        return (*self.psi, self.alpha) if LEARNED[self.kind] else self.psi

    def tensors(self) -> list[Tensor]:
        """Psi of the five groups, alpha."""
        return [variable.value for variable in (*self.psi, self.alpha)]

    def evolve(self, group: int, values: Array) -> None:
        """Parents become children."""
        psi, alpha = _array(self.psi[group]), _array(self.alpha)[:, group]
        kernels.evolve(values, self.slots, self.first, psi, alpha)

    def pull_back(self, group: int, g: Array, grads: list[Array]) -> None:
        """The gradient after `evolve` becomes that before."""
        psi, alpha = _array(self.psi[group]), _array(self.alpha)[:, group]
        to_psi, to_alpha = _flat(grads[group]), grads[5][:, group]
        kernels.evolve_gradient(g, self.slots, self.first, psi, alpha, to_psi, to_alpha)
        if GROUPS[group] not in LEARNED[self.kind]:
            to_alpha[:] = 0

    def evolve_rows(self, values: Tensor, rows: Tensor) -> None:
        """Parents become children."""
        psi, parents = _joined(self.psi), values[rows]
        values[self.first : self.first + len(rows)] = parents - self._factors() * psi
        values[rows] = parents + psi

    def pull_back_rows(self, g: Tensor, rows: Tensor) -> list[Tensor]:
        """The gradient after `evolve_rows` becomes that before."""
        psi, to_c1, to_c2 = _joined(self.psi), g[rows], g[self.first : self.first + len(rows)]
        to_psi = _split(to_c1 - self._factors() * to_c2, self.psi)
        if LEARNED[self.kind]:
            to_alpha = (psi * to_c2) @ self._learned().T
            to_alpha.neg_()
        else:
            to_alpha = torch.zeros_like(self.alpha.value)
        g[rows] = to_c1 + to_c2
        return [*to_psi, to_alpha]

    def _factors(self) -> Tensor:
        """(m, D) alpha of each number of psi."""
        return self.alpha.value.detach() @ _members(self._widths(), GROUPS, self.alpha.value.device)

    def _learned(self) -> Tensor:
        """(5, D) 1 where a number is of a group whose alpha is learned, else 0."""
        return _members(self._widths(), LEARNED[self.kind], self.alpha.value.device)

    def _widths(self) -> tuple[int, ...]:
        """(5,) numbers of psi in each group."""
        return tuple(math.prod(variable.value.shape[1:]) for variable in self.psi)

    def changes(self, parents: Array) -> tuple[Array, Array]:
        """C1 - P and C2 - P."""
        psi = np.concatenate([_array(variable) for variable in self.psi], axis=1)
        widths = [_array(variable).shape[1] for variable in self.psi]
        return psi, -np.repeat(_array(self.alpha), widths, axis=1) * psi

    def arrays(self, prefix: str) -> Arrays:
        """For a checkpoint."""
        return _saved(prefix, self, (*self.psi, self.alpha))


@dataclass
class Free:
    """C1 = keep P + psi, C2 = keep P + psi'; keep is 1 or 0.

    Attributes:
        variables: psi of the five groups, then psi'.
        keep: whether children follow their parent.
    """

    slots: I64
    first: int
    variables: tuple[Variable, ...]
    keep: bool

    @staticmethod
    def of(
        slots: I64,
        first: int,
        psi1: SplatParams,
        psi2: SplatParams,
        keep: bool,
        device: torch.device,
    ) -> Free:
        """A new block."""
        both = [splat_variables(SplatTensors.of(psi, device)) for psi in (psi1, psi2)]
        return Free(slots, first, (*both[0], *both[1]), keep)

    @property
    def n_new(self) -> int:
        """A C2 each."""
        return len(self.slots)

    @property
    def kind(self) -> str:
        """Children that follow their parent, or do not."""
        return "residuals" if self.keep else "children"

    def tensors(self) -> list[Tensor]:
        """Psi of the five groups, then psi'."""
        return [variable.value for variable in self.variables]

    def evolve(self, group: int, values: Array) -> None:
        """Parents become children."""
        psi1, psi2 = _array(self.variables[group]), _array(self.variables[5 + group])
        kernels.evolve_free(values, self.slots, self.first, psi1, psi2, float(self.keep))

    def pull_back(self, group: int, g: Array, grads: list[Array]) -> None:
        """The gradient after `evolve` becomes that before."""
        outs = _flat(grads[group]), _flat(grads[5 + group])
        kernels.evolve_free_gradient(g, self.slots, self.first, float(self.keep), *outs)

    def evolve_rows(self, values: Tensor, rows: Tensor) -> None:
        """Parents become children."""
        parents = float(self.keep) * values[rows]
        values[self.first : self.first + len(rows)] = parents + _joined(self.variables[5:])
        values[rows] = parents + _joined(self.variables[:5])

    def pull_back_rows(self, g: Tensor, rows: Tensor) -> list[Tensor]:
        """The gradient after `evolve_rows` becomes that before."""
        to_c1, to_c2 = g[rows], g[self.first : self.first + len(rows)]
        g[rows] = float(self.keep) * (to_c1 + to_c2)
        return [*_split(to_c1, self.variables[:5]), *_split(to_c2.clone(), self.variables[5:])]

    def changes(self, parents: Array) -> tuple[Array, Array]:
        """C1 - P and C2 - P."""
        arrays = [_array(variable) for variable in self.variables]
        first, second = (np.concatenate(arrays[i : i + 5], axis=1) for i in (0, 5))
        return (first, second) if self.keep else (first - parents, second - parents)

    def arrays(self, prefix: str) -> Arrays:
        """For a checkpoint."""
        return _saved(prefix, self, self.variables)


@dataclass
class Refined:
    """C = P + psi.

    Attributes:
        variables: psi of the five groups.
    """

    slots: I64
    first: int
    variables: tuple[Variable, ...]
    n_new = 0
    kind = "refined"

    @staticmethod
    def of(slots: I64, first: int, like: SplatTensors) -> Refined:
        """A new block that changes nothing yet; the values of `like` do not matter."""
        psi = SplatTensors(*(torch.zeros_like(x[: len(slots)]) for x in like))
        return Refined(slots, first, splat_variables(psi))

    def tensors(self) -> list[Tensor]:
        """Psi of the five groups."""
        return [variable.value for variable in self.variables]

    def evolve(self, group: int, values: Array) -> None:
        """Parents become children."""
        values[self.slots] += _array(self.variables[group])

    def pull_back(self, group: int, g: Array, grads: list[Array]) -> None:
        """The gradient is the same before and after."""
        _flat(grads[group])[:] = g[self.slots]

    def evolve_rows(self, values: Tensor, rows: Tensor) -> None:
        """Parents become children."""
        values[rows] += _joined(self.variables)

    def pull_back_rows(self, g: Tensor, rows: Tensor) -> list[Tensor]:
        """The gradient is the same before and after."""
        return _split(g[rows], self.variables)

    def changes(self, parents: Array) -> tuple[Array, Array]:
        """C - P, twice."""
        psi = np.concatenate([_array(variable) for variable in self.variables], axis=1)
        return psi, psi

    def arrays(self, prefix: str) -> Arrays:
        """For a checkpoint."""
        return _saved(prefix, self, self.variables)


def evolve(base: SplatTensors, blocks: list[Block], live: I64) -> SplatTensors:
    """The leaves in slots `live`, by compiled loops, differentiable in the blocks' tensors."""
    tensors = [tensor for block in blocks for tensor in block.tensors()]
    return SplatTensors(*_Evolve.apply(base, blocks, live, *tensors))  # type: ignore[no-untyped-call]


class _Evolve(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Context, *args: Argument) -> tuple[Tensor, ...]:
        base, blocks, live, *_ = args
        n_slots = len(base.means) + sum(block.n_new for block in blocks)
        ctx.blocks, ctx.live, ctx.n_slots = blocks, live, n_slots
        out = []
        for group, constants in enumerate(base):
            x = constants.numpy().reshape(len(constants), -1)
            values = np.empty((n_slots, x.shape[1]), x.dtype)
            values[: len(x)] = x
            for block in blocks:
                block.evolve(group, values)
            leaves = values if len(live) == n_slots else values[live]
            out.append(torch.from_numpy(leaves).reshape(len(live), *constants.shape[1:]))
        return tuple(out)

    @staticmethod
    def backward(ctx: Context, *grads: Tensor) -> tuple[Tensor | None, ...]:
        found: list[list[Tensor]] = [
            [torch.empty_like(tensor) for tensor in block.tensors()] for block in ctx.blocks
        ]
        for group, grad in enumerate(grads):
            flat = grad.reshape(len(grad), math.prod(grad.shape[1:])).numpy()
            g = np.zeros((ctx.n_slots, flat.shape[1]), flat.dtype)
            g[ctx.live] = flat
            for block, outs in zip(reversed(ctx.blocks), reversed(found), strict=True):
                block.pull_back(group, g, [x.numpy() for x in outs])
        return (None, None, None, *(x for outs in found for x in outs))


def restored(arrays: Arrays, prefix: str, base: SplatTensors, n_slots: int) -> Block:
    """The block that `arrays` saved, of a frontier on `base` that had `n_slots` slots before it.

    Raises:
        InputError: the arrays are of no such block.
    """
    kind = KINDS[taken_number(arrays, f"{prefix}.kind", 0, len(KINDS) - 1)]
    first = taken_number(arrays, f"{prefix}.first", n_slots, n_slots)
    slots: I64 = taken(arrays, f"{prefix}.slots", np.int64, None)
    if len(slots) and not (slots[0] >= 0 and slots[-1] < n_slots and (np.diff(slots) > 0).all()):
        raise InputError(f"{prefix}.slots do not rise from 0 or more to below {n_slots}")

    def variable(i: int, group: str, *sides: int) -> Variable:
        device = base.means.device
        return Variable.restored(arrays, f"{prefix}.{i}", group, device, len(slots), *sides)

    def psi(start: int) -> tuple[Variable, ...]:
        groups = zip(GROUPS, base, strict=True)
        return tuple(
            variable(i, group, *like.shape[1:]) for i, (group, like) in enumerate(groups, start)
        )

    if kind in LEARNED:
        alpha = variable(5, "alpha", len(GROUPS))
        alpha.value.requires_grad_(bool(LEARNED[kind]))
        return Collinear(slots, first, psi(0), alpha, kind)
    if kind == "refined":
        return Refined(slots, first, psi(0))
    return Free(slots, first, (*psi(0), *psi(5)), kind == "residuals")


def rows_of(tensors: Sequence[Tensor]) -> Tensor:
    """(m, D) of tensors (m, ...)."""
    return torch.cat([x.reshape(len(x), math.prod(x.shape[1:])) for x in tensors], dim=1)


def _saved(prefix: str, block: Block, variables: tuple[Variable, ...]) -> Arrays:
    out: Arrays = {
        f"{prefix}.kind": np.array(KINDS.index(block.kind)),
        f"{prefix}.slots": block.slots,
        f"{prefix}.first": np.array(block.first),
    }
    for i, variable in enumerate(variables):
        out |= variable.arrays(f"{prefix}.{i}")
    return out


@lru_cache(maxsize=16)
def _members(widths: tuple[int, ...], groups: tuple[str, ...], device: torch.device) -> Tensor:
    """(5, D) 1 where a number is of a group, and that is one of `groups`; else 0.

    It is made once. One product with it replaces a call for each group.
    """
    found = np.zeros((len(widths), sum(widths)), np.float32)
    for row, (end, width) in enumerate(zip(np.cumsum(widths), widths, strict=True)):
        found[row, end - width : end] = GROUPS[row] in groups
    return torch.from_numpy(found).to(device)


def _joined(variables: tuple[Variable, ...]) -> Tensor:
    """(m, D) their numbers, one after the other."""
    return rows_of([variable.value.detach() for variable in variables])


def _split(joined: Tensor, variables: tuple[Variable, ...]) -> list[Tensor]:
    """(m, D) numbers in the shapes of the variables."""
    shapes = [variable.value.shape for variable in variables]
    parts = torch.split(joined, [math.prod(shape[1:]) for shape in shapes], dim=1)
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def _array(variable: Variable) -> Array:
    return _flat(variable.value.detach().cpu().numpy())


def _flat(array: Array) -> Array:
    return array.reshape(len(array), -1)
