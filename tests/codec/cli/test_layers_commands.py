"""Layers of precision on the command line."""

import json

import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from numpy.testing import assert_array_equal

from evogs_codec import (
    Cut,
    decode,
    encode_scene,
    read_directory,
    read_ply,
    write_ply,
    write_tree,
)
from evogs_codec.render import load_cameras, save_cameras
from evogs_codec.render.demo_scene import make_scene
from tests.support.layered import (
    views_of,
)
from tests.support.quanta import in_quanta


@pytest.mark.thorough
def test_the_command_makes_shows_and_decodes_layers(evogs, tmp_path):
    scene_file, cameras, out = (tmp_path / name for name in ("in.ply", "views.json", "out.evogs"))
    write_ply(scene_file, make_scene(300))
    save_cameras(cameras, views_of(make_scene(300)).cameras)
    options = [
        "--levels",
        "2",
        "--target-bytes",
        "9000",
        "--layers",
        "3",
        "--effort",
        "1",
        "--view",
        "none",
        "--json",
    ]
    code, said, errors = evogs("encode", scene_file, out, "--camera", cameras, *options)
    assert (code, errors) == (0, "")
    assert [level["n_leaves"] for level in json.loads(said)["levels"]][1:] == [300] * 3
    data = out.read_bytes()
    seen = load_cameras(cameras)
    assert data == encode_scene(
        read_ply(scene_file), levels=2, target_bytes=9000, layers=3, effort=1, cameras=seen
    )
    code, said, _ = evogs("info", out, "--json")
    assert (code, len(json.loads(said)["levels"])) == (0, 4)
    for level in (1, 2, 3):
        cut = Cut.of_level(read_directory(data), level)
        wanted = decode(data, cut).leaves()
        part, ply = tmp_path / "part.evogs", tmp_path / "part.ply"
        assert evogs("extract", out, part, "--level", level)[0] == 0
        assert_array_equal(decode(part.read_bytes()).leaves().channels(), wanted.channels())
        assert evogs("decode", out, ply, "--level", level)[0] == 0
        assert len(read_ply(ply)) == 300
        part.unlink()
        ply.unlink()


@pytest.mark.thorough
def test_the_command_makes_layers_of_a_tree(evogs, tmp_path):
    write_tree(tmp_path / "in.tree.npz", in_quanta())
    save_cameras(tmp_path / "views.json", views_of(in_quanta().leaves()).cameras)
    options = ["--target-psnr", "45", "--layers", "2", "--camera", tmp_path / "views.json"]
    assert evogs("encode", tmp_path / "in.tree.npz", tmp_path / "out.evogs", *options)[0] == 0
    assert read_directory(tmp_path / "out.evogs").n_levels == 4


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--layers", "2", "--preset", "scene"], 1, "--layers: views decide"),
        (["--layers", "2", "--max-error", "0.1"], 1, "--layers: views decide"),
        (["--layers", "0", "--target-psnr", "40"], 2, "argument --layers"),
        (["--layers", "9", "--target-psnr", "40"], 2, "argument --layers"),
        (["--layers", "two", "--target-psnr", "40"], 2, "argument --layers"),
        pytest.param(
            *(["--layers", "2", "--target-psnr", "40", "--levels", "64"], 1, "at most 64"),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_the_command_refuses_layers_that_cannot_be(refused, tmp_path, options, code, words):
    write_ply(tmp_path / "in.ply", make_scene(60))
    out = tmp_path / "out.evogs"
    refused("encode", tmp_path / "in.ply", out, *options, words=[words], code=code)
    assert not out.exists()
