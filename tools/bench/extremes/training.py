"""Rows of the trainer: a few iterations from starting points at the extremes.

torch is needed, and imported where it is: the other rows do without.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from evogs_codec import EvolutionTree, InputError, SplatParams
from evogs_codec.render import Camera, render
from tools.bench.extremes.row import Row, outcome
from tools.bench.extremes.views import VIEWS, ball, facing

__all__ = ["starts"]

BACKGROUND = (0.2, 0.5, 1.0)
ITERATIONS = 24
OPACITY, WIDTH = 1e-30, 1e300  # what is pruned: nothing, since what is extreme has to train
BOUND = "finite, or a clear stop"


@dataclass(frozen=True)
class Found:
    """What came of a training.

    Attributes:
        n_wrong, n: numbers that were not finite, of all means of gradients (the first moments of
            Adam) and all parameters, after every iteration.
        n_at_rest: parameters whose second moment is infinite at the end: Adam moves them no more.
        n_splats, loss: at the end.
    """

    n_wrong: int
    n: int
    n_at_rest: int
    n_splats: int
    loss: float


def starts(n: int) -> Iterator[Row]:
    """N splats a view: as free splats, and as level 0 of a tree whose leaves are split."""
    for name, make in VIEWS.items():
        splats, camera = make(n)
        for model in ("cloud", "frontier"):
            yield _row(f"{name}; {model}", model, splats, camera)
    splats, camera = ball(n), facing()
    scales = splats.log_scales.copy()
    scales[: n // 2] = 400
    too_large = replace(splats, log_scales=scales)
    yield _row("half of the scales e^400; cloud", "cloud", too_large, camera)
    logits = np.full(n, -60, np.float32)
    unseen = replace(splats, opacity_logits=logits)
    yield _row("no splat that can be seen; frontier", "frontier", unseen, camera)
    logits = splats.opacity_logits.copy()
    logits[0] = np.nan
    nan = replace(splats, opacity_logits=logits)
    refused = outcome(lambda: str(EvolutionTree.of_splats(nan)))
    yield Row("an opacity of NaN", BOUND, refused, 0.0 if "finite" in refused else np.inf, "")


def _row(name: str, model: str, splats: SplatParams, camera: Camera) -> Row:
    try:
        found = _train(model, splats, camera)
    except (ArithmeticError, InputError) as error:
        return Row(name, BOUND, f"`{type(error).__name__}`: {error}", 0.0, "")
    except Exception as error:
        return Row(name, BOUND, f"`{type(error).__name__}`: {error}", np.inf, "")
    rest = f"; {found.n_at_rest} numbers at rest" if found.n_at_rest else ""
    return Row(
        name,
        BOUND,
        f"{found.n_wrong} of {found.n:,} not finite",
        np.inf if found.n_wrong else 0.0,
        f"{found.n_splats} splats, loss {found.loss:.3g}{rest}",
    )


def _train(kind: str, splats: SplatParams, camera: Camera) -> Found:
    """Train, and look at all numbers after every iteration."""
    from reference_trainer.config import CloudGrowth, Config, FrontierGrowth
    from reference_trainer.data import View
    from reference_trainer.models.backends import backend_for
    from reference_trainer.models.camera_path import CameraPath
    from reference_trainer.models.cloud import Cloud
    from reference_trainer.models.densify import ScreenGradients
    from reference_trainer.models.frontier import Frontier
    from reference_trainer.models.tensors import SplatTensors
    from reference_trainer.train import Model, Stage, Training, train

    photograph = render(ball(30), camera, BACKGROUND).clip(0, 1)
    tensors, path = SplatTensors.of(splats), CameraPath(camera.position[None], 1.0)
    model: Model
    if kind == "cloud":
        cloud = CloudGrowth(start=4, every=4, sh_every=2, threshold=0.0)
        cloud = replace(cloud, prune_opacity=OPACITY, prune_scale=WIDTH)
        model = Cloud(tensors, cloud, path, (0,))
    else:
        frontier = FrontierGrowth(start=4, rounds=3, threshold=0.0)
        frontier = replace(frontier, prune_opacity=OPACITY, prune_scale=WIDTH)
        model = Frontier(tensors, "D", frontier, path)
    n_wrong, n, at_rest = 0, 0, 0

    def count(training: Training) -> None:
        nonlocal n_wrong, n, at_rest
        at_rest = 0
        for variable in training.model.variables():
            for tensor in (variable.m, variable.value.detach()):
                n_wrong += int((~tensor.isfinite()).sum())
                n += tensor.numel()
            at_rest += int(variable.v.isinf().sum())

    view = View("view", camera, photograph)
    config = Config()
    stage = Stage((view,), BACKGROUND, 1.0, ITERATIONS, 2 * len(splats), (0,), config.rates)
    backend = backend_for("cpu")
    training = Training(model, ScreenGradients(model.n_splats, backend.device))
    train(training, stage, config, backend, count)
    return Found(n_wrong, n, at_rest, model.n_splats, training.loss)
