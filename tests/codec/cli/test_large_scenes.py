"""`evogs encode` of scenes that are larger than memory, or of several files as one."""

import json

import pytest

from evogs_codec import InputError, decode, write_ply
from evogs_codec.cli import large_scenes
from evogs_codec.jobs import encode as jobs
from evogs_codec.render import orbit, save_cameras
from evogs_codec.render.demo_scene import make_scene

pytest.importorskip("numba")


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """A folder with two parts of a scene."""
    folder = tmp_path_factory.mktemp("parts")
    scene = make_scene(500)
    write_ply(folder / "north.ply", scene.take(slice(0, 250)))
    write_ply(folder / "south.ply", scene.take(slice(250, 500)))
    return folder


@pytest.mark.thorough
def test_several_files_or_a_folder_of_them_become_one_stream(evogs, parts, tmp_path):
    whole = [parts / "north.ply", parts / "south.ply"]
    options = ["--engine", "serial", "--levels", 3, "--json", "--title", "Two parts"]
    code, out, err = evogs("encode", *whole, tmp_path / "a.evogs", *options)
    assert (code, err) == (0, "")
    assert json.loads(out)["splats"] == 500
    code, _, err = evogs("encode", parts, tmp_path / "b.evogs", *options)
    assert (code, err) == (0, "")
    data = (tmp_path / "a.evogs").read_bytes()
    assert data == (tmp_path / "b.evogs").read_bytes()
    info = decode(data, verify=True).directory.info
    assert info.text["title"] == "Two parts"
    assert info.text["generator"].startswith("evogs ")


def test_a_scene_of_many_splats_is_encoded_tile_by_tile(evogs, parts, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(large_scenes, "LARGE", 200)
    monkeypatch.setattr(large_scenes, "encode_files", lambda *a, **k: asked.append((a, k)))
    evogs("encode", parts / "north.ply", tmp_path / "a.evogs")
    assert [str(path) for path in asked[0][0][0]] == [str(parts / "north.ply")]
    asked.clear()
    code, _, _ = evogs("encode", parts / "north.ply", tmp_path / "b.evogs", "--preset", "scene")
    assert code == 0
    assert not asked, "a preset has the whole scene in memory"


def test_what_is_up_in_a_large_scene_is_what_is_asked_for_or_the_file_says(
    evogs, parts, tmp_path, monkeypatch
):
    write_ply(tmp_path / "x.ply", make_scene(300), ["Vertical Axis: x"])
    save_cameras(tmp_path / "c.json", orbit(4, radius=3, up=(0, -1, 0), width=8, height=8, fov_x=1))
    asked = []

    def parts_of(run):
        asked.append(run.up.vector)
        raise InputError("enough")

    monkeypatch.setattr(jobs._Run, "parts", parts_of)
    for path, options, up in (
        (tmp_path / "x.ply", [], (1, 0, 0)),
        (tmp_path / "x.ply", ["--up", "-y"], (0, -1, 0)),
        (parts / "north.ply", [], (0, 0, 1)),
        (parts / "north.ply", ["--up", tmp_path / "c.json"], (0, -1, 0)),
    ):
        evogs("encode", path, tmp_path / "a.evogs", "--engine", "serial", *options)
        assert asked.pop() == pytest.approx(up)


@pytest.mark.parametrize(
    "option",
    [["--preset", "scene"], ["--target-psnr", 40], ["--polish"], ["--report", "report.html"]],
)
def test_what_needs_the_whole_scene_is_refused_with_several_files(evogs, parts, tmp_path, option):
    both = [parts / "north.ply", parts / "south.ply"]
    code, _, err = evogs("encode", *both, tmp_path / "a.evogs", *option)
    assert code == 1
    assert "needs" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scheduler", "tcp://x:1", "--engine", "serial"], "--scheduler is for --engine dask"),
        (["--resume", "--scratch", "{tests}"], "is not empty and not a scratch folder of evogs"),
    ],
)
def test_options_of_jobs_that_make_no_sense_are_one_line(evogs, parts, tmp_path, options, said):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "x").touch()
    words = [str(word).replace("{tests}", str(tmp_path / "mine")) for word in options]
    code, _, err = evogs("encode", parts / "north.ply", tmp_path / "a.evogs", *words)
    assert code == 1
    assert said in err
    assert not (tmp_path / "a.evogs").exists()


def test_a_folder_without_a_scene_is_named(evogs, tmp_path):
    (tmp_path / "empty").mkdir()
    code, _, err = evogs("encode", tmp_path / "empty", tmp_path / "a.evogs")
    assert code == 1
    assert "no scene is in this folder" in err


def test_the_other_inputs_are_not_written_over(evogs, parts):
    before = (parts / "south.ply").read_bytes()
    files = [parts / "north.ply", parts / "south.ply"]
    code, _, err = evogs("encode", *files, parts / "south.ply", "--force")
    assert code == 1
    assert "input" in err
    assert (parts / "south.ply").read_bytes() == before


def test_a_disk_that_is_full_is_one_line_and_leaves_no_stream(evogs, parts, tmp_path, monkeypatch):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("evogs_codec.jobs.scratch.partition", full)
    code, _, err = evogs("encode", parts / "north.ply", tmp_path / "a.evogs", "--workers", 1)
    assert code == 1
    assert "No space left on device" in err
    assert not (tmp_path / "a.evogs").exists()


def test_files_of_a_folder_that_are_no_scenes_by_their_bytes_are_named(evogs, parts, tmp_path):
    folder = tmp_path / "scans"
    folder.mkdir()
    (folder / "a.ply").write_bytes((parts / "north.ply").read_bytes())
    (folder / "b.ply").write_bytes(bytes(1000))
    (folder / "c.spz").write_bytes(b"")
    (folder / "d.ply").symlink_to("nowhere.ply")
    (folder / "notes.txt").write_text("none of them")
    with pytest.warns(UserWarning, match=r"3 files named as scenes are none.*first b\.ply"):
        assert large_scenes.files_of([folder]) == [folder / "a.ply"]


def test_the_output_is_none_of_the_files_of_a_folder(refused, parts, tmp_path):
    out = tmp_path / "out.evogs"
    out.symlink_to(parts / "north.ply")
    said = refused("encode", parts, out, "--engine", "serial", "--force")
    assert "is one of the inputs" in said
