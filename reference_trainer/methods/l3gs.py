"""L3GS (Tsai et al., 2025): layers are buckets of a trained model by significance.

As the paper adapts it to resolutions: the model of full resolution is sorted by significance and
cut into buckets; each is trained in turn at the resolution of its level, over the frozen ones.

The significance of a splat is GSG: how much of all pictures it makes, times its volume to a small
power. Here the first is the sum of its blending weights, the gradient of the sum of all pixels to
its colour.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams
from reference_trainer.config import Config
from reference_trainer.export import roots
from reference_trainer.methods.base import Done, Plan, Setting, a_plan_per_level
from reference_trainer.methods.plain import SPLITS
from reference_trainer.methods.separate import Single
from reference_trainer.models.cloud import Cloud
from reference_trainer.models.tensors import SplatTensors
from reference_trainer.train import Model

__all__ = ["L3gs", "significance"]

VOLUME_POWER = 0.1  # of the volume
VOLUME_QUANTILE = 0.9  # the volume that this part of all splats exceed counts 1
PRETRAINING = -1  # level of the stage that leaves nothing in the tree


class L3gs:
    """A bucket per level."""

    takes_base: ClassVar[bool] = False

    def plans(self, config: Config) -> list[Plan]:
        """The model of full resolution, then one stage per level."""
        (single,) = Single().plans(config)
        first = Plan(PRETRAINING, single.scale, single.iterations, single.cap)
        return [first, *a_plan_per_level(config)]

    def begin(self, setting: Setting, done: Done) -> Model:
        """Plain 3DGS, or the next bucket over the others."""
        if setting.plan.level == PRETRAINING:
            return Single().begin(setting, done)
        assert done.spare is not None
        bounds = _bounds(setting.config, len(done.spare))
        first, last = bounds[setting.plan.level : setting.plan.level + 2]
        bucket = done.spare.take(np.arange(first, last))
        below = SplatTensors.of(done.tree.leaves(), setting.device) if done.steps else None
        return Cloud(
            SplatTensors.of(bucket, setting.device),
            None,
            setting.path,
            setting.seed(SPLITS),
            foundation=below,
        )

    def finish(self, setting: Setting, done: Done, model: Model) -> Done:
        """The sorted model, then a bucket each time."""
        assert isinstance(model, Cloud)
        splats = model.layer_splats()
        if setting.plan.level == PRETRAINING:
            order = np.argsort(-significance(splats, setting), kind="stable")
            return Done(done.sh_degree, done.steps, splats.take(order))
        return done.with_steps(roots(splats, setting.plan.level))


def significance(splats: SplatParams, setting: Setting) -> npt.NDArray[np.float64]:
    """(N,) GSG over the training views."""
    from evogs_codec.render import draw, gradients

    grey = SplatParams(
        splats.means,
        splats.quats,
        splats.log_scales,
        splats.opacity_logits,
        np.zeros((len(splats), 1, 3), np.float32),
    )
    weights = np.zeros(len(splats))
    for view in setting.data.train:
        drawing = draw(grey, view.camera)
        found: Any = gradients(drawing, grey, np.ones_like(drawing.image))
        weights += found.sh[:, 0].sum(axis=1)
    log_volume = splats.log_scales.sum(axis=1).astype(np.float64)
    reference = np.sort(log_volume)[::-1][int(VOLUME_QUANTILE * (len(splats) - 1))]
    scores: npt.NDArray[np.float64] = weights * np.exp(VOLUME_POWER * (log_volume - reference))
    return scores


def _bounds(config: Config, n: int) -> list[int]:
    """Where buckets begin: equal ones, or in proportion to the caps of the levels."""
    if config.equal_buckets:
        return [n * i // config.n_levels for i in range(config.n_levels + 1)]
    return [0, *(n * cap // config.max_splats[-1] for cap in config.max_splats)]
