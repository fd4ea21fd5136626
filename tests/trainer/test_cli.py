"""`evogs train` on a small folder: what it writes, what it refuses."""

import argparse
import json

import numpy as np
import pytest

from evogs_codec.interchange import read_tree
from reference_trainer.cli import config_of, register
from reference_trainer.config import PRESETS, Config
from tests.trainer import tiny
from tools.photo_formats import FORMATS, Cloud, Shot

FLAGS = ["--preset", "quick", "--quiet"]
SHORT = ["--levels", "2", "--iterations", "30", "--max-splats", "20", "40", "--sh-degree", "0"]


def parsed(*arguments):
    parser = argparse.ArgumentParser()
    register(parser.add_subparsers())
    return parser.parse_args(["train", *map(str, arguments)])


@pytest.fixture
def folder(tmp_path):
    views = tiny.dataset().test + tiny.dataset().train
    shots = [
        Shot(v.camera, (0, 0, 0, 0), np.round(v.image * 255).astype(np.uint8), test=i == 0)
        for i, v in enumerate(views)
    ]
    path = tmp_path / "photographs"
    path.mkdir()
    FORMATS["blender"](path, shots, Cloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8)))
    return path


def test_training_a_folder(folder, tmp_path, capsys):
    out, work = tmp_path / "a.tree.npz", tmp_path / "work"
    args = parsed(folder, out, *FLAGS, *SHORT, "--checkpoint", work)
    args.run(args)
    tree = read_tree(out)
    assert (tree.n_levels, tree.sh_degree) == (2, 0)
    assert len(capsys.readouterr().out.splitlines()) == 2
    rows = json.loads((work / "result.json").read_text())["levels"]
    assert [row["width"] for row in rows] == [16, 32]
    assert (work / "pictures" / "L1.png").exists()
    again = parsed(
        folder, tmp_path / "b.tree.npz", *FLAGS, *SHORT, "--checkpoint", work, "--resume"
    )
    again.run(again)
    assert (tmp_path / "b.tree.npz").read_bytes() == out.read_bytes()
    lapis = parsed(
        folder, tmp_path / "c.tree.npz", *FLAGS, *SHORT, "--method", "lapis", "--base", out
    )
    lapis.run(lapis)
    np.testing.assert_array_equal(
        read_tree(tmp_path / "c.tree.npz").leaves(0).means, tree.leaves(0).means
    )


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--resume"], "--resume needs --checkpoint"),
        (["--iterations", "3", "4"], "--iterations has 2 numbers for 4 levels"),
        (["--levels", "6"], "6 levels: name --iterations and --max-splats"),
        (["--device", "tpu"], "device 'tpu' is neither cpu nor cuda"),
    ],
)
def test_flags_that_do_not_fit_are_refused(flags, message, tmp_path):
    args = parsed(tmp_path, tmp_path / "a.tree.npz", *flags)
    with pytest.raises(ValueError, match=message):
        args.run(args)


def test_a_preset_is_changed_by_flags():
    config = config_of(parsed("x", "y", "--preset", "paper", "--levels", "3", "--seed", "4"))
    assert (config.n_levels, config.seed) == (3, 4)
    assert config.iterations == PRESETS["paper"].iterations[:3]


@pytest.mark.parametrize("name", PRESETS)
def test_a_configuration_survives_json(name):
    config = PRESETS[name]
    assert Config.from_dict(json.loads(json.dumps(config.as_dict()))) == config


@pytest.mark.parametrize(
    "changes",
    [{"method": "x"}, {"iterations": (1,)}, {"sh_degree": 4}, {"max_splats": (0, 1, 2, 3)}],
)
def test_an_impossible_configuration_is_refused(changes):
    with pytest.raises(ValueError, match=r"."):
        Config(**changes)
