"""Adam over rows: a `Variable` is a tensor with its moments, and knows its group.

3DGS steps with eps 1e-15, so a splat that no picture has shown yet still moves at full rate once
one does. Variables are never resized in place: `rows` and `appended` make new ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from reference_trainer.config import Rates
from reference_trainer.models.kernels import adam, shrink
from reference_trainer.models.saved import Arrays, taken, taken_number
from reference_trainer.models.tensors import SplatTensors

__all__ = ["GROUPS", "RateTable", "Variable", "splat_tensors", "splat_variables"]

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
        columns = rates.columns(self.group, x.shape[1])
        columns[: self.n_still] = 0
        if x.is_cpu:
            adam(x.numpy(), g.numpy(), m.numpy(), v.numpy(), columns, BETA1, BETA2, EPS, self.t)
        else:
            m.lerp_(g, 1 - BETA1)
            v.mul_(BETA2).addcmul_(g, g, value=1 - BETA2)
            root = v.div(1 - BETA2**self.t).sqrt_().add_(EPS)
            scaled = m / (1 - BETA1**self.t) * torch.from_numpy(columns).to(x)
            x.sub_(scaled.div_(root))
        if self.quanta is not None and rates.price and self.t > FREE_STEPS:
            if x.is_cpu:
                quanta = self.quanta
                shrink(x.numpy(), v.numpy(), columns, quanta, rates.price, BETA2, EPS, self.t)
            else:
                self.shrink_plain(x, v, columns, rates.price)
        self.value.grad = None

    def shrink_plain(
        self, x: Tensor, v: Tensor, columns: npt.NDArray[np.float32], price: float
    ) -> None:
        """`kernels.shrink` in torch's own operations, for other devices and as its test."""
        assert self.quanta is not None
        size, quanta = x.abs(), torch.from_numpy(self.quanta).to(x)
        root = v.div(1 - BETA2**self.t).sqrt_().add_(EPS)
        slope = price / math.log(2) / (size + quanta)
        pull = torch.from_numpy(columns).to(x) * slope / root
        x.copy_(torch.sign(x) * (size - pull).clamp_(min=0))

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


@dataclass(frozen=True)
class RateTable:
    """The learning rates of one iteration.

    Attributes:
        rates: of the run.
        extent: of the cameras, scene units.
        progress: part of the stage that is over, 0..1.
        price: of a bit, as a part of the loss.
    """

    rates: Rates
    extent: float
    progress: float
    price: float = 0.0

    def columns(self, group: str, d: int) -> npt.NDArray[np.float32]:
        """(d,) rates of the numbers of a row."""
        r = self.rates
        if group == "position":
            rate = self.extent * r.position ** (1 - self.progress) * r.position_final**self.progress
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
