"""Adam over rows: a `Variable` is a tensor with its moments, and knows its group.

3DGS steps with eps 1e-15, so a splat that no picture has shown yet still moves at full rate once
one does. Variables are never resized in place: `rows` and `appended` make new ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from reference_trainer.config import Rates
from reference_trainer.models.kernels import adam, shrink
from reference_trainer.models.saved import Arrays, taken, taken_number
from reference_trainer.models.tensors import SplatTensors

__all__ = [
    "GROUPS",
    "RateTable",
    "Variable",
    "splat_tensors",
    "splat_variables",
    "step_all",
    "step_together",
]

GROUPS = ("position", "rotation", "scale", "opacity", "sh")
N_BAND_0 = 3  # numbers of SH band 0, which come first
BETA1, BETA2, EPS = 0.9, 0.999, 1e-15
MAX_STEPS = 2**31 - 1
# Steps before bits cost something: what no view has shown yet has no gradient to hold it.
FREE_STEPS = 100


@dataclass
class Variable:
    """A tensor that is trained.

    Attributes:
        value: (n, ...), asks for gradients.
        group: which learning rate it has; one of `GROUPS`, or "alpha".
        m, v: first and second moments, shaped like `value`.
        t: steps made.
        quanta: (d,) of the numbers of a row, which cost bits where they are not 0; or None.
        n_still: so many numbers of a row, the first, stay as they are.
    """

    value: Tensor
    group: str
    m: Tensor
    v: Tensor
    t: int = 0
    quanta: npt.NDArray[np.float32] | None = None
    n_still: int = 0

    @staticmethod
    def of(value: Tensor, group: str) -> Variable:
        """Start training `value`."""
        x = value.detach().contiguous()
        return Variable(x.requires_grad_(True), group, torch.zeros_like(x), torch.zeros_like(x))

    def step(self, rates: RateTable) -> None:
        """Follow the gradient, if there is one, and forget it."""
        if self.value.grad is None or not self.value.numel():  # all was pruned
            return
        self.t += 1
        n = len(self.value)
        tensors = (self.value.detach(), self.value.grad, self.m, self.v)
        x, g, m, v = (tensor.reshape(n, -1) for tensor in tensors)
        columns = self.columns(rates)
        adam(x.numpy(), g.numpy(), m.numpy(), v.numpy(), columns, BETA1, BETA2, EPS, self.t)
        quanta = self.costly(rates)
        if quanta is not None:
            shrink(x.numpy(), v.numpy(), columns, quanta, rates.price, BETA2, EPS, self.t)
        self.value.grad = None

    def columns(self, rates: RateTable) -> npt.NDArray[np.float32]:
        """(d,) learning rates of the numbers of a row."""
        return rates.columns(*self._kind)

    @property
    def _kind(self) -> tuple[str, int, int]:
        """Group, numbers of a row, and how many of them stay: those that are alike share rates."""
        return self.group, math.prod(self.value.shape[1:]), self.n_still

    def costly(self, rates: RateTable) -> npt.NDArray[np.float32] | None:
        """The quanta, if the numbers cost bits by now."""
        return self.quanta if rates.price > 0 and self.t > FREE_STEPS else None

    def rows(self, rows: Tensor) -> Variable:
        """Only these rows, with their moments."""
        kept = [x.detach()[rows] for x in (self.value, self.m, self.v)]
        return Variable(kept[0].requires_grad_(True), self.group, kept[1], kept[2], self.t)

    def appended(self, more: Tensor) -> Variable:
        """With these rows after the others; their moments are zero."""
        zeros = torch.zeros_like(more)
        value = torch.cat([self.value.detach(), more.detach()])
        m, v = torch.cat([self.m, zeros]), torch.cat([self.v, zeros])
        return Variable(value.requires_grad_(True), self.group, m, v, self.t)

    def arrays(self, prefix: str) -> Arrays:
        """All of it, for a checkpoint."""
        named = {"value": self.value.detach(), "m": self.m, "v": self.v}
        found: Arrays = {f"{prefix}.{name}": x.cpu().numpy() for name, x in named.items()}
        return found | {f"{prefix}.t": np.array(self.t)}

    @staticmethod
    def restored(
        arrays: Arrays, prefix: str, group: str, device: torch.device, *shape: int | None
    ) -> Variable:
        """The inverse of `arrays`, of a variable of this shape; a side of None may have any length.

        Raises:
            InputError: the arrays are no such variable.
        """
        sides = taken(arrays, f"{prefix}.value", np.float32, *shape).shape
        value, m, v = (
            torch.from_numpy(taken(arrays, f"{prefix}.{name}", np.float32, *sides)).to(device)
            for name in ("value", "m", "v")
        )
        t = taken_number(arrays, f"{prefix}.t", 0, MAX_STEPS)
        return Variable(value.requires_grad_(True), group, m, v, t)


def step_all(variables: Sequence[Variable], rates: RateTable) -> None:
    """`Variable.step` of all; on GPUs at once, where a step each is mostly the calls."""
    due = [v for v in variables if v.value.grad is not None and v.value.numel()]
    if not due or due[0].value.is_cpu:
        for variable in due:
            variable.step(rates)
    else:
        step_together(due, rates)


def step_together(variables: Sequence[Variable], rates: RateTable) -> None:
    """`Variable.step` of variables that all have gradients, by torch's own operations."""
    for variable in variables:
        variable.t += 1
    xs, ms, vs = ([getattr(v, n).detach() for v in variables] for n in ("value", "m", "v"))
    grads = [v.value.grad for v in variables if v.value.grad is not None]
    torch._foreach_lerp_(ms, grads, 1 - BETA1)
    torch._foreach_mul_(vs, BETA2)
    torch._foreach_addcmul_(vs, grads, grads, 1 - BETA2)
    roots = torch._foreach_div(vs, [1 - BETA2**v.t for v in variables])
    torch._foreach_sqrt_(roots)
    torch._foreach_add_(roots, EPS)
    steps = torch._foreach_div(ms, [1 - BETA1**v.t for v in variables])
    torch._foreach_div_(steps, roots)
    # Of rates, what is the same in all iterations is on the device; the rest is a number.
    kinds = [variable._kind for variable in variables]
    largest_of = {kind: float(rates.columns(*kind).max()) for kind in set(kinds)}
    largest = [largest_of[kind] for kind in kinds]
    parts = [_parts_of_rates(rates.rates, *kind) for kind in kinds]
    torch._foreach_mul_(steps, largest)
    for step, own in zip(steps, parts, strict=True):
        if own.min(initial=1) < 1:
            step.mul_(_row(own, step))
    torch._foreach_sub_(xs, steps)
    _shrink_costly(variables, roots, parts, largest, rates)
    for variable in variables:
        variable.value.grad = None


@lru_cache(maxsize=256)
def _parts_of_rates(rates: Rates, group: str, d: int, n_still: int) -> npt.NDArray[np.float32]:
    """(d,) rates of the numbers of a row, as parts of the largest: the same in all iterations."""
    columns = RateTable(rates, 1.0, 0.0).columns(group, d, n_still)
    parts: npt.NDArray[np.float32] = columns / (columns.max(initial=0) or 1)
    return parts


def _shrink_costly(
    variables: Sequence[Variable],
    roots: Sequence[Tensor],
    parts: Sequence[npt.NDArray[np.float32]],
    largest: Sequence[float],
    rates: RateTable,
) -> None:
    """`_shrink` of the variables whose numbers cost bits by now.

    Args:
        variables: that were stepped.
        roots: of their second moments.
        parts: (d,) rates of their numbers, as parts of the largest.
        largest: of these rates.
        rates: of the iteration.
    """
    costly = []
    for variable, root, part, rate in zip(variables, roots, parts, largest, strict=True):
        quanta = variable.costly(rates)
        if quanta is not None:
            x = variable.value.detach()
            costly.append((x, root, (part.tobytes(), quanta.tobytes(), x.shape), rate))
    if not costly:
        return
    xs, of, rows, factors = (list(column) for column in zip(*costly, strict=True))
    columns, quanta_of = _spread(tuple(rows), xs[0].device)
    _shrink(xs, of, columns, quanta_of, [rate * rates.price for rate in factors])


def _shrink(
    xs: list[Tensor],
    roots: list[Tensor],
    columns: list[Tensor],
    quanta: list[Tensor],
    factors: list[float],
) -> None:
    """`kernels.shrink` of many tensors, by torch's own operations.

    Args:
        xs: the numbers.
        roots: of their second moments.
        columns: their rates, as parts of a factor each.
        quanta: in which their bits are counted.
        factors: of each tensor, rate times price.
    """
    sizes = torch._foreach_abs(xs)
    slopes = torch._foreach_add(sizes, quanta)
    torch._foreach_mul_(slopes, roots)
    falls = torch._foreach_div(columns, slopes)
    torch._foreach_mul_(falls, [factor / math.log(2) for factor in factors])
    torch._foreach_sub_(sizes, falls)
    torch._foreach_clamp_min_(sizes, 0.0)
    torch._foreach_mul_(sizes, torch._foreach_sign(xs))
    torch._foreach_copy_(xs, sizes)


@lru_cache(maxsize=1)  # of the variables that are trained now
def _spread(
    rows: tuple[tuple[bytes, bytes, torch.Size], ...], device: torch.device
) -> tuple[list[Tensor], list[Tensor]]:
    """Rates and quanta of every number: calls on lists are one launch only if shapes are equal."""
    found: tuple[list[Tensor], list[Tensor]] = ([], [])
    for own, quanta, shape in rows:
        for numbers, tensors in zip((own, quanta), found, strict=True):
            row = _on_device(numbers, device).reshape(1, *shape[1:])
            tensors.append(row.expand(shape).contiguous())
    return found


def _row(numbers: npt.NDArray[np.float32], like: Tensor) -> Tensor:
    """(d,) numbers as one row of a tensor (n, ...)."""
    data = np.asarray(numbers, np.float32).tobytes()
    return _on_device(data, like.device).reshape(1, *like.shape[1:])


@lru_cache(maxsize=256)
def _on_device(numbers: bytes, device: torch.device) -> Tensor:
    """float32 numbers, copied once: a copy waits until the GPU has done all that it was told."""
    return torch.tensor(np.frombuffer(numbers, np.float32), device=device)


@dataclass(frozen=True)
class RateTable:
    """The learning rates of one iteration.

    Attributes:
        rates: of the run.
        scene_size: what rates of positions are multiplied by, scene units.
        progress: part of the stage that is over, 0..1.
        price: of a bit, as a part of the loss.
    """

    rates: Rates
    scene_size: float
    progress: float
    price: float = 0.0

    def columns(self, group: str, d: int, n_still: int = 0) -> npt.NDArray[np.float32]:
        """(d,) rates of the numbers of a row, of which the first `n_still` stay as they are."""
        columns = self._columns(group, d)
        columns[:n_still] = 0
        return columns

    def _columns(self, group: str, d: int) -> npt.NDArray[np.float32]:
        r = self.rates
        if group == "position":
            part = r.position ** (1 - self.progress) * r.position_final**self.progress
            rate = self.scene_size * part
            return np.full(d, rate, np.float32)  # falls by itself
        if group == "sh":
            out = np.full(d, r.sh_rest)
            out[:N_BAND_0] = r.sh
        else:
            out = np.full(d, getattr(r, group))
        late = max(0.0, 1 - (1 - self.progress) / r.cool_span) if r.cool_span > 0 else 0.0
        columns: npt.NDArray[np.float32] = (out * r.cool**late).astype(np.float32)
        return columns


def splat_variables(splats: SplatTensors, groups: Sequence[str] = GROUPS) -> tuple[Variable, ...]:
    """The five tensors of splats, or of psi, as variables of these groups."""
    return tuple(Variable.of(x, group) for x, group in zip(splats, groups, strict=True))


def splat_tensors(variables: Iterable[Variable]) -> SplatTensors:
    """The inverse of `splat_variables`."""
    return SplatTensors(*(variable.value for variable in variables))
