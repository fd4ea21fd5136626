"""White splats are looked at on black: on white, nothing would say how exact they have to be."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec import Cut, decode_leaves, encode_scene, level_psnr, read_directory, write_ply
from evogs_codec.cli.commands import main
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.framing import BLACK, WHITE, background_for

WHITE_DC = 0.5 / 0.28209479177387814


def of_colour(value, n=400):
    """Splats of one colour: 0 is black, 1 is white."""
    splats = make_scene(n, 7)
    sh = np.full((n, 1, 3), (value - 0.5) / 0.5 * WHITE_DC, np.float32)
    return replace(splats, sh=sh)


def with_red(n):
    """White splats, the first so many of which are red."""
    sh = of_colour(1.0).sh.copy()
    sh[:n, 0, 1:] = -WHITE_DC
    return replace(of_colour(1.0), sh=sh)


def test_only_white_splats_are_looked_at_on_black():
    assert background_for(of_colour(1.0)) == BLACK
    assert background_for(of_colour(0.99)) == BLACK
    assert background_for(of_colour(1.5)) == WHITE  # brighter than white: it shows
    assert background_for(of_colour(0.9)) == WHITE
    assert background_for(of_colour(0.0)) == WHITE
    assert background_for(of_colour(1.0).take(slice(0))) == WHITE
    assert background_for(with_red(4)) == BLACK
    assert background_for(with_red(5)) == WHITE


def test_white_splats_are_encoded_as_exactly_as_others():
    splats = of_colour(1.0)
    leaves = decode_leaves(encode_scene(splats, levels=3))
    views = Views(splats, cameras_around(splats, "z", 100, n=6), background=BLACK)
    assert views.psnr(leaves) > 45


def test_the_psnr_of_their_levels_rises_and_says_that_it_is_on_black():
    splats = of_colour(1.0)
    data = encode_scene(splats, levels=3)
    directory = read_directory(data)
    known = level_psnr(directory)
    assert known is not None
    assert known.views == "4 views on a circle on black, 200 pixels"
    views = Views(splats, cameras_around(splats, "z", 200, n=6), background=BLACK)
    cuts = [Cut.of_level(directory, level) for level in range(directory.n_levels)]
    seen = [views.psnr(decode_leaves(data, cut)) for cut in cuts]
    assert seen == sorted(seen)
    assert seen[0] < 40 < seen[-1]


def test_a_picture_of_white_splats_is_not_empty(tmp_path, capsys):
    write_ply(tmp_path / "white.ply", of_colour(1.0))
    write_ply(tmp_path / "other.ply", of_colour(1.0, 200))
    paths = [str(tmp_path / name) for name in ("other.ply", "white.ply")]
    assert main(["psnr", *paths, "--size", "64"]) == 0
    said = capsys.readouterr().out
    assert "on black" in said
    on_black = float(said.split(" dB")[0])
    assert main(["psnr", *paths, "--size", "64", "--background", "white"]) == 0
    said = capsys.readouterr().out
    assert "black" not in said
    on_white = float(said.split(" dB")[0])
    assert on_black < 40 < on_white
