"""`blocks.evolve` on any device, by torch's own operations: as GPUs want it."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import torch
from torch import Tensor

from reference_trainer.models.blocks import I64, Block, rows_of
from reference_trainer.models.tensors import SplatTensors

__all__ = ["Evolution"]

Context: TypeAlias = Any  # torch gives it no type
Argument: TypeAlias = Any


class Evolution:
    """`evolve` on any device, by torch's own operations: few calls, each on many numbers, for GPUs.

    Slots of blocks and live slots are copied to the device when it is made.
    """

    def __init__(self, base: SplatTensors, blocks: list[Block], live: I64) -> None:
        device = base.means.device
        self.blocks = list(blocks)
        self.base = rows_of(base)
        self.shapes = [x.shape[1:] for x in base]
        self.rows = [torch.from_numpy(block.slots).to(device) for block in blocks]
        self.live = torch.from_numpy(live).to(device)

    def leaves(self) -> SplatTensors:
        """The leaves in the live slots, differentiable in the blocks' tensors."""
        tensors = [tensor for block in self.blocks for tensor in block.tensors()]
        return SplatTensors(*_EvolveRows.apply(self, *tensors))  # type: ignore[no-untyped-call]


class _EvolveRows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Context, *args: Argument) -> tuple[Tensor, ...]:
        tree: Evolution = args[0]
        ctx.tree, n = tree, len(tree.base)
        values = tree.base.new_empty((n + sum(b.n_new for b in tree.blocks), tree.base.shape[1]))
        values[:n] = tree.base
        for block, rows in zip(tree.blocks, tree.rows, strict=True):
            block.evolve_rows(values, rows)
        ctx.n_slots = len(values)
        parts = torch.split(values[tree.live], [math.prod(x) for x in tree.shapes], dim=1)
        leaves = zip(parts, tree.shapes, strict=True)
        return tuple(x.reshape(len(x), *shape).contiguous() for x, shape in leaves)

    @staticmethod
    def backward(ctx: Context, *grads: Tensor) -> tuple[Tensor | None, ...]:
        tree: Evolution = ctx.tree
        g = tree.base.new_zeros((ctx.n_slots, tree.base.shape[1]))
        g[tree.live] = rows_of(grads)
        found: list[Tensor] = []
        for block, rows in zip(reversed(tree.blocks), reversed(tree.rows), strict=True):
            found = [*block.pull_back_rows(g, rows), *found]
        return (None, *found)
