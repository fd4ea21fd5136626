"""A whole run: every stage of a method, with checkpoints, a log and a progress bar."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evogs_codec import EvolutionTree, InputError
from reference_trainer.config import MAX_SHIFTED, Config
from reference_trainer.data.pyramid import on_shifted_grids
from reference_trainer.methods import method_named
from reference_trainer.methods.base import Done, Method, Plan, Setting
from reference_trainer.models.backends import Backend
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.densify import ScreenGradients
from reference_trainer.runtime.checkpoint import Checkpoint, refuse, run_identity
from reference_trainer.runtime.progress import Progress
from reference_trainer.train import Model, Stage, Training, train

if TYPE_CHECKING:
    from reference_trainer.data import Dataset, View

__all__ = ["is_unfinished", "photographs", "run"]

VIEWS = 2  # purpose of random numbers: the order of views


def run(
    config: Config,
    pyramid: tuple[Dataset, ...],
    backend: Backend,
    *,
    folder: Path | None = None,
    resume: bool = False,
    base: EvolutionTree | None = None,
    finer: Dataset | None = None,
    progress: Progress | None = None,
) -> EvolutionTree:
    """Train every stage of `config.method`.

    Args:
        config: of the run.
        pyramid: the data at the resolution of each level.
        backend: where to.
        folder: for checkpoints and the log; without it there are none.
        resume: go on from the checkpoint in `folder`, if there is one.
        base: a tree whose level 0 is taken instead of training one; for `evogs*` and `lapis`.
        finer: the data at twice the size of the last level, for `config.shifts`; without it that
            level has none.
        progress: told about every iteration.

    Raises:
        InputError: the checkpoint is of another run, `base` does not fit, or no splat is left.
        NotFiniteError: training went wrong; the last checkpoint is from before.
    """
    if len(pyramid) != config.n_levels:
        raise ValueError(f"{len(pyramid)} scales of pictures for {config.n_levels} levels")
    progress = progress or Progress()
    method = method_named(config.method)
    plans = method.plans(config)
    scales = pyramid if finer is None else (*pyramid, finer)
    identity = run_identity(config, _fingerprint(pyramid[-1], finer, base))
    saved = None
    if folder is not None and resume and (saved := Checkpoint.read(folder)) is not None:
        saved.check(folder, identity, plans)
    if saved is None:
        first, done = _start(method, config, plans, base)
        saved = Checkpoint(identity, first, done, 0, {}, {})
    progress.resume(saved.stage, saved.iteration)
    for stage in range(saved.stage, len(plans)):
        saved = _run_stage(saved, method, plans, config, scales, backend, folder, progress)
        assert saved.stage == stage + 1
    progress.finish(saved.done)
    return saved.done.tree


def is_unfinished(
    folder: Path,
    config: Config,
    pyramid: tuple[Dataset, ...],
    *,
    base: EvolutionTree | None = None,
    finer: Dataset | None = None,
) -> bool:
    """Whether there is a checkpoint of this `run`, which was stopped before its end."""
    try:
        saved = Checkpoint.read(folder)
    except InputError:  # damaged: nothing can go on from it
        return False
    identity = run_identity(config, _fingerprint(pyramid[-1], finer, base))
    n_stages = len(method_named(config.method).plans(config))
    return saved is not None and saved.run == identity and saved.stage < n_stages


def _start(
    method: Method, config: Config, plans: list[Plan], base: EvolutionTree | None
) -> tuple[int, Done]:
    """The stage to begin with, and what is there before it."""
    done = Done(config.sh_degree)
    if base is None:
        return 0, done
    if not method.takes_base:
        raise InputError(f"method {config.method} does not build on a level 0 of others")
    if base.sh_degree != config.sh_degree:
        raise InputError(f"level 0 has SH degree {base.sh_degree}, expected {config.sh_degree}")
    done = done.with_steps(*(step for step in base.steps if step.level == 0))
    if base.quanta and len(plans) > 1 and plans[1].in_integers:  # it need not be rounded again
        return 2, replace(done, quanta=base.quanta[:2])
    return 1, done


def _run_stage(
    saved: Checkpoint,
    method: Method,
    plans: list[Plan],
    config: Config,
    scales: tuple[Dataset, ...],
    backend: Backend,
    folder: Path | None,
    progress: Progress,
) -> Checkpoint:
    """Train the stage of a checkpoint; the checkpoint at its end."""
    plan = plans[saved.stage]
    data = replace(scales[plan.scale], train=photographs(scales, plan.scale, config))
    setting = Setting(
        config, plan, data, CameraPath.of([view.camera for view in data.train]), backend.device
    )
    model = method.begin(setting, saved.done)
    scene_size = setting.path.scene_size(model.splats(0).means.detach().cpu().numpy())
    training = _restored(model, saved, folder, backend)
    progress.begin(saved.stage, plan, data, backend)

    def each(training: Training) -> None:
        progress.each(training)
        if folder is not None and training.iteration % config.checkpoint_every == 0:
            arrays, scores = model.arrays(), training.scores.arrays()
            at = training.iteration
            replace(saved, iteration=at, model=arrays, scores=scores).write(folder)

    order = setting.seed(VIEWS)
    rates = config.rates.at_most(model.reach / scene_size)
    stage = Stage(
        photographs(scales, plan.scale, config, shifts=config.shifts),
        data.background,
        scene_size,
        plan.iterations,
        plan.cap,
        order,
        config.integers.rates(rates) if plan.in_integers else rates,
        config.integers.thrift * config.integers.distortion if config.integers.part else 0.0,
    )
    train(training, stage, config, backend, each)
    if not model.n_splats and plan.level != plans[-1].level:
        raise InputError(
            f"level {plan.level} ended without a splat: its photographs may be too small,"
            " take fewer levels or a larger size"
        )
    done = method.finish(setting, saved.done, model)
    progress.end(done)
    after = Checkpoint(saved.run, saved.stage + 1, done, 0, {}, {})
    if folder is not None:
        after.write(folder)
    return after


def photographs(
    scales: tuple[Dataset, ...], scale: int, config: Config, *, shifts: bool = False
) -> tuple[View, ...]:
    """What a scale is trained on: its photographs, and those that `config` adds.

    Args:
        scales: the data at the resolution of each level; perhaps at twice the last, too.
        scale: number of one of them.
        config: says how many there are of the next size.
        shifts: whether they are on shifted grids, too, where a larger scale is there and they are
            not too many.
    """
    own = scales[scale].train
    shifts = shifts and sum(view.image.size for view in own) <= MAX_SHIFTED
    finer = scales[scale + 1].train if scale + 1 < len(scales) else ()
    found = on_shifted_grids(own, finer) if shifts else own
    if not config.next_size or scale + 1 >= config.n_levels:
        return found
    return found * config.next_size + finer * (len(found) // len(own))


def _restored(model: Model, saved: Checkpoint, folder: Path | None, backend: Backend) -> Training:
    if folder is None or not saved.model:
        return Training(model, ScreenGradients(model.n_splats, backend.device))
    try:
        model.restore(saved.model)
        scores = ScreenGradients(model.n_splats, backend.device)
        scores.restore(saved.scores)
    except InputError as error:
        refuse(folder, error)
    return Training(model, scores, saved.iteration)


def _fingerprint(
    data: Dataset, finer: Dataset | None, base: EvolutionTree | None
) -> dict[str, Any]:
    """What tells one data set, and one level 0, from another."""
    digest = hashlib.sha256()
    for view in (*data.train, *data.test, *(finer.train if finer is not None else ())):
        camera = view.camera
        digest.update(view.name.encode("utf-8", "surrogateescape"))  # as file systems have it
        digest.update(camera.rotation.tobytes() + camera.translation.tobytes())
        digest.update(np.array([camera.fx, camera.fy, camera.cx, camera.cy]).tobytes())
        digest.update(np.array(view.image.shape).tobytes())
        digest.update(np.ascontiguousarray(view.image).tobytes())
    for start in (data.points, data.colours):
        digest.update(b"" if start is None else np.ascontiguousarray(start).tobytes())
    for step in base.steps if base is not None else ():
        digest.update(step.adds.tobytes())
    if base is not None and base.quanta:
        digest.update(np.array(base.quanta[:2]).tobytes())
    return {"name": data.name, "background": list(data.background), "sha256": digest.hexdigest()}
