"""`evogs render` and `evogs psnr`."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import PRESETS, encode, lift, write_ply
from evogs_codec.cli.commands import main
from evogs_codec.render import save_cameras
from evogs_codec.render.demo_scene import demo_cameras, make_scene
from evogs_codec.render.labels import GLYPH_HEIGHT
from evogs_codec.render.png import MARGIN

pytest.importorskip("numba", reason="the rasterizer is compiled")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    splats = make_scene(3000)
    write_ply(folder / "s.ply", splats)
    (folder / "s.evogs").write_bytes(encode(lift(splats, 3), PRESETS["scene"], n_tiles=4))
    return folder


def size_of_png(path):
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def decibels(capsys):
    return float(capsys.readouterr().out.split(" dB")[0])


def test_a_view_is_a_png_of_the_size_asked_for(files):
    for name in ("s.ply", "s.evogs"):
        out = files / "view.png"
        assert main(["render", str(files / name), str(out), "--size", "64", "--view", "5"]) == 0
        assert size_of_png(out) == (64, 64)


def test_a_contact_sheet_shows_every_level_in_three_views(files):
    out = files / "sheet.png"
    assert main(["render", str(files / "s.evogs"), str(out), "--size", "40", "--sheet"]) == 0
    label = GLYPH_HEIGHT + 2 * MARGIN
    assert size_of_png(out) == (3 * 44 - 4, 3 * (label + 44) - 4)


@pytest.mark.thorough
def test_a_reference_is_the_last_row_of_a_sheet(files):
    out = files / "sheet.png"
    arguments = ["render", str(files / "s.evogs"), str(out), "--size", "200", "--sheet"]
    assert main([*arguments, "--reference", str(files / "s.ply")]) == 0
    label = 2 * GLYPH_HEIGHT + 2 * MARGIN  # twice as large, where there is room
    assert size_of_png(out) == (3 * 204 - 4, 4 * (label + 204) - 4)


def test_a_reference_without_a_sheet_is_refused(files, capsys):
    arguments = ["render", str(files / "s.evogs"), str(files / "x.png")]
    assert main([*arguments, "--reference", str(files / "s.ply")]) == 1
    assert "--reference needs --sheet" in capsys.readouterr().err


def test_views_of_a_camera_file_keep_their_shape(files):
    out, cameras = files / "wide.png", files / "cameras.json"
    save_cameras(cameras, demo_cameras(400, 300))
    arguments = ["render", str(files / "s.ply"), str(out), "--camera", str(cameras)]
    assert main([*arguments, "--size", "64"]) == 0
    assert size_of_png(out) == (64, 48)


def test_one_level_inside_a_box_and_another_outside(files):
    pictures = {}
    for name, options in {
        "coarse": ["--level", "0"],
        "mixed": ["--box", "110", "-99", "-99", "150", "99", "99", "--outside", "0"],
        "fine": [],
    }.items():
        out = files / f"{name}.png"
        assert main(["render", str(files / "s.evogs"), str(out), "--size", "64", *options]) == 0
        pictures[name] = out.read_bytes()
    assert len(set(pictures.values())) == 3


@pytest.mark.thorough
def test_psnr_rises_with_the_level_and_is_infinite_for_the_same_scene(files, capsys):
    found = []
    for level in (0, 1, 2):
        arguments = ["psnr", str(files / "s.evogs"), str(files / "s.ply"), "--size", "64"]
        assert main([*arguments, "--level", str(level)]) == 0
        found.append(decibels(capsys))
    assert found == sorted(found)
    assert found[-1] > 30
    assert main(["psnr", str(files / "s.ply"), str(files / "s.ply"), "--size", "32"]) == 0
    assert math.isinf(decibels(capsys))


def test_a_view_that_there_is_not_is_an_error_of_one_line(files, capsys):
    assert main(["render", str(files / "s.ply"), str(files / "x.png"), "--view", "99"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not (files / "x.png").exists()


def test_splats_that_are_not_finite_are_reported_and_not_drawn(files, capsys):
    splats = make_scene(3000)
    means = splats.means.copy()
    means[[3, 77], 1] = np.nan
    write_ply(files / "nan.ply", replace(splats, means=means))
    keep = replace(splats, means=means).finite()
    write_ply(files / "clean.ply", splats.take(keep))
    arguments = ["psnr", str(files / "nan.ply"), str(files / "clean.ply"), "--size", "40"]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert out.startswith("inf dB")
    assert "2 splats with NaN or infinite numbers are not drawn" in err
    assert main(["render", str(files / "nan.ply"), str(files / "nan.png"), "--size", "40"]) == 0
    assert main(["render", str(files / "clean.ply"), str(files / "clean.png"), "--size", "40"]) == 0
    assert (files / "nan.png").read_bytes() == (files / "clean.png").read_bytes()
