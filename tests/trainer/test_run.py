"""Runs: the same bytes for any number of threads and after any interruption; faults."""

import itertools
import os
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from evogs_codec import InputError
from evogs_codec.io.tree_npz import write_tree
from reference_trainer.config import PRESETS, FrontierGrowth, Integers
from reference_trainer.models.backends import backend_for
from reference_trainer.models.backends.cpu import Cpu
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.run import photographs, run
from reference_trainer.runtime.checkpoint import FILE, Checkpoint
from reference_trainer.runtime.progress import Progress
from reference_trainer.train import NotFiniteError, train
from tests.trainer import tiny
from tests.trainer.stopping import StoppedError, StopsAt

ROOT = Path(__file__).resolve().parents[2]


def tree_bytes(tree):
    return b"".join(
        np.ascontiguousarray(x).tobytes()
        for step in tree.steps
        for x in (step.slots, step.kinds, step.psi, step.alpha, step.adds)
    )


def trained(method="evogs", pyramid=None, **changes):
    return run(tiny.config(method=method), pyramid or tiny.pyramid(), backend_for("cpu"), **changes)


@pytest.mark.parametrize("part", [0, 0.5])
def test_the_number_of_threads_does_not_matter(part):
    config, found = tiny.config(integers=Integers(part)), []
    before = numba.get_num_threads()
    for threads in {1, numba.config.NUMBA_NUM_THREADS}:
        numba.set_num_threads(threads)
        found.append(tree_bytes(run(config, tiny.pyramid(), backend_for("cpu"))))
    numba.set_num_threads(before)
    assert len(set(found)) == 1


@pytest.mark.parametrize(
    ("method", "part", "n_views"),
    [
        ("evogs", 0, None),
        ("evogs", 0.5, 2),
        ("evogs-b", 0, None),
        ("lapis", 0, None),
        ("l3gs", 0, None),
    ],
)
def test_a_run_stopped_anywhere_goes_on_to_the_same_bytes(method, part, n_views, tmp_path):
    config = tiny.config(method=method, integers=Integers(part))
    # The path of two cameras is short: rates follow what a stage begins with.
    scales = tuple(replace(data, train=data.train[:n_views]) for data in tiny.pyramid())
    whole = run(config, scales, backend_for("cpu"))
    for stop in itertools.count(7, 13):
        try:
            tree = run(
                config,
                scales,
                backend_for("cpu"),
                folder=tmp_path,
                resume=True,
                progress=StopsAt(stop),
            )
            break
        except StoppedError:
            pass
    assert tree_bytes(tree) == tree_bytes(whole)
    assert tree.quanta == whole.quanta


def test_a_killed_run_goes_on_to_the_same_bytes(tmp_path):
    whole = tree_bytes(trained())
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from reference_trainer.models.backends import backend_for\n"
        "from reference_trainer.runtime.progress import Progress\n"
        "from reference_trainer.run import run\n"
        "from tests.trainer import tiny\n"
        "class Slow(Progress):\n"
        "    def each(self, training):\n"
        "        print(training.iteration, flush=True)\n"
        "folder = Path(sys.argv[1])\n"
        "run(tiny.config(), tiny.pyramid(), backend_for('cpu'), folder=folder, progress=Slow())\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        for _ in range(57):
            process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
    assert (tmp_path / FILE).exists()
    assert tree_bytes(trained(folder=tmp_path, resume=True)) == whole


def test_the_log_of_a_resumed_run_has_every_row_once(tmp_path):
    log = tmp_path / "log.csv"
    config = replace(tiny.config(), iterations=(200, 100), checkpoint_every=100)

    class LogsAndStops(Progress):
        def each(self, training):
            super().each(training)
            if training.iteration == 30 and self._plan.level == 1:
                raise StoppedError

    with pytest.raises(StoppedError):
        run(config, tiny.pyramid(), backend_for("cpu"), folder=tmp_path, progress=LogsAndStops(log))
    run(
        config, tiny.pyramid(), backend_for("cpu"),
        folder=tmp_path, resume=True, progress=Progress(log),
    )  # fmt: skip
    rows = [line.split(",")[:3] for line in log.read_text().splitlines()]
    assert rows == [
        ["stage", "level", "iteration"], ["0", "0", "100"], ["0", "0", "200"], ["1", "1", "100"],
    ]  # fmt: skip


LOGS = {
    "a row cut short": (b"stage,level,iteration,loss,splats,psnr,seconds\r\n0,0,1", None),
    "nothing": (b"", None),
    "another file": (b"name,price\r\ntea,3\r\n", "is no log of a run"),
    "a row of text": (
        b"stage,level,iteration,loss,splats,psnr,seconds\r\na,b,c,d,e,f,g\r\n0,0,1,1,1,1,1\r\n",
        "is no log of a run",
    ),
    "no text": (b"stage,level,iteration\xff\xfe\0", "is no log of a run"),
}


@pytest.mark.parametrize(("data", "words"), LOGS.values(), ids=LOGS)
def test_a_log_that_is_none_is_refused_and_a_last_row_cut_short_is_left_out(tmp_path, data, words):
    log = tmp_path / "log.csv"
    log.write_bytes(data)
    if words is None:
        Progress(log).resume(1, 1)
        assert log.read_bytes() == b"stage,level,iteration,loss,splats,psnr,seconds\r\n"
        return
    with pytest.raises(InputError, match=words):
        Progress(log).resume(1, 1)
    assert log.read_bytes() == data


def test_level_0_may_be_shared(tmp_path):
    base = trained("mono")
    tree = trained(base=base)
    np.testing.assert_array_equal(tree.leaves(0).channels(), base.leaves(0).channels())
    with pytest.raises(InputError, match="does not build on"):
        trained("mono", base=base)


def test_training_stops_where_the_loss_is_not_finite_and_keeps_the_checkpoint(tmp_path):
    good = tiny.pyramid()
    bad = good[1].train[3].image.copy()
    bad[0, 0] = np.nan
    views = tuple(replace(v, image=bad) if i == 3 else v for i, v in enumerate(good[1].train))
    with pytest.raises(NotFiniteError, match="the loss is nan"):
        trained(pyramid=(good[0], replace(good[1], train=views)), folder=tmp_path)
    saved = Checkpoint.read(tmp_path)
    assert saved is not None
    assert saved.stage == 1
    assert len(saved.done.tree.leaves())


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    trained(folder=tmp_path)
    with pytest.raises(InputError, match="another configuration"):
        trained("lapis", folder=tmp_path, resume=True)
    (tmp_path / FILE).write_bytes(b"PK")
    with pytest.raises(InputError, match="is no checkpoint"):
        trained(folder=tmp_path, resume=True)


@pytest.mark.parametrize("what", ["size", "lens", "points"])
def test_a_checkpoint_of_other_data_is_refused(tmp_path, what):
    good = tiny.pyramid()
    finer, last = tiny.dataset(64), good[1]
    trained(folder=tmp_path, finer=finer, pyramid=good)
    if what == "size":  # of the photographs that are measured; the finer ones are the same
        last = tiny.dataset(24)
    elif what == "points":
        last = replace(last, points=last.points + np.float32(0.1))
    else:
        wider = [replace(view, camera=replace(view.camera, fx=view.camera.fx + 1))
                 for view in last.train]  # fmt: skip
        last = replace(last, train=tuple(wider))
    with pytest.raises(InputError, match="another configuration or data"):
        trained(folder=tmp_path, finer=finer, pyramid=(good[0], last), resume=True)


def test_a_trained_tree_is_a_file_of_the_same_bytes_twice(tmp_path):
    for name in "ab":
        write_tree(tmp_path / f"{name}.tree.npz", trained())
    assert (tmp_path / "a.tree.npz").read_bytes() == (tmp_path / "b.tree.npz").read_bytes()


def test_levels_but_the_last_are_trained_on_photographs_of_the_next_size_too():
    seen = []

    class Seeing(Cpu):
        def render(self, splats, camera, background, screen):
            seen.append(camera.width)
            return super().render(splats, camera, background, screen)

    config = tiny.config(next_size=2)
    n = len(tiny.dataset().train)
    config = replace(config, iterations=(3 * n, n), method="evogs")
    run(config, tiny.pyramid(), Seeing())
    first, last = seen[: 3 * n], seen[3 * n :]
    assert (first.count(16), first.count(32)) == (2 * n, n)
    assert set(last) == {32}


def test_levels_are_trained_on_shifted_grids_where_a_larger_size_is_there():
    seen = []

    class Seeing(Cpu):
        def render(self, splats, camera, background, screen):
            seen.append((camera.width, camera.height))
            return super().render(splats, camera, background, screen)

    n = len(tiny.dataset().train)
    config = tiny.config(shifts=True, iterations=(4 * n, 4 * n), method="evogs")
    run(config, tiny.pyramid(), Seeing())
    assert Counter(seen[: 4 * n]) == dict.fromkeys(((16, 16), (15, 16), (16, 15), (15, 15)), n)
    assert set(seen[4 * n :]) == {(32, 32)}
    seen.clear()
    *coarse, finer = tiny.pyramid(3)
    both = replace(config, iterations=(8 * n, 4 * n), next_size=1)
    run(both, tuple(coarse), Seeing(), finer=finer)
    counts = Counter(seen[: 8 * n])
    assert counts.pop((16, 16)) == 4 * n
    assert counts == dict.fromkeys(((8, 8), (7, 8), (8, 7), (7, 7)), n)
    assert set(seen[8 * n :]) == {(16, 16), (15, 16), (16, 15), (15, 15)}


def test_levels_of_too_many_photographs_have_one_grid(monkeypatch):
    scales, config = tiny.pyramid(3), tiny.config(shifts=True)
    n = len(scales[0].train)
    numbers = [sum(view.image.size for view in data.train) for data in scales]
    monkeypatch.setattr("reference_trainer.run.MAX_SHIFTED", numbers[0])
    counts = [len(photographs(scales, i, config, shifts=True)) for i in range(3)]
    assert counts == [4 * n, n, n]  # of the first level, of one too large, of one without a larger


@pytest.mark.parametrize("method", ["evogs", "lapis"])
def test_positions_of_small_leaves_move_less(method, monkeypatch):
    seen = []

    def watched(training, stage, *rest):
        seen.append((stage.rates.position, stage.rates.position_final, stage.scene_size))
        train(training, stage, *rest)

    monkeypatch.setattr("reference_trainer.run.train", watched)
    first_step, rates = 1e-4, tiny.config().rates
    growth = FrontierGrowth(start=1, rounds=1, threshold=0.0, first_step=first_step)
    config = tiny.config(method=method, frontier=growth, integers=Integers(0.1))
    tree = run(config, tiny.pyramid(), backend_for("cpu"))
    assert len(seen) == (4 if method == "evogs" else 2)  # trees train in integers, too
    widths = np.sort(np.exp(tree.leaves(0).log_scales), axis=1)[:, 1:]
    slow = first_step * np.median(np.sqrt(widths.prod(axis=1))) / seen[0][2]
    assert slow < rates.position
    part = slow / rates.position
    floats = seen[::2] if method == "evogs" else seen
    parts = [1.0, part if method == "evogs" else 1.0]
    for (first, last, _), own in zip(floats, parts, strict=True):
        assert first == pytest.approx(own * rates.position, rel=1e-4)
        assert last == pytest.approx(own * rates.position_final, rel=1e-4)
    if method == "evogs":
        in_integers = [position for position, *_ in seen[1::2]]
        assert in_integers[1] == pytest.approx(part * in_integers[0], rel=1e-4)


def test_rates_of_positions_follow_the_distance_where_the_path_of_cameras_is_short(monkeypatch):
    seen = []

    def watched(training, stage, *rest):
        seen.append((stage.scene_size, training.model.splats(0).means.detach().numpy().copy()))
        train(training, stage, *rest)

    monkeypatch.setattr("reference_trainer.run.train", watched)
    scales = tiny.pyramid()
    short = [replace(data, train=data.train[:2]) for data in scales]
    run(tiny.config(), tuple(short), backend_for("cpu"))
    path = CameraPath.of([view.camera for view in short[0].train])
    for scale, means in seen:
        distances = np.linalg.norm(means[:, None] - path.places, axis=2).min(axis=1)
        assert scale == pytest.approx(np.median(np.maximum(distances, path.extent)))
    assert all(scale > path.extent for scale, _ in seen)


def test_the_preset_that_takes_long_has_shifted_grids_but_as_published_it_has_none():
    best = PRESETS["two-cores"]
    assert (best.shifts, best.ssim_weight) == (True, 0.4)
    frontier = replace(best.frontier, size_power=0.0, first_step=0.0)
    assert best.frontier.size_power > 0
    assert best.frontier.first_step > 0
    plain = replace(best, shifts=False, ssim_weight=0.2, frontier=frontier)
    assert best.as_published() == plain
    for name in ("paper", "quick"):
        assert PRESETS[name].as_published() == PRESETS[name]
