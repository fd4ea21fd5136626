"""The command line where it is given what it cannot use, and odd scenes: one line says why."""

import errno
import json
import os
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evogs_codec import SplatParams, read_ply, write_ply
from evogs_codec.cli import commands
from evogs_codec.cli.commands import main
from evogs_codec.render.demo_scene import make_scene

COMMANDS = ("encode", "decode", "lift", "info", "validate", "extract", "edit", "compare", "tileset")


# --- files that cannot be used -------------------------------------------------------------------

NOT_A_SCENE = {
    "empty": b"",
    "text": b"hello\n",
    "png": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "half a zip": b"PK\x03\x04" + bytes(20),
    "ply without vertices": b"ply\nformat ascii 1.0\nend_header\n",
    "ply of a mesh": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
    b"property float y\nproperty float z\nend_header\n0 0 0\n",
}


@pytest.mark.parametrize("name", NOT_A_SCENE)
@pytest.mark.parametrize("command", ["encode", "lift"])
def test_what_is_no_scene_is_refused_in_one_line(command, name, refused, tmp_path):
    path = tmp_path / f"{name}.ply"
    path.write_bytes(NOT_A_SCENE[name])
    refused(command, path, tmp_path / "out", words=[path])
    assert not (tmp_path / "out").exists()


NO_STREAM = {
    "scene.ply": "is a .ply scene, not a stream: `evogs encode",
    "x.tree.npz": "is a zip (.npz), not a stream: `evogs encode",
    "zeros": "has only zeros, as of an interrupted copy or download",
    "picture": "is a PNG, not a stream",
    "text": "is not an EvoGS stream: give a file that `evogs encode` made",
}


@pytest.mark.parametrize("name", NO_STREAM)
@pytest.mark.parametrize("command", ["decode", "info", "extract", "render", "sheet"])
def test_what_is_no_stream_is_refused_and_the_line_says_what_to_give(
    command, name, refused, made, tmp_path
):
    if command == "render" and name == "scene.ply":
        pytest.skip("a .ply is rendered")
    path = made / name
    if not path.exists():
        contents = {"zeros": bytes(5000), "picture": b"\x89PNG\r\n\x1a\n", "text": b"hello"}
        path = tmp_path / name
        path.write_bytes(contents[name])
    target = [] if command == "info" else [tmp_path / "out"]
    options = ["render", path, *target, "--sheet"] if command == "sheet" else [command, path]
    options += target if command not in ("sheet", "info") else []
    said = refused(*options, words=[path, NO_STREAM[name]])
    assert "E_SIGNATURE" not in said
    assert not (tmp_path / "out").exists()


def test_validate_says_the_fault_of_what_is_no_stream(refused, made):
    refused("validate", made / "scene.ply", words=["scene.ply", "E_SIGNATURE", "spec 5.1"])


@pytest.mark.parametrize("command", ["encode", "lift"])
def test_a_stream_is_not_encoded_again(command, refused, made, tmp_path):
    words = [made / "scene.evogs", "is an EvoGS stream already", "evogs extract", "evogs decode"]
    refused(command, made / "scene.evogs", tmp_path / "out", words=words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["encode", "lift"])
def test_what_is_neither_scene_nor_tree_is_refused_and_the_line_says_what_to_do(
    command, refused, tmp_path
):
    with zipfile.ZipFile(tmp_path / "bundle", "w") as archive:
        archive.writestr("meta.json", "{}")
    (tmp_path / "zeros").write_bytes(bytes(5000))
    words = {"bundle": "meta.json has no object 'means'", "zeros": "only zeros, as of an inter"}
    for name, said in words.items():
        refused(command, tmp_path / name, tmp_path / "out", words=[tmp_path / name, said])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "words"), [(["--levels", 3], "--levels is for"), (["--workers", 2], "encoded whole")]
)
def test_options_of_scenes_are_refused_of_a_tree(option, words, refused, made, tmp_path):
    refused("encode", made / "x.tree.npz", tmp_path / "out", *option, words=[words])
    assert not (tmp_path / "out").exists()


def test_a_tree_is_not_lifted(refused, made, tmp_path):
    refused("lift", made / "x.tree.npz", tmp_path / "out", words=["not a scene", ".ply"])


def test_a_scene_that_is_cut_short_is_refused(refused, made, tmp_path):
    path = tmp_path / "short.ply"
    path.write_bytes((made / "scene.ply").read_bytes()[:-1])
    refused("encode", path, tmp_path / "out.evogs", words=[path, "cut short"])


def test_a_download_that_was_cut_short_is_named_as_such_and_still_shows(
    evogs, refused, made, tmp_path
):
    data = (made / "scene.evogs").read_bytes()
    path = tmp_path / "part.evogs"
    path.write_bytes(data[: len(data) // 2])
    words = [path, "E_TRUNCATED", "at byte", "spec 6.2"]
    refused("validate", path, words=words)
    refused("decode", path, tmp_path / "no.ply", words=words)
    assert not (tmp_path / "no.ply").exists()
    code, out, _ = evogs("validate", path, "--json")
    report = json.loads(out)
    assert (code, report["valid"], report["fault"]) == (1, False, "E_TRUNCATED")
    assert report["section"] == "6.2"
    assert 64 < report["offset"] <= len(data) // 2
    code, out, _ = evogs("decode", path, tmp_path / "part.ply", "--partial")
    assert code == 0
    assert "50.0 %" in out
    assert 0 < len(read_ply(tmp_path / "part.ply")) <= 3000
    code, out, _ = evogs("info", path)
    assert code == 0
    assert "truncated" in out
    path.write_bytes(data[:100])
    refused("decode", path, tmp_path / "no.ply", "--partial", words=["E_TRUNCATED"])


def arguments_of(command, source, target):
    return [command, source, *([target] if command not in ("info", "validate") else [])]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_missing_file_and_a_folder_as_input_are_refused(command, refused, tmp_path):
    missing = tmp_path / "missing"
    refused(*arguments_of(command, missing, tmp_path / "out"), words=[missing])
    refused(*arguments_of(command, tmp_path, tmp_path / "out"), words=[tmp_path])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["encode", "decode", "lift", "extract"])
def test_an_output_that_cannot_be_written_is_named_and_nothing_is_left(
    command, refused, made, tmp_path
):
    source = made / ("scene.ply" if command in ("encode", "lift") else "scene.evogs")
    (tmp_path / "file").write_bytes(b"")
    for target, said in (
        (tmp_path / "no" / "out", "its folder does not exist"),
        (tmp_path / "file" / "out", "file is a file, not a folder"),
        (tmp_path / "file" / "no" / "out", "file is a file, not a folder"),
        (tmp_path, "directory"),
    ):
        refused(command, source, target, words=[target, said])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write")
def test_a_read_only_folder_is_named(refused, made, tmp_path):
    tmp_path.chmod(0o500)
    refused("extract", made / "scene.evogs", tmp_path / "out", words=["out: its folder may not be"])
    tmp_path.chmod(0o700)


@pytest.mark.parametrize(
    "command", [pytest.param("encode", marks=pytest.mark.thorough), "decode", "lift", "extract"]
)
def test_a_failure_leaves_the_old_output_and_no_temporary_file(
    command, refused, made, tmp_path, monkeypatch
):
    source = made / ("scene.ply" if command in ("encode", "lift") else "scene.evogs")
    target = tmp_path / "out"
    target.write_bytes(b"old")

    def disk_full(_self, _target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "replace", disk_full)
    refused(command, source, target, "--force", words=[target, "No space left"])
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_interrupt_leaves_the_old_output_and_no_temporary_file(
    evogs, made, tmp_path, monkeypatch
):
    target = tmp_path / "out"
    target.write_bytes(b"old")

    def interrupt(_self, _target):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupt)
    code, out, err = evogs("extract", made / "scene.evogs", target, "--level", 0, "--force")
    assert (code, out, err) == (130, "", "evogs: interrupted\n")
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_bug_is_not_dressed_up_as_a_bad_file(made, monkeypatch):
    def bug(*_, **__):
        raise IndexError("a bug")

    monkeypatch.setattr(commands, "open_stream", bug)
    with pytest.raises(IndexError):
        main(["info", str(made / "scene.evogs")])


# --- odd scenes ----------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_scenes_of_few_splats_go_through_every_command(n, evogs, tmp_path):
    scene, stream, back = (tmp_path / name for name in ("a.ply", "a.evogs", "b.ply"))
    write_ply(scene, make_scene(max(n, 5)).take(np.arange(n)))
    for command in (
        ["encode", scene, stream],
        ["validate", stream],
        ["info", stream],
        ["decode", stream, back, "--verify"],
        ["extract", stream, tmp_path / "c.evogs", "--level", 0],
        ["lift", scene, tmp_path / "a.tree.npz"],
        ["encode", tmp_path / "a.tree.npz", tmp_path / "d.evogs"],
    ):
        code, _, err = evogs(*command)
        assert code == 0, command
        assert err == "", command
    assert len(read_ply(back)) == n


def test_splats_that_are_not_finite_are_refused_or_dropped_and_counted(evogs, refused, tmp_path):
    means = make_scene(50).means.copy()
    means[3, 0], means[7, 1] = np.nan, np.inf
    scene = make_scene(50)
    bad = SplatParams(means, scene.quats, scene.log_scales, scene.opacity_logits, scene.sh)
    path = tmp_path / "bad.ply"
    write_ply(path, bad)
    for command in ("encode", "lift"):
        target = tmp_path / f"{command}.out"
        refused(command, path, target, words=[path, "2 of 50", "--drop-invalid"])
        assert not target.exists()
        code, out, err = evogs(command, path, target, "--drop-invalid")
        assert code == 0
        assert err == "evogs: warning: 2 splats with NaN or infinite numbers left out\n"
        assert "48 splats" in out
    write_ply(path, replace(scene, means=np.full((50, 3), np.nan, np.float32)))
    refused("encode", path, tmp_path / "none", "--drop-invalid", words=["all 50 splats have a NaN"])
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    "largest", [pytest.param(1e6, marks=pytest.mark.thorough), 1e12, 1e30, 3e38]
)
def test_huge_positions_are_refused_or_kept_with_a_word_about_it(largest, evogs, tmp_path):
    scene = make_scene(200)
    means = scene.means.copy()
    means[0] = largest
    path = tmp_path / "huge.ply"
    write_ply(
        path, SplatParams(means, scene.quats, scene.log_scales, scene.opacity_logits, scene.sh)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        code, _, err = evogs("encode", path, tmp_path / "huge.evogs")
    assert code in (0, 1)
    assert all(line.startswith("evogs: ") for line in err.splitlines())
    if code:
        assert err.count("\n") == 1
        assert not (tmp_path / "huge.evogs").exists()
    else:
        assert evogs("decode", tmp_path / "huge.evogs", tmp_path / "back.ply")[0] == 0
        back = read_ply(tmp_path / "back.ply").means
        assert np.abs(back).max() == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize("field", ["quats", "log_scales", "opacity_logits", "sh"])
@pytest.mark.parametrize(
    "value", [1e30, *(pytest.param(value, marks=pytest.mark.thorough) for value in (-1e30, 1e-40))]
)
def test_huge_and_tiny_attributes_raise_no_traceback(field, value, evogs, tmp_path):
    scene = make_scene(100)
    arrays = {
        name: np.array(getattr(scene, name))
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh")
    }
    arrays[field].reshape(100, -1)[5] = value
    path = tmp_path / "odd.ply"
    write_ply(path, SplatParams(**arrays))
    code, _, err = evogs("encode", path, tmp_path / "odd.evogs")
    assert code in (0, 1)
    assert all(line.startswith("evogs: ") for line in err.splitlines())
    if code == 0:
        assert evogs("validate", tmp_path / "odd.evogs")[0] == 0


def test_an_output_that_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch, capsys):
    def never(*_, **__):
        raise AssertionError("the work began")

    monkeypatch.setattr("evogs_codec.cli.encode_and_lift.read_scene", never)
    scene = tmp_path / "scene.ply"
    scene.write_bytes(b"ply\n")
    assert main(["encode", str(scene), str(tmp_path / "no folder" / "x.evogs")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
