"""A tree in integers, trained further: its other numbers make up for those that were taken away."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from evogs_codec import EvolutionTree
from reference_trainer.config import Config
from reference_trainer.methods.quantised import IntegerLevel
from reference_trainer.models.backends import Backend
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.densify import ScreenGradients, reach_of
from reference_trainer.run import photographs
from reference_trainer.train import Stage, Training, train
from tools.bench.paper.runs import Views

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["trained_again"]

AGAIN = 3  # purpose of random numbers: the order of views


def trained_again(
    tree: EvolutionTree,
    config: Config,
    views: Views,
    finer: Dataset | None,
    iterations: int,
    backend: Backend,
) -> EvolutionTree:
    """The tree after as many iterations of each level above 0, as levels end in integers.

    Numbers that are 0 stay so, and quanta and alphas are as they were.
    """
    steps = tuple(step for step in tree.steps if step.level == 0)
    scales = views.pyramid if finer is None else (*views.pyramid, finer)
    for level in range(1, tree.n_levels):
        data = views.pyramid[level]
        before = EvolutionTree(tree.sh_degree, steps)
        own = tuple(step for step in tree.steps if step.level == level)
        reach = reach_of(config.frontier.first_step, before.leaves().log_scales)
        model = IntegerLevel(before, own, tree.quanta[: 2 + level], backend.device, reach)
        path = CameraPath.of([view.camera for view in data.train])
        scene_size = path.scene_size(model.splats(0).means.detach().cpu().numpy())
        stage = Stage(
            photographs(scales, level, config, shifts=config.shifts),
            data.background,
            scene_size,
            iterations,
            model.n_splats,
            (config.seed, level, AGAIN),
            config.integers.rates(config.rates.at_most(reach / scene_size)),
        )
        training = Training(model, ScreenGradients(model.n_splats, backend.device))
        train(training, stage, config, backend, _nothing)
        steps += model.finished()
    return replace(tree, steps=steps)


def _nothing(training: Training) -> None:
    """After an iteration."""
