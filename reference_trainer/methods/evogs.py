"""EvoGS, the evolution tree, and the other three ways to make two children of a splat."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from evogs_codec.model.channels import channel_class, n_channels
from evogs_codec.model.tree import Step
from reference_trainer.config import Config
from reference_trainer.export import frontier_steps, roots
from reference_trainer.methods.base import Done, Plan, Setting, a_plan_per_level
from reference_trainer.methods.plain import plain_cloud
from reference_trainer.methods.quantised import IntegerLevel
from reference_trainer.methods.refines_first import (
    TRIED_LEVEL,
    better,
    growth_of,
    is_tried,
    second_attempt,
)
from reference_trainer.models.axes import with_least_rotations
from reference_trainer.models.cloud import Cloud
from reference_trainer.models.frontier import Frontier
from reference_trainer.models.tensors import SplatTensors
from reference_trainer.train import Model

__all__ = ["Evogs"]


@dataclass(frozen=True)
class Evogs:
    """Level 0 is plain 3DGS, every other level splits leaves of the one before.

    Attributes:
        option: of `frontier.OPTIONS`.
    """

    option: str
    takes_base: ClassVar[bool] = True

    def plans(self, config: Config) -> list[Plan]:
        """A stage per level; after each one in integers, where the configuration has them.

        Those of level 1 of a mixed tree are there twice, where it is tried without refines.
        """
        part = config.integers.part
        found = []
        for plan in a_plan_per_level(config):
            own = [plan]
            if part:
                n = max(1, round(part * plan.iterations))
                own.append(replace(plan, iterations=n, in_integers=True))
            found += own
            if self._is_tried(config):
                found += second_attempt(own)
        return found

    def begin(self, setting: Setting, done: Done) -> Model:
        """Plain 3DGS, then the leaves as a decoder has them."""
        if not done.steps:
            return plain_cloud(setting)
        if setting.plan.in_integers:
            return IntegerLevel.begin(setting, self._turned(done))
        leaves = SplatTensors.of(done.tree.leaves(), setting.device)
        quanta = None
        if done.quanta and self.option == "M":  # those of the level before are near enough
            kinds = [channel_class(c) for c in range(n_channels(done.sh_degree))]
            quanta = np.array(done.quanta[-1], np.float32)[kinds]
        growth = growth_of(setting, done)
        return Frontier(leaves, self.option, growth, setting.path, quanta)

    def finish(self, setting: Setting, done: Done, model: Model) -> Done:
        """Roots, then splits."""
        level = setting.plan.level
        if isinstance(model, IntegerLevel):
            before = tuple(step for step in done.steps if step.level < level)
            found = replace(done, steps=(*before, *model.finished()), quanta=model.quanta)
            if not (level == TRIED_LEVEL and self._is_tried(setting.config)):
                return found
            if setting.plan.without_refines:
                return better(setting, found)
            return replace(done, steps=before, rival=found)
        if isinstance(model, Cloud):
            return self._turned(done.with_steps(roots(model.layer_splats())))
        assert isinstance(model, Frontier)
        return done.with_steps(*frontier_steps(done.tree, model, level))

    def _is_tried(self, config: Config) -> bool:
        return self.option == "M" and is_tried(config)

    def _turned(self, done: Done) -> Done:
        """The roots of a mixed tree, as long as they are in floats, with least rotations."""
        if self.option != "M" or done.quanta:
            return done
        leaves = with_least_rotations(done.tree.leaves().channels())
        return replace(done, steps=(Step.of_adds(0, leaves),))
