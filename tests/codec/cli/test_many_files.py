"""`--out-dir`: every input becomes a file of its own, and one that fails stops no other."""

import json

import pytest

from evogs_codec import read_directory, read_scene, write_ply
from evogs_codec.cli import converting
from evogs_codec.render.demo_scene import make_scene


@pytest.fixture
def here(tmp_path):
    """Three scenes, of which `c.ply` is cut short."""
    for name, n in (("a.ply", 20), ("b.ply", 30), ("c.ply", 25)):
        write_ply(tmp_path / name, make_scene(n))
    (tmp_path / "c.ply").write_bytes((tmp_path / "c.ply").read_bytes()[:-1])
    return tmp_path


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_each_input_is_converted_to_a_file_of_its_own(evogs, here):
    out = here / "out"
    code, said, err = evogs("convert", here / "a.ply", here / "b.ply", "--out-dir", out)
    assert (code, err) == (0, "")
    assert said.splitlines() == [
        f"{out}/a.ply: 20 splats, SH degree 3",
        f"{out}/b.ply: 30 splats, SH degree 3",
        f"2 of 2 written to {out}",
    ]
    words = ["--to", "compressed.ply", "--force"]
    assert evogs("convert", out / "a.ply", out / "b.ply", *words, "--out-dir", here / "x")[0] == 0
    more = [here / "x" / "a.compressed.ply", out / "b.ply", "--to", "glb", f"--out-dir={out}"]
    assert evogs("convert", *more)[0] == 0
    assert names(out) == ["a.glb", "a.ply", "b.glb", "b.ply"]
    assert len(read_scene(out / "b.glb").splats) == 30


def test_one_that_fails_stops_no_other_and_the_exit_code_tells(evogs, here):
    files = [here / "c.ply", here / "missing.ply", here / "b.ply"]
    code, said, err = evogs("convert", *files, "--out-dir", here / "out", "--to", "spz")
    assert code == 1
    first, second = err.splitlines()
    assert "c.ply" in first
    assert "cut short" in first
    assert "missing.ply" in second
    assert said.splitlines()[-1] == f"1 of 3 written to {here}/out, 2 failed"
    assert names(here / "out") == ["b.spz"]


def test_a_folder_that_got_nothing_is_not_left_behind(evogs, here):
    assert evogs("convert", here / "c.ply", "--out-dir", here / "out")[0] == 1
    assert not (here / "out").exists()


def test_outputs_of_one_name_or_over_an_input_are_refused_before_anything(refused, here):
    (here / "more").mkdir()
    write_ply(here / "more" / "a.ply", make_scene(5))
    out, before = here / "out", names(here)
    two = [here / "b.ply", here / "a.ply", here / "more" / "a.ply"]
    refused("convert", *two, "--out-dir", out, words=["a.ply is also that of", "nothing is"])
    refused("convert", here / "a.ply", here / "a.ply", "--out-dir", out, words=["also that of"])
    over = [here / "b.ply", here / "more" / "a.ply", here / "a.ply"]
    for words in (["--force"], []):
        refused("convert", *over[1:], "--out-dir", here, *words, words=["nothing is written"])
    refused("convert", "-", "--out-dir", out, words=["no name"])
    refused("encode", here / "a.ply", "--out-dir", out, "--report", here / "r.html", words=["one"])
    refused("convert", here / "a.ply", "--out-dir", here / "no" / "out", words=["No such file"])
    refused("convert", here / "a.ply", "--out-dir", here / "b.ply", words=["is no folder"])
    refused("convert", here / "a.ply", "--out-dir", here / "b.ply", words=["b.ply", "exists"])
    assert names(here) == before


def test_a_file_of_others_is_kept_and_the_rest_is_written(evogs, here):
    out = here / "out"
    out.mkdir()
    (out / "a.ply").write_text("somebody's\n")
    files = [here / "a.ply", here / "b.ply"]
    for _ in range(2):  # what the command made is replaced
        code, said, err = evogs("convert", *files, "--out-dir", out)
        assert (code, err.count("\n")) == (1, 1)
        assert "exists and is no .ply" in err
        assert "1 of 2 written" in said
    assert (out / "a.ply").read_text() == "somebody's\n"
    assert evogs("convert", *files, "--out-dir", out, "--force")[0] == 0
    assert len(read_scene(out / "a.ply").splats) == 20


def test_streams_are_made_of_many_scenes_and_decoded_to_many(evogs, here):
    out = here / "out"
    words = ["--preset", "scene", "--levels", 2, "--effort", 1]
    code, said, err = evogs(
        "encode", here / "a.ply", here / "b.ply", "--out-dir", out, "--json", *words
    )
    assert (code, err) == (0, f"2 of 2 written to {out}\n")
    assert [json.loads(line)["splats"] for line in said.splitlines()] == [20, 30]
    assert read_directory(out / "b.evogs").n_levels == 2
    both = [out / "a.evogs", out / "b.evogs"]
    assert evogs("decode", *both, "--out-dir", out, "--to", "spz", "--level", 0)[0] == 0
    assert names(out) == ["a.evogs", "a.spz", "b.evogs", "b.spz"]


def test_an_interrupt_ends_it(evogs, here, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(converting, "write_scene", interrupt)
    code, out, err = evogs("convert", here / "a.ply", here / "b.ply", "--out-dir", here / "out")
    assert (code, out, err) == (130, "", "evogs: interrupted\n")
    assert not (here / "out").exists()


def test_without_a_folder_two_files_are_an_input_and_an_output(evogs, refused, here):
    assert evogs("convert", here / "a.ply", here / "new.ply")[0] == 0
    refused("convert", here / "a.ply", here / "b.ply", here / "new.ply", code=2)
    refused("convert", here / "a.ply", here / "x.ply", "--to", "spz", words=["--to", "--out-dir"])


def test_a_folder_without_a_name_is_none(evogs, here, monkeypatch):
    monkeypatch.chdir(here)
    before = names(here)
    for words in (["--out-dir", ""], ["--out-dir="]):
        code, _, err = evogs("convert", here / "a.ply", "--to", "spz", *words)
        assert code == 2
        assert "--out-dir: is empty: name a folder, or . for this one" in err
    assert names(here) == before
    assert evogs("convert", here / "a.ply", "--to", "spz", "--out-dir", ".")[0] == 0
    assert (here / "a.spz").exists()
