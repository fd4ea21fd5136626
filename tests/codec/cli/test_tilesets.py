"""`evogs tileset`, and tilesets that other commands read."""

import json

import numpy as np
import pytest

from evogs_codec import InputError, read_ply, write_ply
from evogs_codec.cli import tilesets
from evogs_codec.render.demo_scene import make_scene
from tests.support.range_server import serving
from tests.support.tilesets import FAR, small_tileset


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small") / "city"
    small_tileset(folder)
    return folder


@pytest.mark.thorough
def test_a_scene_is_made_a_tileset_looked_at_validated_and_decoded(evogs, tmp_path):
    write_ply(tmp_path / "scene.ply", make_scene(300))
    made = tmp_path / "city"
    options = ["--per-file", 150, "--overview", 80, "--levels", 2, "--engine", "serial"]
    more = ["--effort", 1, "--title", "A city", "--up", "-y", "--json"]
    code, out, err = evogs("tileset", tmp_path / "scene.ply", made, *options, *more)
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert (found["splats"], found["files"]) == (300, 3)
    assert found["bytes"] == sum(p.stat().st_size for p in made.rglob("*") if p.is_file())
    assert evogs("validate", made)[0] == 0
    assert evogs("decode", made, tmp_path / "all.ply")[0] == 0
    assert len(read_ply(tmp_path / "all.ply")) == 300
    code, out, _ = evogs("info", made / "tiles" / "root.evogs")
    assert "A city" in out
    code, _, err = evogs("tileset", tmp_path / "scene.ply", made, *options)
    assert code == 1
    assert "has files: name another folder" in err


def test_the_options_reach_the_tileset(evogs, tmp_path, monkeypatch):
    asked = []

    def begin(*given, **named):
        asked.append((given, named))
        raise InputError("enough")

    write_ply(tmp_path / "scene.ply", make_scene(10))
    monkeypatch.setattr(tilesets, "write_tileset", begin)
    matrix = [0, -1, 0, 4, 1, 0, 0, 5, 0, 0, 1, 6, 0, 0, 0, 1]
    options = ["--crs", "EPSG:4978", "--transform", *matrix, "--workers", 3, "--resume"]
    evogs("tileset", tmp_path / "scene.ply", tmp_path / "city", *options)
    (files, folder, found), others = asked[0]
    assert files == [tmp_path / "scene.ply"]
    assert folder == tmp_path / "city"
    assert (found.crs, found.transform) == ("EPSG:4978", tuple(matrix))
    assert others["resume"]
    assert others["engine"].workers == 3


def test_effort_is_that_of_encode_and_the_default_without_it(evogs, tmp_path, monkeypatch):
    asked = []

    def begin(files, folder, options, **_):
        asked.append(options.job.effort)
        raise InputError("enough")

    write_ply(tmp_path / "scene.ply", make_scene(10))
    monkeypatch.setattr(tilesets, "write_tileset", begin)
    for options in ([], ["--fast"], ["--effort", "best"], ["--effort", 7]):
        evogs("tileset", tmp_path / "scene.ply", tmp_path / "city", *options)
    assert asked == ["default", "fast", "best", 7]


def test_a_transform_that_is_none_is_refused(refused, tmp_path):
    write_ply(tmp_path / "scene.ply", make_scene(10))
    for matrix in ([0] * 16, list(range(16))):
        options = ["--transform", *matrix]
        refused("tileset", tmp_path / "scene.ply", tmp_path / "city", *options, words=["transform"])
    assert [path.name for path in tmp_path.iterdir()] == ["scene.ply"]


def test_a_run_whose_input_was_fetched_is_not_resumed(refused, tmp_path):
    words = ["tileset", "https://example.org/scene.ply", tmp_path / "city", "--resume"]
    refused(*words, words=["--resume: needs inputs on the disk"])


def test_commands_that_read_scenes_say_what_to_do_with_a_tileset(refused, small, tmp_path):
    for command, out in (("convert", "x.ply"), ("encode", "x.evogs"), ("edit", "x.spz")):
        words = ["is a tileset: `evogs decode"]
        refused(command, small / "tileset.json", tmp_path / out, words=words)
        refused(command, small, tmp_path / out, words=words)


def test_commands_that_read_streams_say_what_to_do_with_a_tileset(refused, small, tmp_path):
    for given in (small, small / "tileset.json"):
        words = ["is a tileset, not a stream", f"`evogs decode {given} OUT.ply --box", "tiles"]
        refused("extract", given, tmp_path / "x.evogs", words=words)
        refused("render", given, tmp_path / "x.png", "--sheet", words=words[:1])
    refused("export-html", small, tmp_path / "x.html", words=["is a tileset", "--max-splats"])


def test_info_shows_the_tree(evogs, small):
    code, out, _ = evogs("info", small / "tileset.json")
    assert code == 0
    assert [line.split()[-1] for line in out.splitlines()[-5:]] == [
        f"tiles/{name}.evogs" for name in ("root", "0", "1", "1-0", "1-1")
    ]
    code, out, _ = evogs("info", small, "--json")
    found = json.loads(out)
    assert (found["files"], len(found["tiles"])) == (5, 5)
    assert found["origin"] == FAR.tolist()


def test_a_tileset_is_validated(evogs, refused, small, tmp_path):
    code, out, _ = evogs("validate", small / "tileset.json")
    assert code == 0
    assert "valid, 120 splats in 5 files" in out
    code, out, _ = evogs("validate", small, "--json")
    assert json.loads(out)["valid"] is True
    bad = tmp_path / "bad"
    small_tileset(bad)
    (bad / "tiles" / "0.evogs").unlink()
    refused("validate", bad, words=["tiles/0.evogs", "is not there"])
    code, out, _ = evogs("validate", bad, "--json")
    assert code == 1
    assert len(json.loads(out)["problems"]) == 1


def test_a_part_of_a_tileset_is_decoded(evogs, refused, small, tmp_path):
    out = tmp_path / "part.ply"
    code, said, _ = evogs("decode", small / "tileset.json", out, "--max-splats", 50)
    assert code == 0
    assert "40 splats, SH degree 3, from " in said
    assert "positions are from 500000 5400000 250" in said
    corner = FAR + np.array([7, 7, -1])
    code, said, _ = evogs("decode", small, out, "--box", *corner, *(corner + 2), "--sh-degree", 0)
    assert code == 0
    assert "bytes of 1 files" in said
    assert read_ply(out).sh_degree == 0
    refused("decode", small, out, "--level", 1, words=["--level is for one stream"])
    refused("decode", small / "tiles" / "0.evogs", out, "--max-splats", 9, words=["for a tileset"])


def test_of_a_tileset_of_the_web_only_what_is_needed_is_fetched(evogs, small, tmp_path):
    pytest.importorskip("obstore")
    files = {
        str(path.relative_to(small)): path.read_bytes()
        for path in small.rglob("*")
        if path.is_file()
    }
    with serving(files) as site:
        address = f"{site.url}tileset.json?sig=secret"
        code, out, err = evogs("decode", address, tmp_path / "a.ply", "--max-splats", 50)
        assert code == 0
        assert "40 splats" in out
        assert "secret" not in out + err
        one = len(files["tileset.json"]) + len(files["tiles/root.evogs"])
        assert site.n_sent <= one
        assert f"fetched {site.n_sent:,} bytes" in err
        assert evogs("validate", address)[0] == 0
        assert "tiles/1-1.evogs" in evogs("info", address)[1]
        del site.files["tiles/1-0.evogs"]
        code, _, err = evogs("decode", address, tmp_path / "b.ply")
        assert code == 1
        assert "tiles/1-0.evogs: is not there" in err


def test_a_json_file_that_is_no_tileset_is_refused_in_one_line(refused, tmp_path):
    (tmp_path / "a.json").write_text('{"frames": []}')
    for command, *more in (["info"], ["validate"], ["decode", tmp_path / "a.ply"]):
        refused(command, tmp_path / "a.json", *more, words=["is no tileset: it has no asset"])
    (tmp_path / "b.json").write_text("{")
    refused("info", tmp_path / "b.json", words=["is not JSON"])
    refused("info", tmp_path / "none.json", words=["is not there"])


def test_a_tileset_is_not_decoded_over_its_own_files(refused, small, tmp_path):
    tile = next(small.rglob("*.evogs"))
    before = tile.read_bytes()
    (tmp_path / "link.ply").symlink_to(tile)
    for root in (small, small / "tileset.json"):
        said = refused("decode", root, tmp_path / "link.ply", "--force")
        assert "is in the folder of the tileset" in said
    assert tile.read_bytes() == before
