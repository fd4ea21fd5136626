"""The frontier: the leaves of the finished levels, and the blocks that this level splits them into.

The finished leaves are constants. Blocks are only ever appended, so nothing that is trained is
resized and a gradient reaches every psi and alpha of this level, also those of parents whose
children were split again. Letters: S slots, N live leaves.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import torch

from evogs_codec import InputError, SplatParams
from reference_trainer.config import FrontierGrowth
from reference_trainer.models.adam import GROUPS, Variable
from reference_trainer.models.axes import one_w
from reference_trainer.models.blocks import (
    Block,
    Collinear,
    Free,
    Refined,
    evolve,
    restored,
)
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.densify import ScreenGradients, largest, log_widths, reach_of, useless
from reference_trainer.models.evolution import Evolution
from reference_trainer.models.saved import Arrays, taken, taken_number
from reference_trainer.models.split import moment_matched, symmetric
from reference_trainer.models.tensors import SplatTensors

__all__ = ["OPTIONS", "Frontier"]

# The paper's design space (its section 3.1).
OPTIONS = {
    "A": "independent children",
    "B": "residuals",
    "C": "symmetric",
    "D": "asymmetric",
    "M": "symmetric but for size and opacity, of parents that are refined before",
}
KINDS = {"A": "children", "B": "residuals", "C": "fixed", "D": "learned", "M": "shrinking"}


class Frontier:
    """What a level of a tree trains.

    Attributes:
        base: (n, ...) leaves of the finished levels, in slots 0..n-1.
        option: of `OPTIONS`.
        growth: how it grows.
        path: of the cameras.
        quanta: (D,) in which bits of psi are counted while it trains; None: they cost nothing.
        blocks: in the order in which they change the leaves.
        live: (S,) bool, slots that have a leaf.
        reach: the most that positions may move in the first steps, scene units.
        has_one_w: of a mixed tree, w of all quaternions is the same, and stays so.
    """

    def __init__(
        self,
        base: SplatTensors,
        option: str,
        growth: FrontierGrowth,
        path: CameraPath,
        quanta: npt.NDArray[np.float32] | None = None,
    ) -> None:
        self.base, self.option = base, option
        self.growth, self.path = growth, path
        self.quanta = quanta
        self.blocks: list[Block] = []
        self.live = np.ones(len(base.means), bool)
        self.reach = reach_of(growth.first_step, base.log_scales.cpu().numpy())
        self.has_one_w = option == "M" and one_w(base)
        self._evolution: Evolution | None = None  # of these blocks and live slots, on GPUs

    @property
    def kind(self) -> str:
        """Of the blocks of splits."""
        all_alphas = self.option == "M" and self.growth.all_alphas
        return "learned" if all_alphas else KINDS[self.option]

    @property
    def n_splats(self) -> int:
        """N."""
        return int(np.count_nonzero(self.live))

    def splats(self, iteration: int) -> SplatTensors:
        """The N leaves, differentiable."""
        if self.base.means.is_cpu:
            return evolve(self.base, self.blocks, np.flatnonzero(self.live))
        if self._evolution is None:
            self._evolution = Evolution(self.base, self.blocks, np.flatnonzero(self.live))
        return self._evolution.leaves()

    def variables(self) -> list[Variable]:
        """What is trained."""
        found = [variable for block in self.blocks for variable in block.variables]
        if self.quanta is not None:
            widths = [math.prod(x.shape[1:]) for x in self.base]
            parts = dict(zip(GROUPS, np.split(self.quanta, np.cumsum(widths)[:-1]), strict=True))
            for variable in found:
                variable.quanta = parts.get(variable.group)
        for variable in found:
            variable.n_still = int(self.has_one_w and variable.group == "rotation")
        return found

    def densify(self, iteration: int, n_iterations: int, scores: ScreenGradients, cap: int) -> bool:
        """Prune and split if a round is due after this iteration; `cap` bounds the leaves."""
        due = self._rounds(n_iterations)
        if iteration not in due:
            return False
        with torch.no_grad():
            leaves = self.splats(iteration).params()
        if iteration == due[0] and self.option == "M" and self.growth.refines_first:
            self._refine_all()
        slots = np.flatnonzero(self.live)
        sizes = self.path.sizes(leaves.means)
        dead = useless(leaves, self.growth.prune_opacity, self.growth.prune_scale, sizes)
        self.live[slots[dead]] = False
        n = self.n_splats
        room = self._target(due.index(iteration), len(due), cap) - n
        gradients = np.where(dead, -np.inf, scores.mean())
        over = np.flatnonzero(gradients > self.growth.threshold)
        # Large splats first: what their children change is seen in more pixels.
        of = log_widths(leaves.log_scales[over])
        gains = gradients[over] * np.exp(self.growth.size_power * of)
        rows = over[largest(gains, -np.inf, room)]
        if len(rows):
            self._split(slots[rows], leaves.take(rows))
        if iteration == due[-1] and self.growth.refines_rest:
            self._refine_rest()
        self._evolution = None
        return True

    def _refine_all(self) -> None:
        """Let every leaf of the level before learn, and with it what its children share."""
        rows = np.arange(len(self.base.means))
        if len(rows):
            self.blocks.append(Refined.of(rows, len(rows), self.base))

    def _refine_rest(self) -> None:
        """Let the leaves learn that no round of this level has split."""
        split = [block.slots for block in self.blocks]
        rest = np.flatnonzero(self.live[: len(self.base.means)])
        rest = np.setdiff1d(rest, np.concatenate([*split, rest[:0]]))
        if len(rest):
            self.blocks.append(Refined.of(rest, len(self.live), self.base))

    def _target(self, index: int, n_rounds: int, cap: int) -> int:
        """Leaves after a round: from those of the base to the cap, by factors that fall."""
        n = len(self.base.means)
        part: float = ((index + 1) / n_rounds) ** self.growth.haste
        return round(n * math.pow(cap / n, part))

    def _rounds(self, n_iterations: int) -> list[int]:
        """Iterations after which there is a round."""
        start = min(self.growth.start, n_iterations)
        stop = max(start, int(self.growth.stop * n_iterations))
        return sorted({int(x) for x in np.linspace(start, stop, self.growth.rounds)})

    def _split(self, slots: npt.NDArray[np.int64], parents: SplatParams) -> None:
        first, device = len(self.live), self.base.means.device
        distance = self.growth.distance
        if self.option in "CDM":
            rule = symmetric if self.option == "C" else moment_matched
            psi, alpha = rule(parents, distance)
            block: Block = Collinear.of(slots, first, psi, alpha, self.kind, device)
        else:
            block = Free.of(slots, first, *_children(parents, distance, self.option), device)
        self.blocks.append(block)
        self.live = np.append(self.live, np.ones(len(slots), bool))

    def arrays(self) -> Arrays:
        """All that training changed, for a checkpoint."""
        out: Arrays = {"live": self.live, "n_blocks": np.array(len(self.blocks))}
        for i, block in enumerate(self.blocks):
            out |= block.arrays(f"block{i}")
        return out

    def restore(self, arrays: Arrays) -> None:
        """The inverse of `arrays`, on a frontier made of the same base.

        Raises:
            InputError: the arrays are of no such frontier.
        """
        n_slots, blocks = len(self.base.means), []
        for i in range(taken_number(arrays, "n_blocks", 0, self.growth.rounds + 2)):
            block = restored(arrays, f"block{i}", self.base, n_slots)
            if block.kind not in (self.kind, "refined"):
                raise InputError(f"block{i} is {block.kind}, expected {self.kind}")
            n_slots += block.n_new
            blocks.append(block)
        self.live, self.blocks = taken(arrays, "live", bool, n_slots), blocks
        self._evolution = None


def _children(
    parents: SplatParams, distance: float, option: str
) -> tuple[SplatParams, SplatParams, bool]:
    """The children that a moment-matched split has, as free ones: psi, psi', whether P is added."""
    psi, alpha = moment_matched(parents, distance)
    x, p = psi.channels(), parents.channels()
    other = -x * np.repeat(alpha.T, (3, 4, 3, 1, len(x) - 11), axis=0)
    if option == "A":
        x, other = p + x, p + other
    return SplatParams.from_channels(x), SplatParams.from_channels(other), option == "B"
