"""Plain 3DGS from points: level 0 of every method."""

from __future__ import annotations

from reference_trainer.data.seeding import first_splats
from reference_trainer.methods.base import Setting
from reference_trainer.models.cloud import Cloud
from reference_trainer.models.tensors import SplatTensors

__all__ = ["plain_cloud"]

POINTS, SPLITS = 0, 1  # purposes of random numbers


def plain_cloud(
    setting: Setting, foundation: SplatTensors | None = None, *, dynamic_opacity: bool = False
) -> Cloud:
    """Free splats where the data has points, or at random; over a foundation, if there is one."""
    config, cap = setting.config, setting.plan.cap
    below = 0 if foundation is None else len(foundation.means)
    n = max(1, min(config.cloud.n_random, cap - below))
    splats = first_splats(setting.data, n, config.sh_degree, setting.seed(POINTS))
    return Cloud(
        SplatTensors.of(splats, setting.device),
        config.cloud,
        setting.path,
        setting.seed(SPLITS),
        foundation=foundation,
        dynamic_opacity=dynamic_opacity,
    )
