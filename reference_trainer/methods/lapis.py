"""LapisGS (Shi et al., 2025): layers at rising resolution; lower ones keep all but their opacity.

Every layer starts from the points of the data set again. Opacities of lower layers are trained anew
at every level, and stored with it. Two faults of the published code are not reproduced: positions
of enhancement layers do learn, and lower layers show all their SH bands from the start.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from reference_trainer.config import Config
from reference_trainer.export import opacity_refines, roots
from reference_trainer.methods.base import Done, Plan, Setting, a_plan_per_level
from reference_trainer.methods.plain import plain_cloud
from reference_trainer.models.cloud import Cloud
from reference_trainer.models.tensors import SplatTensors
from reference_trainer.train import Model

__all__ = ["Lapis"]


class Lapis:
    """A layer per level."""

    takes_base: ClassVar[bool] = True

    def plans(self, config: Config) -> list[Plan]:
        """One stage per level."""
        return a_plan_per_level(config)

    def begin(self, setting: Setting, done: Done) -> Model:
        """A cloud over the layers so far."""
        if not done.steps:
            return plain_cloud(setting)
        below = SplatTensors.of(done.tree.leaves(), setting.device)
        return plain_cloud(setting, below, dynamic_opacity=True)

    def finish(self, setting: Setting, done: Done, model: Model) -> Done:
        """New opacities, then a new layer."""
        assert isinstance(model, Cloud)
        level, layer = setting.plan.level, roots(model.layer_splats(), setting.plan.level)
        if model.opacities is None or model.foundation is None:
            return done.with_steps(layer)
        before = model.foundation.opacity_logits.cpu().numpy()
        changes = model.opacities.value.detach().cpu().numpy() - before
        slots = np.arange(len(before))  # nothing is dropped: slots are rows
        return done.with_steps(opacity_refines(slots, changes, level, len(layer.adds)), layer)
