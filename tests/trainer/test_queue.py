"""The queue: what it runs, in which order, and that nothing runs twice."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from evogs_codec.io.tree_npz import read_tree
from reference_trainer import queue
from reference_trainer.config import METHODS, PRESETS
from reference_trainer.queue import jobs, run_job
from tests.trainer import tiny
from tests.trainer.views_folders import folder_of

ROOT = Path(__file__).resolve().parents[2]


def test_level_0_comes_first_and_every_method_has_its_runs():
    found = list(jobs(PRESETS["quick"], list(METHODS), [0, 1], ["equal", "thresholds"]))
    names = [job.name for job in found]
    assert names[0] == "level0"
    assert len(set(names)) == len(names) == 1 + len(METHODS) + 3 + 3
    assert names.index("equal-evogs-0") < names.index("equal-evogs-1")
    assert all(job.shares == job.name.split("-")[1].startswith(("evogs", "lapis"))
               for job in found[1:])  # fmt: skip
    assert found[0].config.n_levels == 1


def test_trees_fill_an_equal_budget_whatever_the_preset():
    found = jobs(PRESETS["paper"], ["evogs", "lapis"], [0], ["equal", "thresholds"])
    thresholds = {job.name: job.config.frontier.threshold for job in found}
    assert thresholds["equal-evogs-0"] == 0 < thresholds["thresholds-evogs-0"]


@pytest.fixture
def small_queue():
    config = tiny.config()
    return list(jobs(config, ["evogs", "lapis", "single"], [0], ["equal"]))


def test_trees_in_other_integers_are_compared_with_the_same_baselines():
    plain = PRESETS["quick"]
    other = replace(plain, integers=replace(plain.integers, distortion=0.5))
    before, after = (list(jobs(c, list(METHODS), [0], ["equal"])) for c in (plain, other))
    for old, new in zip(before, after, strict=True):
        assert (old.config == new.config) == ("evogs" not in new.name)


def test_a_shared_level_0_is_trained_on_the_same_grids_as_levels_of_its_size(tmp_path, monkeypatch):
    found = {}

    def run(config, pyramid, backend, *, finer, **more):
        found[config.method] = finer and finer.train[0].camera.width
        return tiny.trained()

    monkeypatch.setattr(queue, "run", run)
    data = tiny.dataset()
    first, tree, *_ = jobs(tiny.config(shifts=True), ["evogs"], [0], ["equal"])
    for job in (first, tree):
        run_job(job, data, tmp_path, "cpu", tiny.dataset(64))
    assert found == {"mono": 32, "evogs": 64}
    first, *_ = jobs(tiny.config(), ["evogs"], [0], ["equal"])
    run_job(replace(first, name="other"), data, tmp_path, "cpu", tiny.dataset(64))
    assert found["mono"] is None


def test_a_run_leaves_its_tree_and_figures_and_is_not_repeated(tmp_path, small_queue):
    for job in small_queue:
        run_job(job, tiny.dataset(), tmp_path, "cpu")
    for job in small_queue:
        folder = tmp_path / job.name
        result = json.loads((folder / "result.json").read_text())
        scales = range(1 if job.name == "level0" else 2)
        assert [row["level"] for row in result["levels"]] == list(scales)
        assert result["config"]["method"] == job.config.method
        assert min(result["seconds"], result["threads"]) > 0
        assert "cores" in result["machine"]
        assert {path.name for path in folder.iterdir()} == {
            *("tree.tree.npz", "result.json", "log.csv", "pictures"),
        }  # fmt: skip
    shared = read_tree(tmp_path / "level0" / "tree.tree.npz").leaves(0).channels()
    evogs = read_tree(tmp_path / "equal-evogs-0" / "tree.tree.npz").leaves(0).channels()
    assert (shared == evogs).all()
    before = (tmp_path / "equal-evogs-0" / "result.json").stat().st_mtime_ns
    run_job(small_queue[1], tiny.dataset(), tmp_path, "cpu")
    assert (tmp_path / "equal-evogs-0" / "result.json").stat().st_mtime_ns == before


def test_the_command_line_lists_what_is_to_do(tmp_path, capsys):
    (tmp_path / "level0").mkdir()
    (tmp_path / "level0" / "result.json").write_text("{}")
    flags = ["--data", "x", "--out", str(tmp_path), "--methods", "evogs", "--seeds", "3", "--list"]
    queue.main(flags)
    assert capsys.readouterr().out.splitlines() == [
        "level0: done", "equal-evogs-3: to do", "thresholds-evogs-3: to do",
    ]  # fmt: skip


def test_a_damaged_level_0_ends_the_queue_with_one_line(tmp_path, capsys):
    (tmp_path / "level0").mkdir()
    (tmp_path / "level0" / "result.json").write_text("{}")
    (tmp_path / "level0" / "tree.tree.npz").write_bytes(b"PK")
    photos = folder_of(tmp_path / "photos", "blender", n=3)
    flags = ["--data", str(photos), "--out", str(tmp_path), "--methods", "evogs"]
    with pytest.raises(SystemExit) as ended:
        queue.main(flags)
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(str(tmp_path / "level0" / "tree.tree.npz"))


def test_it_is_a_program(tmp_path):
    command = [sys.executable, "-m", "reference_trainer.queue", "--data", "x", "--list"]
    done = subprocess.run(
        [*command, "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("level0: to do\nequal-evogs-0: to do\n")
