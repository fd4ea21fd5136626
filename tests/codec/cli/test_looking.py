"""How commands look at a scene: cameras of others, what is up, backgrounds, pictures."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="pictures are rendered")
from PIL import Image

from evogs_codec import decode_leaves, read_directory, read_ply, write_ply, write_scene
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.render import (
    Camera,
    Views,
    cameras_around,
    load_cameras,
    orbit,
    render,
    save_cameras,
)
from evogs_codec.render.demo_scene import make_scene
from tests.trainer.views_folders import folder_of
from tools.camera_sheet import turning_z_to

SIZE = ("--size", 40)
EDGE = 40


@pytest.fixture(scope="module")
def upside_down(tmp_path_factory):
    """A scene whose up is -y, and nothing in the file says so."""
    path = tmp_path_factory.mktemp("turned") / "turned.ply"
    write_ply(path, transformed(make_scene(400), turning_z_to("-y")))
    return path


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def seen(path, camera, background=(1.0, 1.0, 1.0)):
    picture = render(read_ply(path), camera, background)
    return np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)


# --- what is up -----------------------------------------------------------------------------------


def test_every_command_finds_out_what_is_up_and_says_so(evogs, upside_down, tmp_path):
    said = "up is -y (estimated from the splats)"
    code, out, err = evogs("render", upside_down, tmp_path / "a.png", *SIZE, "--view", 0)
    assert (code, err) == (0, "")
    assert said in out
    camera = cameras_around(read_ply(upside_down), "-y", EDGE)[0]
    np.testing.assert_array_equal(pixels(tmp_path / "a.png"), seen(upside_down, camera))
    for command in ("psnr", "compare"):
        copy = tmp_path / "copy.ply"
        copy.write_bytes(upside_down.read_bytes())
        assert said in evogs(command, upside_down, copy, *SIZE)[1]
    words = ["encode", upside_down, tmp_path / "a.evogs", "--preset", "scene", "--json"]
    found = json.loads(evogs(*words)[1])
    assert found["up"] == {"axis": "-y", "source": "estimated from the splats"}


@pytest.mark.thorough
@pytest.mark.parametrize("options", [[], ["--target-psnr", 30]])
def test_an_encode_has_the_views_of_the_axis_that_was_found(evogs, upside_down, tmp_path, options):
    streams = []
    for name, up in (("found", []), ("given", ["--up", "-y"]), ("other", ["--up", "x"])):
        path = tmp_path / f"{name}.evogs"
        assert evogs("encode", upside_down, path, *options, *up)[0] == 0
        streams.append(path.read_bytes())
    assert streams[0] == streams[1]
    assert streams[0] != streams[2]


@pytest.mark.parametrize("option", ["--target-psnr", "--target-bytes"])
def test_an_encode_with_a_target_says_what_it_reached(evogs, tmp_path, option):
    scene, out = tmp_path / "a.ply", tmp_path / "a.evogs"
    write_ply(scene, make_scene(300))
    words = ["encode", scene, out, option, 30 if option == "--target-psnr" else 3500, "--up", "z"]
    said = evogs(*words)[1]
    found = json.loads(evogs(*words, "--json")[1])
    right = Views.of(read_ply(scene), up="z").psnr(decode_leaves(out))
    assert found["psnr"] == round(right, 2)
    assert found["psnr_views"] == 24
    assert f"reached: {right:.2f} dB over 24 views" in said
    plain = json.loads(evogs("encode", scene, out, "--preset", "scene", "--json")[1])
    assert "psnr" not in plain


def test_views_that_are_equal_do_not_make_an_average_infinite(evogs, tmp_path):
    scene, other = make_scene(300), tmp_path / "b.ply"
    write_ply(tmp_path / "a.ply", scene)
    write_ply(other, replace(scene, sh=scene.sh + np.float32(0.1)))
    away = Camera.look_at((1e4, 0, 0), (2e4, 0, 0), width=48, height=48, fov_x=1.0)
    save_cameras(tmp_path / "views.json", [*cameras_around(scene, "z", 48, n=3), away])
    said = evogs("psnr", other, tmp_path / "a.ply", "--camera", tmp_path / "views.json")[1]
    assert "over 3 views (1 others are equal)" in said
    assert "inf" not in said
    same = evogs("psnr", other, other, "--camera", tmp_path / "views.json")[1]
    assert "inf dB on average, inf dB at least, over 4 views" in same


@pytest.mark.thorough
def test_what_a_file_says_comes_before_what_it_shows(evogs, tmp_path):
    path = tmp_path / "x.ply"
    write_ply(path, make_scene(400), ["Vertical Axis: x"])
    assert "up is x (as the file says)" in evogs("render", path, tmp_path / "x.png", *SIZE)[1]
    words = ["encode", path, tmp_path / "x.evogs", "--preset", "scene"]
    assert "up is x (as the file says)" in evogs(*words)[1]
    out = evogs("render", tmp_path / "x.evogs", tmp_path / "y.png", *SIZE)[1]
    assert "up is x (as the file says)" in out
    out = evogs("render", path, tmp_path / "x.png", *SIZE, "--up", "+z")[1]
    assert "up is z (as asked for)" in out


@pytest.mark.thorough
def test_up_may_be_that_of_the_cameras_of_a_file(evogs, upside_down, tmp_path):
    cameras = tmp_path / "cameras.json"
    save_cameras(cameras, orbit(5, radius=3, up=(0, 0, -1), width=8, height=8, fov_x=0.8))
    out = evogs("render", upside_down, tmp_path / "a.png", *SIZE, "--up", cameras)[1]
    assert "up is -z (as the cameras were held)" in out
    words = ["encode", upside_down, tmp_path / "a.evogs", "--preset", "scene", "--up", cameras]
    assert "up is -z (as the cameras were held)" in evogs(*words)[1]


@pytest.mark.parametrize("wrong", ["w", "zz", "missing.json", ""])
def test_an_up_that_is_neither_axis_nor_file_is_refused(wrong, evogs, made, tmp_path):
    code, out, err = evogs("render", made / "scene.ply", tmp_path / "a.png", f"--up={wrong}")
    assert (code, out) == (2, "")
    assert "none of x, y, z" in err


# --- cameras and pictures -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap", "colmap-text"])
def test_cameras_of_photographs_are_taken(kind, evogs, made, tmp_path):
    folder = folder_of(tmp_path / "photographs", kind)
    words = ["--camera", folder, "--view", 2, *SIZE, "--background", "black"]
    code, out, err = evogs("render", made / "scene.ply", tmp_path / "a.png", *words)
    assert (code, err) == (0, "")
    assert "up is" not in out
    camera = load_cameras(folder)[2].resized(40, 24)
    expected = seen(made / "scene.ply", camera, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(pixels(tmp_path / "a.png"), expected)
    assert evogs("psnr", made / "scene.evogs", made / "scene.ply", *words[:2], *SIZE)[0] == 0


@pytest.mark.parametrize(
    "ending", ["jpg", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("jpeg", "JPG"))]
)
def test_a_name_that_ends_so_gets_a_jpeg(ending, evogs, refused, made, tmp_path):
    path = tmp_path / f"a.{ending}"
    for _ in range(2):  # the second replaces what the first made
        assert evogs("render", made / "scene.ply", path, *SIZE)[0] == 0
    with Image.open(path) as image:
        assert (image.format, image.size) == ("JPEG", (EDGE, EDGE))
    exact = tmp_path / "a.png"
    assert evogs("render", made / "scene.ply", exact, *SIZE)[0] == 0
    assert np.abs(pixels(path).astype(int) - pixels(exact)).mean() < 4
    Image.new("RGB", (3, 3)).save(path, "JPEG")
    refused("render", made / "scene.ply", path, *SIZE, words=["--force"])


def test_a_jpeg_without_pillow_is_refused_before_the_work(refused, made, tmp_path, monkeypatch):
    monkeypatch.setattr("evogs_codec.render.jpeg.find_spec", lambda _: None)
    refused("render", made / "scene.ply", tmp_path / "a.jpg", words=["needs Pillow"])


@pytest.mark.parametrize(
    ("given", "colour"),
    [
        pytest.param("grey", (128, 128, 128), marks=pytest.mark.thorough),
        ("#ff0080", (255, 0, 128)),
        pytest.param("00ff00", None, marks=pytest.mark.thorough),
    ],
)
def test_a_background_is_a_name_or_a_number(given, colour, evogs, tmp_path):
    write_ply(tmp_path / "x.ply", make_scene(3))
    camera = tmp_path / "away.json"
    save_cameras(camera, orbit(1, (0, 0, 900), radius=9, width=8, height=8, fov_x=0.1))
    words = ["--camera", camera, "--background", given]
    assert evogs("render", tmp_path / "x.ply", tmp_path / "x.png", *words)[0] == 0
    assert {tuple(row) for row in pixels(tmp_path / "x.png").reshape(-1, 3)} == {
        colour or (0, 255, 0)
    }


@pytest.mark.parametrize("wrong", ["blue-ish", "#ff00", "#gg0000", ""])
def test_what_is_no_colour_is_refused(wrong, evogs, made, tmp_path):
    words = ["render", made / "scene.ply", tmp_path / "a.png", f"--background={wrong}"]
    code, out, err = evogs(*words)
    assert (code, out) == (2, "")
    assert "is no colour" in err


def test_a_picture_is_larger_than_a_view_that_is_measured(evogs, tmp_path, monkeypatch):
    monkeypatch.setattr("evogs_codec.render.viewpoints.PICTURE_SIZE", 64)
    write_ply(tmp_path / "x.ply", make_scene(3))
    assert evogs("render", tmp_path / "x.ply", tmp_path / "x.png")[0] == 0
    assert pixels(tmp_path / "x.png").shape == (64, 64, 3)


@pytest.mark.parametrize("up", ["z", "-y"])
def test_the_ground_of_an_spz_says_what_is_up_where_the_axes_of_the_format_are_wrong(
    up, evogs, tmp_path
):
    """Converters turn a scene to the axes of an .spz, whatever is up in it."""
    scene = transformed(make_scene(2000), turning_z_to(up))
    write_scene(tmp_path / "x.spz", scene)
    said = "estimated from the splats" if up == "z" else "as the file says"
    code, out, _ = evogs("render", tmp_path / "x.spz", tmp_path / "x.png", "--size", 64)
    assert (code, f"up is {up} ({said})" in out) == (0, True), out
    code, out, _ = evogs("encode", tmp_path / "x.spz", tmp_path / "x.evogs", "--fast")
    assert (code, f"up is {up} ({said})" in out) == (0, True), out
    info = read_directory((tmp_path / "x.evogs").read_bytes()).info
    assert (info.coordinate_system, info.up_axis) == (1, 0 if up == "z" else 4)
