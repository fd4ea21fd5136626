"""Models without layers: one per level (Monolithic), or one in all (Single)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from reference_trainer.config import Config
from reference_trainer.export import drops, roots
from reference_trainer.methods.base import Done, Plan, Setting, a_plan_per_level
from reference_trainer.methods.plain import plain_cloud
from reference_trainer.models.cloud import Cloud
from reference_trainer.train import Model

__all__ = ["Monolithic", "Single"]


class Monolithic:
    """A model from scratch at every level: the bound on quality, and nothing shared."""

    takes_base: ClassVar[bool] = False

    def plans(self, config: Config) -> list[Plan]:
        """One stage per level."""
        return a_plan_per_level(config)

    def begin(self, setting: Setting, done: Done) -> Model:
        """Plain 3DGS."""
        return plain_cloud(setting)

    def finish(self, setting: Setting, done: Done, model: Model) -> Done:
        """The model before goes, the new one comes."""
        assert isinstance(model, Cloud)
        new = roots(model.layer_splats(), setting.plan.level)
        if not done.steps:
            return done.with_steps(new)
        *_, state = done.tree.states()
        old = np.flatnonzero(state.live)
        return done.with_steps(drops(old, setting.plan.level, len(new.adds)), new)


class Single(Monolithic):
    """A model trained at full resolution, drawn at every one."""

    def plans(self, config: Config) -> list[Plan]:
        """One stage."""
        scale = config.n_levels - 1
        return [Plan(0, scale, config.iterations[-1], config.max_splats[-1])]
