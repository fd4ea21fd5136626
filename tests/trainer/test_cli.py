"""`evogs train` on a small folder: what it writes, what it refuses."""

import argparse
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from evogs_codec import InputError
from evogs_codec.cli.commands import main
from evogs_codec.io.tree_npz import read_tree, write_tree
from evogs_codec.lifting.lift import lift
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.png import write_png
from reference_trainer import cli
from reference_trainer.cli import config_of, finer_than, register
from reference_trainer.config import PRESETS, Config
from reference_trainer.data import load_views
from reference_trainer.models.backends.cpu import Cpu
from reference_trainer.runtime.checkpoint import Checkpoint
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
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines[:2]] == ["L0", "L1"]
    assert "levels drawn at full size, held-out views: " in lines[2]
    assert lines[3].startswith(f"{tmp_path / 'a.png'}: held-out views")
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


def test_a_run_ends_with_a_picture_of_held_out_views_beside_the_tree(folder, tmp_path):
    one, two = tmp_path / "a.tree.npz", tmp_path / "b.tree.npz"
    for out, flags in ((one, []), (two, ["--sheet", tmp_path / "sheet.png"])):
        args = parsed(folder, out, *FLAGS, *SHORT, *flags)
        args.run(args)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 3 * (32 + 4) - 4  # the photograph and two levels
        pixels = np.asarray(picture)
    data = load_views(folder)
    right = np.rint(data.test[0].image * 255)
    bottom = pixels[-32:, :32].astype(int)
    assert np.abs(bottom - right).max() <= 1
    assert (tmp_path / "sheet.png").read_bytes() == (tmp_path / "a.png").read_bytes()
    assert not (tmp_path / "b.png").exists()


def test_a_picture_of_others_is_not_replaced_and_nothing_is_trained(folder, tmp_path):
    write_png(tmp_path / "a.png", np.zeros((2, 2, 3)))
    before = (tmp_path / "a.png").read_bytes()
    args = parsed(folder, tmp_path / "a.tree.npz", *FLAGS, *SHORT)
    with pytest.raises(InputError, match="was not made by"):
        args.run(args)
    assert (tmp_path / "a.png").read_bytes() == before
    assert not (tmp_path / "a.tree.npz").exists()


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


def test_photographs_of_twice_the_size_are_there_if_they_have_it_and_are_not_too_many(
    folder, monkeypatch
):
    def widths(*flags):
        args = parsed(folder, "x", *flags)
        data = load_views(folder, size=args.size)
        finer = finer_than(data, args)
        return None if finer is None else {view.camera.width for view in finer.train}

    assert widths("--size", "16") == {32}
    assert widths("--size", "20") == {32}  # as large as they are
    assert widths() is None
    monkeypatch.setattr(cli, "MAX_SHIFTED", 1000)
    assert widths("--size", "16") is None


def test_the_default_preset_trains_on_shifted_grids(folder, tmp_path, monkeypatch):
    seen = set()
    plain = Cpu.render

    def render(self, splats, camera, background, screen):
        seen.add(camera.width)
        return plain(self, splats, camera, background, screen)

    monkeypatch.setattr(Cpu, "render", render)
    flags = ["--quiet", *SHORT, "--size", "16"]
    parsed_one = parsed(folder, tmp_path / "a.tree.npz", *flags)
    parsed_one.run(parsed_one)
    assert seen == {7, 8, 15, 16}
    seen.clear()
    published = parsed(folder, tmp_path / "b.tree.npz", *flags, "--as-published")
    published.run(published)
    assert seen == {8, 16}


def test_a_preset_is_changed_by_flags():
    config = config_of(parsed("x", "y", "--preset", "paper", "--levels", "3", "--seed", "4"))
    assert (config.n_levels, config.seed, config.next_size) == (3, 4, 0)
    assert config_of(parsed("x", "y", "--next-size", "4")).next_size == 4
    assert config.iterations == PRESETS["paper"].iterations[:3]
    assert config_of(parsed("x", "y")) == PRESETS["two-cores"]
    assert config_of(parsed("x", "y", "--as-published")) == PRESETS["two-cores"].as_published()


@pytest.mark.parametrize("name", PRESETS)
def test_a_configuration_survives_json(name):
    config = PRESETS[name]
    assert Config.from_dict(json.loads(json.dumps(config.as_dict()))) == config


@pytest.mark.parametrize(
    "changes",
    [
        {"method": "x"},
        {"iterations": (1,)},
        {"sh_degree": 4},
        {"max_splats": (0, 1, 2, 3)},
        {"next_size": -1},
    ],
)
def test_an_impossible_configuration_is_refused(changes):
    with pytest.raises(ValueError, match=r"."):
        Config(**changes)


def test_an_output_that_is_the_base_is_refused(folder, tmp_path, capsys):
    out = tmp_path / "a.tree.npz"
    assert main(["train", str(folder), str(out), *FLAGS, *SHORT]) == 0
    before = out.read_bytes()
    assert main(["train", str(folder), str(out), *FLAGS, *SHORT, "--base", str(out)]) == 1
    assert "is an input of the command" in capsys.readouterr().err
    assert out.read_bytes() == before


FOREIGN = {
    "OUT": ("a.tree.npz", [], "is no .tree.npz"),
    "checkpoint": ("work/checkpoint.npz", ["--checkpoint"], "is no checkpoint"),
    "log": ("work/log.csv", ["--checkpoint"], "is no log of a run"),
    "result": ("work/result.json", ["--checkpoint"], "is no result of a run"),
    "picture": ("work/pictures/L1.png", ["--checkpoint"], "is no PNG"),
}


@pytest.mark.parametrize(("name", "flags", "words"), FOREIGN.values(), ids=FOREIGN)
def test_a_file_of_another_kind_is_not_overwritten(folder, tmp_path, capsys, name, flags, words):
    foreign = tmp_path / name
    foreign.parent.mkdir(parents=True, exist_ok=True)
    foreign.write_text("mine, and of no use to a trainer\n")
    out = str(tmp_path / "a.tree.npz")
    flags = [*flags, str(tmp_path / "work")] if flags else []
    assert main(["train", str(folder), out, *FLAGS, *SHORT, *flags]) == 1
    assert words in capsys.readouterr().err
    assert foreign.read_text() == "mine, and of no use to a trainer\n"
    assert main(["train", str(folder), out, *FLAGS, *SHORT, *flags, "--force"]) == 0


def test_a_tree_or_picture_that_others_made_is_not_overwritten(folder, tmp_path, capsys):
    out, work = tmp_path / "a.tree.npz", tmp_path / "work"
    train = ["train", str(folder), str(out), *FLAGS, *SHORT, "--checkpoint", str(work)]
    picture = work / "pictures" / "L1.png"
    picture.parent.mkdir(parents=True)
    write_png(picture, np.zeros((2, 2, 3)))
    assert main(train) == 1
    assert f"{picture}: exists and was not made by `evogs train`" in capsys.readouterr().err
    picture.unlink()
    write_tree(out, lift(make_scene(5), 2), made_by="evogs lift")
    before = out.read_bytes()
    assert main(train) == 1
    assert f"{out}: exists and was not made by `evogs train`" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert main([*train, "--force"]) == 0
    assert main(train) == 0


def test_photographs_are_not_replaced_even_with_force(folder, tmp_path, capsys):
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    photograph, out = folder / "train" / "r_3.png", tmp_path / "a.tree.npz"
    train = [*FLAGS, *SHORT, "--force"]
    assert main(["train", str(folder), str(photograph), "--sheet", str(out) + ".png", *train]) == 1
    assert main(["train", str(folder), str(out), "--sheet", str(photograph), *train]) == 1
    said = f"evogs: {photograph}: is beside the photographs; name another file\n"
    assert capsys.readouterr().err == 2 * said
    (folder / "train").rename(tmp_path / "store")
    (folder / "train").symlink_to(tmp_path / "store")
    assert main(["train", str(folder), str(out), "--sheet", str(photograph), *train]) == 1
    assert capsys.readouterr().err == said
    (folder / "train").unlink()
    (tmp_path / "store").rename(folder / "train")
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--sheet", "x.txt"], "x.txt: the sheet is a PNG"),
        (["--checkpoint", "x"], "x: is a file; name a folder for --checkpoint"),
        (["--levels", "0"], "--levels: 0 is not in 1..64"),
        (["--seed", "-1"], "--seed: -1 is not in"),
    ],
)
def test_what_cannot_be_is_refused_by_name(flags, said, folder, tmp_path, monkeypatch, evogs):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x").touch()
    code, _, err = evogs("train", folder, "a.tree.npz", *flags)
    assert code
    assert said in err


@pytest.mark.parametrize("below", ["", "pictures"])
def test_photographs_are_no_folder_for_checkpoints(folder, tmp_path, capsys, below):
    work = tmp_path / "work"
    (work / below).parent.mkdir(parents=True, exist_ok=True)
    folder.rename(work / below)
    before = {path: path.read_bytes() for path in work.rglob("*.*")}
    command = ["train", str(work / below), str(tmp_path / "a.tree.npz"), *FLAGS, *SHORT]
    assert main([*command, "--checkpoint", str(work)]) == 1
    assert "has the photographs; name another --checkpoint" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in work.rglob("*.*")} == before


def test_missing_photographs_are_a_line_of_warning(folder, tmp_path, capsys):
    (folder / "train" / "r_3.png").unlink()
    assert main(["train", str(folder), str(tmp_path / "a.tree.npz"), *FLAGS, *SHORT]) == 0
    lines = capsys.readouterr().err.splitlines()
    said = "1 of 12 photographs are missing, "
    assert [line for line in lines if line.startswith(f"evogs: warning: {folder}: {said}")] == lines


def test_checkpoints_may_be_in_a_folder_of_their_own_among_the_photographs(folder, tmp_path):
    train = ["train", str(folder), str(tmp_path / "a.tree.npz"), *FLAGS, *SHORT]
    train += ["--checkpoint", str(folder / "work")]
    assert main(train) == 0
    assert main(train) == 0  # what is there is of the same command


def test_a_run_that_was_stopped_is_not_begun_again_by_mistake(folder, tmp_path, capsys):
    command = ["train", str(folder), str(tmp_path / "a.tree.npz"), *FLAGS, *SHORT]
    work = tmp_path / "work"
    command += ["--checkpoint", str(work)]
    assert main(command) == 0
    assert main(command) == 0  # it had ended
    saved = Checkpoint.read(work)
    assert saved is not None
    replace(saved, stage=saved.stage - 1).write(work)
    before = (work / "checkpoint.npz").read_bytes()
    assert main(command) == 1
    said = "has this run, stopped before its end: --resume goes on, --force begins again"
    assert f"evogs: {work}: {said}" in capsys.readouterr().err
    assert (work / "checkpoint.npz").read_bytes() == before
    assert main([*command, "--seed", "1"]) == 0  # another run


def test_a_damaged_checkpoint_says_what_to_do(folder, tmp_path, capsys):
    command = ["train", str(folder), str(tmp_path / "a.tree.npz"), *FLAGS, *SHORT]
    command += ["--checkpoint", str(tmp_path / "work")]
    assert main(command) == 0
    path = tmp_path / "work" / "checkpoint.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    capsys.readouterr()
    assert main([*command, "--resume"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"evogs: {path}: is no checkpoint that is whole")
    assert line.endswith("delete it and start again")
    path.unlink()
    assert main([*command, "--resume"]) == 0
