"""What commands write: never a source, no file of others, and the old file or the new one."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from conformance.decoders.reference import main as decoder
from evogs_codec import (
    InputError,
    SceneInfo,
    encode_scene,
    read_ply,
    read_tree,
    write_ply,
    write_tree,
)
from evogs_codec.io.files import TREE, check_target, write_atomic
from evogs_codec.render import demo_scene as scene_tool
from evogs_codec.render import save_cameras
from evogs_codec.render.camera import orbit
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.png import write_png
from tests.support import damage

SOURCES = {
    "encode": "scene.ply",
    "lift": "scene.ply",
    "decode": "scene.evogs",
    "extract": "scene.evogs",
    "edit": "scene.evogs",
    "render": "scene.evogs",
}
MADE = {
    "encode": "scene.evogs",
    "lift": "tree.tree.npz",
    "decode": "scene.ply",
    "extract": "scene.evogs",
    "edit": "scene.ply",
    "render": "picture.png",
}
OPTIONS = {
    "encode": ["--preset", "scene", "--effort", 1],
    "render": ["--size", 8],
    "edit": ["--translate", 1, 0, 0],
}


@pytest.fixture
def here(made, tmp_path):
    """A folder of its own with a file of each kind."""
    folder = tmp_path / "here"
    folder.mkdir()
    write_ply(folder / "scene.ply", make_scene(40))
    write_tree(folder / "tree.tree.npz", damage.random_tree(5, 2, 0))
    shutil.copy(made / "scene.evogs", folder / "scene.evogs")
    write_png(folder / "picture.png", np.zeros((2, 2, 3)))
    (folder / "notes.txt").write_text("of a week's work\n")
    np.savez(folder / "numbers.npz", a=np.zeros(3))
    return folder


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


# --- an output that is an input ------------------------------------------------------------------


def same(source):
    return source


def respelt(source):
    return source.parent / ".." / source.parent.name / source.name


def linked(source):
    (source.parent / "link").symlink_to(source.name)
    return source.parent / "link"


def hard_linked(source):
    (source.parent / "hard").hardlink_to(source)
    return source.parent / "hard"


@pytest.mark.parametrize("force", [[], ["--force"]], ids=["", "force"])
@pytest.mark.parametrize("way", [same, respelt, linked, hard_linked])
@pytest.mark.parametrize("command", SOURCES)
def test_an_output_that_is_the_input_is_refused_even_with_force(command, way, force, refused, here):
    source = here / SOURCES[command]
    target = way(source)
    before = contents(here)
    refused(command, source, target, *force, *OPTIONS.get(command, []), words=[target, "an input"])
    assert contents(here) == before


def test_the_input_by_a_link_is_still_the_input(refused, here):
    target = here / "scene.evogs"
    before = contents(here)
    refused("decode", linked(target), target, "--force", words=[target, "an input"])
    assert contents(here) == before | {"link": before["scene.evogs"]}


@pytest.mark.parametrize("command", ["encode", "render"])
def test_a_file_of_cameras_is_an_input_too(command, refused, here):
    cameras = here / "cameras.json"
    save_cameras(cameras, orbit(2, radius=20, width=8, height=8, fov_x=0.8))
    before = contents(here)
    refused(
        command, here / "scene.ply", cameras, "--camera", cameras, "--force", words=["an input"]
    )
    assert contents(here) == before


def test_the_decoder_under_test_does_not_replace_its_stream(here, capsys):
    path = here / "scene.evogs"
    before = contents(here)
    assert decoder(["--in", str(path), "--out", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert contents(here) == before
    assert decoder(["--in", str(path), "--out", str(here / "notes.txt")]) == 0


# --- an output that exists -----------------------------------------------------------------------


@pytest.mark.parametrize("command", SOURCES)
def test_a_file_of_another_kind_is_replaced_with_force_alone(command, refused, evogs, here):
    options = OPTIONS.get(command, [])
    # Others take any name; these one without an ending, or with one of what they make.
    if command in ("decode", "edit", "encode", "extract", "render"):
        for path in set(here.iterdir()) - {here / SOURCES[command], here / MADE[command]}:
            path.rename(here / path.name.replace(".", " "))
    others = set(contents(here)) - {SOURCES[command], MADE[command]}
    for name in sorted(others):
        before = contents(here)
        refused(command, here / SOURCES[command], here / name, *options, words=[name, "--force"])
        assert contents(here) == before
    name = min(others)
    assert evogs(command, here / SOURCES[command], here / name, "--force", *options)[0] == 0
    assert (here / name).read_bytes() != before[name]


@pytest.mark.parametrize("command", SOURCES)
def test_what_the_command_made_and_an_empty_file_are_replaced(command, evogs, here):
    (here / "empty").touch()
    target, options = here / "empty", OPTIONS.get(command, [])
    assert evogs(command, here / SOURCES[command], target, *options)[0] == 0
    first = target.read_bytes()
    assert first
    assert evogs(command, here / SOURCES[command], target, *options)[0] == 0
    assert target.read_bytes() == first
    target.unlink()


@pytest.mark.parametrize("command", SOURCES)
def test_a_file_of_the_same_kind_that_others_made_is_replaced_with_force_alone(
    command, refused, evogs, here
):
    source = shutil.copy(here / SOURCES[command], here / "source")
    target, options = here / MADE[command], OPTIONS.get(command, [])
    if command in ("encode", "extract"):
        info = SceneInfo(text={"generator": "another encoder"})
        target.write_bytes(encode_scene(make_scene(5), preset="scene", info=info))
    before = contents(here)
    refused(command, source, target, *options, words=[target, f"by `evogs {command}`", "--force"])
    assert contents(here) == before
    assert evogs(command, source, target, *options, "--force")[0] == 0
    assert target.read_bytes() != before[target.name]
    assert evogs(command, source, target, *options)[0] == 0


def test_a_file_of_one_command_is_not_replaced_by_another(refused, evogs, here):
    scene_tool.main([str(here / "demo.ply"), "--splats", "10"])
    refused("decode", here / "scene.evogs", here / "demo.ply", words=["by `evogs decode`"])
    write_tree(here / "trained.tree.npz", damage.random_tree(5, 2, 0), made_by="evogs train")
    refused("lift", here / "scene.ply", here / "trained.tree.npz", words=["by `evogs lift`"])
    assert len(read_ply(here / "demo.ply")) == 10


def test_metadata_of_a_stream_does_not_pass_for_a_mark(refused, evogs, here):
    write_ply(here / "other.ply", make_scene(3), ["comment: made by evogs decode"])
    refused("decode", here / "scene.evogs", here / "other.ply", words=["by `evogs decode`"])


def test_scenes_from_before_files_named_commands_are_replaced(evogs, here):
    write_ply(here / "old.ply", make_scene(3), ["title: x", "generator: evogs 0.1.0"])
    assert evogs("decode", here / "scene.evogs", here / "old.ply")[0] == 0
    write_ply(here / "old.ply", make_scene(3), ["procedural scene of evogs"])
    scene_tool.main([str(here / "old.ply"), "--splats", "10"])
    assert len(read_ply(here / "old.ply")) == 10


def test_a_part_of_a_stream_names_the_encoder_too(evogs, here):
    for _ in range(2):
        part = here / "part.evogs"
        assert evogs("extract", here / "scene.evogs", part, "--level", 1)[0] == 0
    assert evogs("encode", here / "scene.ply", part, "--preset", "scene")[0] == 0


@pytest.mark.parametrize("command", SOURCES)
@pytest.mark.parametrize("keep", [9, 40])
def test_a_damaged_file_is_nobodys(command, keep, refused, evogs, here):
    target, options = here / "out", OPTIONS.get(command, [])
    assert evogs(command, here / SOURCES[command], target, *options)[0] == 0
    target.write_bytes(target.read_bytes()[:keep])
    refused(command, here / SOURCES[command], target, *options, words=["--force"])
    assert target.stat().st_size == keep


def test_readers_take_marked_files(evogs, here):
    assert evogs("lift", here / "scene.ply", here / "out.tree.npz", "--levels", 2)[0] == 0
    assert read_tree(here / "out.tree.npz").n_leaves == 40
    assert evogs("render", here / "scene.ply", here / "out.png", "--size", 8)[0] == 0
    with Image.open(here / "out.png") as picture:
        assert picture.size == (8, 8)
        assert picture.info == {"Software": "evogs render"}


def test_a_kind_is_seen_in_the_bytes_and_not_in_the_name(refused, evogs, here):
    (here / "scene.ply").rename(here / "named")
    assert evogs("decode", here / "scene.evogs", here / "named", "--force")[0] == 0
    refused("extract", here / "scene.evogs", here / "named", words=["no EvoGS stream"])
    assert evogs("decode", here / "scene.evogs", here / "named")[0] == 0
    assert len(read_ply(here / "named")) == 3000


def test_the_scene_that_ships_replaces_no_other_file(here, capsys):
    before = contents(here)
    with pytest.raises(SystemExit) as refused:
        scene_tool.main([str(here / "notes.txt"), "--splats", "10"])
    assert refused.value.code == 1
    assert "--force" in capsys.readouterr().err
    assert contents(here) == before
    scene_tool.main([str(here / "notes.txt"), "--splats", "10", "--force"])
    scene_tool.main([str(here / "notes.txt"), "--splats", "11"])
    assert len(read_ply(here / "notes.txt")) == 11


def test_cameras_that_somebody_moved_are_not_replaced(here, capsys):
    words = [str(here / "demo.ply"), "--splats", "10", "--cameras", str(here / "cameras.json")]
    scene_tool.main(words)
    scene_tool.main(words)
    save_cameras(here / "cameras.json", orbit(2, radius=20, width=8, height=8, fov_x=0.8))
    before = contents(here)
    with pytest.raises(SystemExit):
        scene_tool.main(words)
    assert "cameras.json: exists and was not made by" in capsys.readouterr().err
    assert contents(here) == before


def test_a_tree_is_a_zip_with_the_keys_of_one(here):
    write_tree(here / "made.tree.npz", damage.random_tree(5, 2, 0), made_by="evogs lift")
    check_target(here / "made.tree.npz", TREE, command="evogs lift")
    for name in ("numbers.npz", "notes.txt"):
        with pytest.raises(InputError, match=r"exists and is no \.tree\.npz"):
            check_target(here / name, TREE, command="evogs lift")
    (here / "cut.npz").write_bytes((here / "tree.tree.npz").read_bytes()[:-30])
    with pytest.raises(InputError, match=r"exists and is no \.tree\.npz"):
        check_target(here / "cut.npz", TREE, command="evogs lift")


# --- links and devices ---------------------------------------------------------------------------


@pytest.mark.parametrize("command", SOURCES)
def test_a_link_to_itself_as_output_is_refused_in_one_line(command, refused, here):
    target = here / "loop"
    target.symlink_to("loop")
    refused(command, here / SOURCES[command], target, words=[target, "symbolic links"])
    assert target.is_symlink()
    with pytest.raises(OSError, match="symbolic links") as loop:
        write_atomic(target, b"")
    assert loop.value.filename == str(target)


def test_a_link_to_itself_as_input_is_refused_in_one_line(refused, here):
    loop = here / "loop"
    loop.symlink_to("loop")
    for command in SOURCES:
        refused(command, loop, here / "out", words=[loop])
    refused("info", loop, words=[loop])
    refused("encode", here / "scene.ply", here / "out", "--camera", loop, words=[loop])


def test_a_link_whose_file_is_missing_makes_that_file(evogs, here):
    (here / "link").symlink_to("new.ply")
    assert evogs("decode", here / "scene.evogs", here / "link")[0] == 0
    assert (here / "link").is_symlink()
    assert len(read_ply(here / "new.ply")) == 3000


def test_a_device_is_written_to_and_never_read(evogs, made):
    assert evogs("decode", made / "scene.evogs", os.devnull)[0] == 0
    assert Path(os.devnull).is_char_device()


# --- what a power failure leaves -----------------------------------------------------------------


def test_a_file_is_synced_before_its_name_changes_and_the_folder_after(tmp_path, monkeypatch):
    done = []
    sync, replace = os.fsync, Path.replace

    def recorded_sync(descriptor):
        is_folder = os.path.samestat(os.fstat(descriptor), tmp_path.stat())
        done.append("folder" if is_folder else os.fstat(descriptor).st_size)
        sync(descriptor)

    def recorded_replace(self, target):
        done.append("renamed")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", recorded_sync)
    monkeypatch.setattr(Path, "replace", recorded_replace)
    write_atomic(tmp_path / "out", b"12345")
    assert done == [5, "renamed", "folder"]


def test_a_folder_that_cannot_be_synced_is_no_error(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "open", refuse)
    write_atomic(tmp_path / "out", b"12345")
    assert (tmp_path / "out").read_bytes() == b"12345"
