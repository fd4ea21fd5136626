"""What every method of the paper says: its stages, what each trains, and what becomes the tree.

A method is three answers: which stages there are, what a stage trains given what is done, and what
of it is kept. All keep it as steps of an `EvolutionTree`: layers are adds, LapisGS's opacities are
refines, separate models are drops and adds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Protocol

import torch

from evogs_codec import EvolutionTree, SplatParams
from evogs_codec.model.tree import Step
from reference_trainer.config import Config
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.train import Model

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["Done", "Method", "Plan", "Setting", "a_plan_per_level"]


@dataclass(frozen=True)
class Plan:
    """A stage.

    Attributes:
        level: what its steps are labelled.
        scale: which level of the image pyramid it is trained on.
        iterations, cap: how long, and the most splats drawn.
        in_integers: whether it trains once more, in integers, what the stage before it did.
        without_refines: of a mixed tree, whether it is a second attempt at the level.
    """

    level: int
    scale: int
    iterations: int
    cap: int
    in_integers: bool = False
    without_refines: bool = False


@dataclass(frozen=True)
class Done:
    """What the finished stages left.

    Attributes:
        steps: of the tree.
        spare: splats that later stages need and the tree does not have yet.
        quanta: of the levels that are in integers.
        rival: during the second attempt at a level, what the first one left.
        refines_save: of a mixed tree whose level 1 was tried both ways, the part of the bits of
            that level that its refines save.
    """

    sh_degree: int
    steps: tuple[Step, ...] = ()
    spare: SplatParams | None = field(default=None, repr=False)
    quanta: tuple[tuple[float, ...], ...] = ()
    rival: Done | None = field(default=None, repr=False)
    refines_save: float | None = None

    @property
    def tree(self) -> EvolutionTree:
        """The tree so far; it has quanta if its last level, not only those before, is in them."""
        n_levels = self.steps[-1].level + 1 if self.steps else 0
        whole = len(self.quanta) == 1 + n_levels
        return EvolutionTree(self.sh_degree, self.steps, self.quanta if whole else ())

    def with_steps(self, *steps: Step) -> Done:
        """With these steps after the others."""
        return replace(self, steps=(*self.steps, *steps))


@dataclass(frozen=True)
class Setting:
    """What a stage is given.

    Attributes:
        config: of the run.
        plan: of the stage.
        data: photographs at the scale of the plan.
        path: of the cameras.
        device: where tensors live.
    """

    config: Config
    plan: Plan
    data: Dataset
    path: CameraPath
    device: torch.device

    def seed(self, purpose: int) -> tuple[int, ...]:
        """For a random generator; every purpose has its own."""
        return (self.config.seed, self.plan.level + 1, self.plan.scale, purpose)


class Method(Protocol):
    """A system of the paper.

    Attributes:
        takes_base: a run may begin with the level 0 of another run.
    """

    takes_base: ClassVar[bool]

    def plans(self, config: Config) -> list[Plan]:
        """The stages."""

    def begin(self, setting: Setting, done: Done) -> Model:
        """What a stage trains."""

    def finish(self, setting: Setting, done: Done, model: Model) -> Done:
        """What is kept of it."""


def a_plan_per_level(config: Config) -> list[Plan]:
    """Level i at scale i."""
    return [
        Plan(level, level, *numbers)
        for level, numbers in enumerate(zip(config.iterations, config.max_splats, strict=True))
    ]
