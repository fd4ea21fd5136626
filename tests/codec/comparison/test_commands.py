"""`evogs compare` and `evogs encode --report`."""

import json
import re
import shutil

import numpy as np
import pytest

pytest.importorskip("numba", reason="the package renders")
from evogs_codec import decode, read_directory, read_ply, write_ply
from evogs_codec.comparison.likeness import difference
from evogs_codec.editing.byte_stats import levels
from evogs_codec.render import orbit, save_cameras
from evogs_codec.render.demo_scene import make_scene
from tests.codec.comparison.test_page import parsed
from tests.support.range_server import serving

SIZE = ("--size", 40)


@pytest.fixture
def cameras(tmp_path):
    path = tmp_path / "cameras.json"
    save_cameras(path, orbit(3, (0, 0, 1), radius=20, width=30, height=20, fov_x=0.8))
    return path


def compared(evogs, *arguments):
    code, out, err = evogs("compare", *arguments, "--json")
    assert code == 0
    assert all("infinite opacity" in line for line in err.splitlines())
    return json.loads(out)


def test_files_of_several_formats_are_compared_with_the_first(evogs, made, tmp_path):
    for ending in ("spz", "glb", "compressed.ply", "splat"):
        assert evogs("convert", made / "scene.ply", tmp_path / f"x.{ending}")[0] == 0
    names = ["x.spz", "x.glb", "x.compressed.ply", "x.splat"]
    files = [made / "scene.ply", made / "scene.evogs", *(tmp_path / name for name in names)]
    found = compared(evogs, *files, *SIZE)
    assert found["reference"]["file"] == "scene.ply"
    assert [row["file"] for row in found["compared"]] == ["scene.evogs", *names]
    assert [row["bytes"] for row in found["compared"]] == [f.stat().st_size for f in files[1:]]
    assert [row["format"] for row in found["compared"]] == [
        "evogs", "spz", "gltf", "compressed.ply", "splat",
    ]  # fmt: skip
    for row in found["compared"]:
        assert len(row["views"]) == 24
        assert row["psnr"] > 20
        assert 0.5 < row["ssim"] <= 1
    orders = {row["file"]: row["errors"]["matching"] for row in found["compared"]}
    assert (orders["x.glb"], orders["scene.evogs"]) == ("same count and order", "nearest match")
    errors = {one["group"]: one for one in found["compared"][2]["errors"]["groups"]}
    assert errors["position"]["largest"] < 1e-3


def test_the_psnr_is_that_of_the_command_psnr(evogs, made, cameras):
    options = ["--camera", cameras, *SIZE, "--background", "black"]
    found = compared(evogs, made / "scene.ply", made / "scene.evogs", *options)
    _, out, _ = evogs("psnr", made / "scene.evogs", made / "scene.ply", *options)
    assert out.startswith(f"{found['compared'][0]['psnr']:.2f} dB")
    assert "cameras.json" in found["views"]


def test_a_cut_and_a_part_of_a_stream_are_compared_with_all_of_it(evogs, made, tmp_path):
    stream = made / "scene.evogs"
    found = compared(evogs, stream, stream, "--level", 1, *SIZE)["compared"][0]
    assert found["file"] == "scene.evogs, level 1"
    assert found["splats"] == levels(read_directory(stream.read_bytes()))[1].n_leaves
    assert found["bytes"] < stream.stat().st_size
    part = tmp_path / "part.evogs"
    part.write_bytes(stream.read_bytes()[:30_000])
    found = compared(evogs, stream, part, "--partial", *SIZE)["compared"][0]
    assert "from 30,000 of" in found["file"]
    assert 0 < found["splats"] < 3000
    code, out, err = evogs("compare", stream, part, *SIZE)
    assert (code, out) == (1, "")
    assert "--partial takes what is there" in err


def test_a_file_of_the_web_is_compared_too(evogs, made):
    pytest.importorskip("obstore", reason="it fetches files by URL")
    with serving({"scene.evogs": (made / "scene.evogs").read_bytes()}) as site:
        url = f"{site.url}scene.evogs"
        code, out, err = evogs("compare", made / "scene.ply", url, *SIZE, "--json")
    assert (code, ": fetched " in err) == (0, True)
    row = json.loads(out)["compared"][0]
    assert (row["format"], row["bytes"]) == ("evogs", (made / "scene.evogs").stat().st_size)


def test_equal_files_are_said_to_be_equal(evogs, made, tmp_path):
    shutil.copy(made / "scene.ply", tmp_path / "copy.ply")
    files = (made / "scene.ply", tmp_path / "copy.ply")
    row = compared(evogs, *files, *SIZE)["compared"][0]
    assert (row["psnr"], row["ssim"]) == (None, pytest.approx(1))
    code, out, _ = evogs("compare", *files, *SIZE)
    assert code == 0
    assert re.search(r"copy\.ply .* equal +equal +1\.0000", out)


def test_a_file_named_twice_is_refused(refused, made):
    refused("compare", made / "scene.ply", made / "scene.ply", *SIZE, words=["named twice"])


def test_the_page_has_a_picture_and_a_difference_of_each_file(evogs, made, tmp_path):
    evil = tmp_path / "<img src=x onerror=alert(1)>&.ply"
    write_ply(evil, make_scene(3000))
    page = tmp_path / "x.html"
    words = ["compare", made / "scene.ply", made / "scene.evogs", evil, "--html", page, *SIZE]
    code, out, err = evogs(*words, "--shown", 2)
    assert (code, err) == (0, "")
    assert f"{page.stat().st_size:,} bytes" in out
    text = page.read_text()
    found = parsed(page.read_bytes())
    assert text.count("<img ") == 2 * 5
    assert evil.name in found.text
    assert "<img src=x" not in text
    before = page.read_bytes()
    assert evogs(*words, "--shown", 2)[0] == 0  # it made the page, so it may replace it
    assert page.read_bytes() == before


def test_a_page_replaces_nothing_of_others(refused, evogs, made, tmp_path):
    other = tmp_path / "other.html"
    other.write_text("<!doctype html>\n<p>a page of somebody</p>")
    files = [made / "scene.ply", made / "scene.evogs"]
    refused("compare", *files, "--html", other, *SIZE, words=["was not made by `evogs compare`"])
    refused("compare", *files, "--html", files[1], *SIZE, words=["an input"])
    refused("compare", *files, "--html", tmp_path / "no" / "x.html", words=["folder"])
    assert evogs("compare", *files, "--html", other, "--force", *SIZE)[0] == 0
    assert b"evogs compare" in other.read_bytes()
    words = ["encode", made / "scene.ply", tmp_path / "a.evogs", "--report"]
    refused(*words, other, words=["was not made by `evogs encode`"])
    refused(*words, tmp_path / "a.evogs", words=["two names"])
    refused(*words, made / "scene.ply", words=["an input"])
    assert not (tmp_path / "a.evogs").exists()


def test_a_difference_is_white_where_pictures_are_equal():
    one = np.full((2, 2, 3), 0.5, np.float32)
    other = one.copy()
    other[0, 0, 1] += 0.05
    shown = difference(other, one)
    assert shown[0, 0, 1] == pytest.approx(0.6)
    shown[0, 0, 1] = 1
    assert (shown == 1).all()


def test_a_report_says_what_each_level_costs(evogs, made, tmp_path):
    stream, page = tmp_path / "a.evogs", tmp_path / "a.html"
    words = ["encode", made / "scene.ply", stream, "--preset", "scene", "--levels", 3]
    code, _, err = evogs(*words, "--report", page)
    assert (code, err) == (0, "")
    directory = read_directory(stream.read_bytes())
    found = parsed(page.read_bytes())
    for level in levels(directory):
        assert f"{level.n_leaves:,}" in found.text
        assert f"{level.n_bytes:,}" in found.text
    assert page.read_text().count("<img ") == directory.n_levels + 2
    for words_ in ("position", "SH band 1", "3,000 splats of scene.ply", "up is z"):
        assert words_ in found.text
    assert evogs(*words, "--report", page)[0] == 0


@pytest.mark.thorough
def test_a_report_says_what_was_left_out(evogs, tmp_path):
    channels = make_scene(400).channels()
    channels[0, :3] = np.nan
    scene = type(make_scene(1)).from_channels(channels)
    write_ply(tmp_path / "x.ply", scene)
    words = ["encode", tmp_path / "x.ply", tmp_path / "x.evogs", "--preset", "scene"]
    code, _, err = evogs(*words, "--drop-invalid", "--report", tmp_path / "x.html")
    assert code == 0
    assert "3 splats" in err
    assert "3 splats with NaN or infinite numbers left out" in (tmp_path / "x.html").read_text()
    assert len(decode((tmp_path / "x.evogs").read_bytes()).leaves()) == 397
    assert len(read_ply(tmp_path / "x.ply")) == 400


@pytest.mark.thorough
def test_a_report_of_a_tree_and_by_cameras_is_written_too(evogs, made, cameras, tmp_path):
    words = ["encode", made / "x.tree.npz", tmp_path / "x.evogs", "--preset", "trained"]
    code, _, _ = evogs(*words, "--camera", cameras, "--report", tmp_path / "x.html")
    assert code == 0
    assert "3 views of cameras.json" in (tmp_path / "x.html").read_text()
