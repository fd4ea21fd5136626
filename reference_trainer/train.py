"""The loop: one stage of a level, any method, any device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from reference_trainer.config import Config, Rates
from reference_trainer.models.adam import RateTable, Variable, step_all
from reference_trainer.models.densify import ScreenGradients
from reference_trainer.models.saved import Arrays
from reference_trainer.models.tensors import SplatTensors

if TYPE_CHECKING:
    from reference_trainer.data import View
    from reference_trainer.models.backends import Backend

__all__ = ["Model", "NotFiniteError", "Training", "train"]


class NotFiniteError(ArithmeticError):
    """The loss is not a finite number; the last checkpoint is from before."""


class Model(Protocol):
    """What is trained in a stage.

    Attributes:
        reach: the most that positions may move in the first steps, scene units.
    """

    reach: float

    @property
    def n_splats(self) -> int:
        """Splats that it draws."""

    def splats(self, iteration: int) -> SplatTensors:
        """The splats, differentiable."""

    def variables(self) -> list[Variable]:
        """What is trained."""

    def densify(self, iteration: int, n_iterations: int, scores: ScreenGradients, cap: int) -> bool:
        """Grow and prune if that is due; True if splats came, went or moved to other rows."""

    def arrays(self) -> Arrays:
        """All that training changed."""

    def restore(self, arrays: Arrays) -> None:
        """The inverse of `arrays`."""


@dataclass
class Training:
    """A stage under way.

    Attributes:
        model: what is trained.
        scores: gradients on the screen since the last refinement.
        iteration: iterations done.
        loss: of the last one.
    """

    model: Model
    scores: ScreenGradients
    iteration: int = 0
    loss: float = float("nan")


@dataclass(frozen=True)
class Stage:
    """What a stage is trained on.

    Attributes:
        views: photographs at the resolution of the level.
        background: behind the splats.
        scene_size: what rates of positions are multiplied by, scene units.
        iterations, cap: how long, and the most splats.
        seed: of the order of views.
        rates: how fast.
        rate_weight: bits of numbers that cost bits, in the loss: as a part of it per number.
    """

    views: tuple[View, ...]
    background: tuple[float, float, float]
    scene_size: float
    iterations: int
    cap: int
    seed: tuple[int, ...]
    rates: Rates
    rate_weight: float = 0.0


def train(
    training: Training,
    stage: Stage,
    config: Config,
    backend: Backend,
    each: Callable[[Training], None],
) -> None:
    """Train to the end of the stage, from wherever `training` is; `each` runs every iteration.

    Raises:
        NotFiniteError: the loss is not finite.
    """
    model = training.model
    # A view may be there several times.
    photographs = {id(view): backend.photograph(view.image) for view in stage.views}
    while training.iteration < stage.iterations:
        view = stage.views[view_of(training.iteration, len(stage.views), stage.seed)]
        splats = model.splats(training.iteration)
        screen = backend.screen(splats)
        image = backend.render(splats, view.camera, stage.background, screen)
        loss = backend.loss(image, photographs[id(view)], config.ssim_weight)
        loss.backward()  # type: ignore[no-untyped-call]
        training.loss = float(loss.detach())
        if not np.isfinite(training.loss):
            raise NotFiniteError(f"the loss is {training.loss} at iteration {training.iteration}")
        if screen.grad is not None:
            training.scores.add(screen.grad, view.camera.width, view.camera.height)
        progress = training.iteration / stage.iterations
        variables = model.variables()
        price = stage.rate_weight * training.loss / max(_priced(variables), 1)
        rates = RateTable(stage.rates, stage.scene_size, progress, price)
        step_all(variables, rates)
        training.iteration += 1
        if model.densify(training.iteration, stage.iterations, training.scores, stage.cap):
            training.scores = ScreenGradients(model.n_splats, backend.device)
        each(training)


def _priced(variables: list[Variable]) -> int:
    """Numbers that cost bits."""
    return sum(variable.value.numel() for variable in variables if variable.quanta is not None)


def view_of(iteration: int, n_views: int, seed: tuple[int, ...]) -> int:
    """Index of the view of an iteration: all views in random order, then all again."""
    turn, place = divmod(iteration, n_views)
    return int(np.random.default_rng((*seed, turn)).permutation(n_views)[place])
