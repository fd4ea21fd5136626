"""Quantisation-aware training: a level of a tree in the integers of the codec, trained on as such.

The codec rounds psi and alpha of a level where pictures show it least. Descent then moves the
integers: pictures are drawn with multiples of quanta, and their gradients move the numbers that
these were rounded from (straight-through). So they make up for each other's rounding, and the next
level grows on exactly what a decoder has. Zeros stay zero, for they save most of the bits; alphas
stay as they were chosen.

Letters: D channels, K classes (spec 3.2), m records of a block, S slots.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from evogs_codec import EvolutionTree, SplatParams
from evogs_codec.encoding.grids import AccuracyWarning
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.ranges import Ranges
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.settings import Settings
from evogs_codec.model.channels import channel_class, n_channels
from evogs_codec.model.coded_tree import CodedTree
from evogs_codec.model.splats import F32, F64
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render.views import DRAWN, Views
from reference_trainer.methods.base import Done, Setting
from reference_trainer.models.adam import Variable, splat_variables
from reference_trainer.models.axes import one_w
from reference_trainer.models.blocks import Block, Collinear, Refined, evolve
from reference_trainer.models.densify import ScreenGradients, reach_of
from reference_trainer.models.evolution import Evolution
from reference_trainer.models.saved import Arrays, taken_number
from reference_trainer.models.tensors import SplatTensors

__all__ = ["IntegerLevel"]

I64 = npt.NDArray[np.int64]
Live = npt.NDArray[np.bool_]
Quanta = tuple[tuple[float, ...], ...]
QUANTUM_BITS = 5  # of a quantum: a grid with 16 units or more to the finest one holds it exactly


class IntegerLevel:
    """What trains a level once more.

    Attributes:
        steps: of the level, their numbers multiples of quanta, as the codec rounded them.
        quanta: of what is added, then of psi of each level so far, (K,) each.
        reach: of the level as it trained in floats (`Frontier`).
    """

    def __init__(
        self,
        before: EvolutionTree,
        steps: tuple[Step, ...],
        quanta: Quanta,
        device: torch.device,
        reach: float = math.inf,
    ) -> None:
        self.steps, self.quanta, self.reach = steps, quanta, reach
        if before.steps:
            self._base, self._columns, self._live = _blocks(before, steps, device)
        else:
            self._base, self._columns, self._live = _roots(steps[0], device)
        self._evolution: Evolution | None = None  # on GPUs
        if not self._base.means.is_cpu:
            self._evolution = Evolution(self._base, self._blocks, np.flatnonzero(self._live))
        kinds = [channel_class(c) for c in range(n_channels(before.sh_degree))]
        row = SplatParams.from_channels(np.array(quanta[-1], np.float32)[kinds][:, None])
        # Of roots all numbers move, but for w where it is that of all.
        n_still = None if before.steps else int(one_w(self._base))
        self._numbers = [
            _Rounded.of(variable, quantum, n_still)
            for place in self._columns
            for variable, quantum in zip(
                _psi_of(place.block), SplatTensors.of(row, device), strict=True
            )
        ]

    @staticmethod
    def begin(setting: Setting, done: Done) -> IntegerLevel:
        """The last level of a tree, rounded."""
        level = setting.plan.level
        if level == 0:  # the level of another tree may have several steps
            roots = Step.of_adds(0, done.tree.leaves().channels())
            done = replace(done, steps=(roots,))
        coded, quanta = _coded(setting, done)
        steps = tuple(s for s in _in_floats(coded, done.steps) if s.level == level)
        before = EvolutionTree(done.sh_degree, tuple(s for s in done.steps if s.level < level))
        parents = before.leaves().log_scales if level else np.empty((0, 3), np.float32)
        reach = reach_of(setting.config.frontier.first_step, parents)
        return IntegerLevel(before, steps, quanta, setting.device, reach)

    @property
    def n_splats(self) -> int:
        """Leaves."""
        return int(np.count_nonzero(self._live))

    def splats(self, iteration: int) -> SplatTensors:
        """The leaves that a decoder has, differentiable in the psi that are drawn."""
        for numbers in self._numbers:
            numbers.show()
        if self._evolution is not None:
            return self._evolution.leaves()
        return evolve(self._base, self._blocks, np.flatnonzero(self._live))

    @property
    def _blocks(self) -> list[Block]:
        return [place.block for place in self._columns]

    def variables(self) -> list[Variable]:
        """What is trained, with the gradients of what is drawn."""
        return [numbers.pulled() for numbers in self._numbers]

    def densify(self, iteration: int, n_iterations: int, scores: ScreenGradients, cap: int) -> bool:
        """Nothing splits or dies any more."""
        return False

    def arrays(self) -> Arrays:
        """All that training changed, for a checkpoint."""
        out: Arrays = {"n": np.array(len(self._numbers))}
        for i, numbers in enumerate(self._numbers):
            out |= numbers.latent.arrays(f"latent{i}")
        return out

    def restore(self, arrays: Arrays) -> None:
        """The inverse of `arrays`, on a level begun from the same tree.

        Raises:
            InputError: the arrays are of no such level.
        """
        taken_number(arrays, "n", len(self._numbers), len(self._numbers))
        for i, numbers in enumerate(self._numbers):
            group, like = numbers.latent.group, numbers.latent.value
            numbers.latent = Variable.restored(
                arrays, f"latent{i}", group, like.device, *like.shape
            )

    def finished(self) -> tuple[Step, ...]:
        """The steps with the integers that training ended with."""
        for numbers in self._numbers:
            numbers.show()
        steps = list(self.steps)
        for place in self._columns:
            step, psi = steps[place.step], place.psi()
            if len(step.slots):
                changed = step.psi.copy()
                changed[:, place.columns] = psi
                steps[place.step] = replace(step, psi=changed)
            else:
                steps[place.step] = replace(step, adds=step.adds + psi)
        return tuple(_without_idle(step) for step in steps)


@dataclass
class _Rounded:
    """Numbers that are trained, and the multiples of quanta that are drawn in their place.

    Attributes:
        shown: a variable of a block.
        latent: what is trained.
        quanta: (1, ...) of each number of a row.
        moves: which numbers do; the others are zero.
    """

    shown: Variable
    latent: Variable
    quanta: Tensor
    moves: Tensor

    @staticmethod
    def of(shown: Variable, quanta: Tensor, n_still: int | None) -> _Rounded:
        """Numbers that are 0 stay so; with `n_still` all move, but as many of a rotation's."""
        value = shown.value.detach()
        latent = Variable.of(value.clone(), shown.group)
        moves = value != 0
        if n_still is not None:
            moves[:] = True
            if shown.group == "rotation":
                moves[:, :n_still] = False
        return _Rounded(shown, latent, quanta, moves)

    def show(self) -> None:
        with torch.no_grad():
            multiples = torch.round(self.latent.value / self.quanta) * self.quanta
            self.shown.value.copy_(torch.where(self.moves, multiples, 0.0))

    def pulled(self) -> Variable:
        grad, self.shown.value.grad = self.shown.value.grad, None
        if grad is not None:
            self.latent.value.grad = torch.where(self.moves, grad, 0.0)
        return self.latent


def _without_idle(step: Step) -> Step:
    """Without refines that change nothing, which would cost their place in the lists."""
    has_psi = step.kinds != Kind.DROP
    idle = np.zeros(len(step.slots), bool)
    idle[has_psi] = (step.kinds[has_psi] == Kind.REFINE) & ~step.psi.any(axis=0)
    if not idle.any():
        return step
    return replace(
        step,
        slots=step.slots[~idle],
        kinds=step.kinds[~idle],
        psi=np.ascontiguousarray(step.psi[:, ~idle[has_psi]]),
    )


def _coded(setting: Setting, done: Done) -> tuple[CodedTree, Quanta]:
    """A tree whose last level is rounded for the pictures of its scale, and the quanta so far."""
    tree, level, data = done.tree, setting.plan.level, setting.data
    views = data.train[:: -(-len(data.train) // DRAWN)]
    scene = Views(tree.leaves(), [view.camera for view in views], data.background)
    wrong = [
        np.mean(np.square(picture.clip(0, 1) - view.image))
        for picture, view in zip(scene.pictures, views, strict=True)
    ]
    n = sum(s.psi.size + s.adds.size for s in tree.steps if s.level == level)
    price = max(setting.config.integers.price(float(np.mean(wrong)), n), PRICES[0])
    importance = Importance.of((tree,), level + 1, scene.sensitivity, first=level)
    table = importance.steps(price, Ranges.of((tree,), level + 1).extent)
    own = _with_few_bits(table[1 + level] if level else table[0])
    steps = (*done.quanta, own) if level else (own, own)
    settings = replace(Settings.of_quanta(steps), closed_loop=True)
    weights = [
        found if step.level == level else None
        for step, found in zip(tree.steps, importance.weights[0], strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)  # training corrects that too
        coded = quantise((tree,), level + 1, settings, weights=[weights], price=price)
    # As they are: where values span much, the grid is coarser than was asked for.
    own = _step_sizes(coded, 1 + level if level else 0)
    return coded, (*done.quanta, own) if level else (own, own)


def _with_few_bits(steps: F64) -> tuple[float, ...]:
    """The nearest numbers of `QUANTUM_BITS` bits."""
    mantissas, exponents = np.frexp(steps)
    found = np.ldexp(np.rint(np.ldexp(mantissas, QUANTUM_BITS)), exponents - QUANTUM_BITS)
    return tuple(found.tolist())


def _step_sizes(coded: CodedTree, row: int) -> tuple[float, ...]:
    """(K,) steps that a row of quantisers has: 0 of adds, 1 + level of psi."""
    exponents = coded.grid_exponents
    steps = enumerate(coded.quantisers[row])
    return tuple(q.step * 2.0 ** -exponents[min(kind, 4)] for kind, q in steps)


def _in_floats(coded: CodedTree, steps: Sequence[Step]) -> list[Step]:
    """What the integers of a tree of one tile mean, in the steps that they were made of."""
    (tile,) = coded.tiles
    kinds = [channel_class(c) for c in range(n_channels(coded.sh_degree))]
    sizes = np.array([_step_sizes(coded, row) for row in range(len(coded.quantisers))])[:, kinds]
    origin = np.zeros(len(kinds))
    origin[0:3] = np.array(tile.origin) * 2.0 ** -coded.grid_exponents[0]
    out = []
    for own, step in zip(tile.steps, steps, strict=True):
        tables = [coded.alpha_table(own.level, group).values for group in range(len(own.alpha))]
        alpha = [values[index] for values, index in zip(tables, own.alpha, strict=True)]
        psi = own.psi * sizes[1 + own.level][:, None]
        adds = own.adds * sizes[0][:, None] + origin[:, None]
        out.append(
            replace(
                step,
                psi=psi.astype(np.float32),
                alpha=np.array(alpha, np.float32).reshape(step.alpha.shape),
                adds=adds.astype(np.float32),
            )
        )
    return out


@dataclass(frozen=True)
class _BlockColumns:
    """Where psi of a block belong: the step of the level, and (m,) columns of its psi.

    Attributes:
        block: of m records.
        step: its number in the level.
        columns: of its psi; of the adds, where the splats are roots.
    """

    block: Block
    step: int
    columns: I64

    def psi(self) -> F32:
        """(D, m) what is drawn."""
        shown = [x.value.detach().cpu().numpy() for x in _psi_of(self.block)]
        return np.concatenate([x.reshape(len(x), -1) for x in shown], axis=1).T


def _roots(step: Step, device: torch.device) -> tuple[SplatTensors, list[_BlockColumns], Live]:
    """Roots are a base whose splats are all refined, by nothing yet."""
    base = SplatTensors.of(SplatParams.from_channels(step.adds), device)
    rows = np.arange(step.n_adds)
    return (
        base,
        [_BlockColumns(Refined.of(rows, len(rows), base), 0, rows)],
        np.ones(len(rows), bool),
    )


def _blocks(
    before: EvolutionTree, steps: Sequence[Step], device: torch.device
) -> tuple[SplatTensors, list[_BlockColumns], Live]:
    """The leaves before a level, its splits and refines as blocks, and which slots have leaves.

    Slots are those of a frontier: leaves first, then the C2s block by block.
    """
    *_, state = before.states()
    leaves, n_slots = np.flatnonzero(state.live), len(state.live)
    base = SplatTensors.of(state.splats(), device)
    live = np.ones(len(leaves), bool)
    name = np.full(n_slots + sum(step.n_new for step in steps), -1, np.int64)
    name[leaves] = np.arange(len(leaves))
    places = []
    for number, step in enumerate(steps):
        live[name[step.slots[step.kinds == Kind.DROP]]] = False
        slots, kinds = (x[step.kinds != Kind.DROP] for x in (step.slots, step.kinds))
        for kind in (Kind.SPLIT, Kind.REFINE):
            columns = np.flatnonzero(kinds == kind)
            if not len(columns):
                continue
            order = np.argsort(name[slots[columns]])
            columns, n = columns[order], len(live)
            rows, psi = name[slots[columns]], SplatParams.from_channels(step.psi[:, columns])
            if kind == Kind.SPLIT:
                name[n_slots + order] = n + np.arange(len(columns))
                n_slots += len(columns)
                live = np.append(live, np.ones(len(columns), bool))
                alpha = step.alpha.T[order]
                block: Block = Collinear.of(rows, n, psi, alpha, "fixed", device)
            else:
                block = Refined(rows, n, splat_variables(SplatTensors.of(psi, device)))
            places.append(_BlockColumns(block, number, columns))
    return base, places, live


def _psi_of(block: Block) -> tuple[Variable, ...]:
    return block.psi if isinstance(block, Collinear) else block.variables
