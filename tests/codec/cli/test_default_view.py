"""The default camera of a stream: written by encode, kept by others, the first view of pictures."""

import json
import math

import numpy as np
import pytest

from evogs_codec import SceneInfo, read_directory, read_scene, write_ply
from evogs_codec.cli.commands import parse
from evogs_codec.cli.default_view import with_opening_view
from evogs_codec.cli.encode_and_lift import encode_file
from evogs_codec.cli.looking import cameras_of, cameras_to_show
from evogs_codec.common.progress import no_progress
from evogs_codec.model.viewpoint import default_viewpoint
from evogs_codec.render import Camera, cameras_around, save_cameras
from evogs_codec.render.default_camera import default_camera, viewpoint_of
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.front import most_detailed

QUICK = ("--preset", "scene", "--levels", 2)


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    scene = make_scene(300)
    write_ply(folder / "x.ply", scene)
    eyes = [(3, 1, 2), (-2, 3, 1), (0.5, -4, 1)]
    cameras = [
        Camera.look_at(eye, (0.1, 0, 0.2), width=64, height=48, fov_x=math.radians(50))
        for eye in eyes
    ]
    save_cameras(folder / "cameras.json", cameras)
    return folder, scene, cameras


def encoded(evogs, folder, out, *words):
    code, _, said = evogs("encode", folder / "x.ply", out, *QUICK, *words)
    assert code == 0, said
    return read_directory(out).info


def same_view(found, camera):
    np.testing.assert_allclose(found.position, camera.position, atol=1e-5)
    np.testing.assert_allclose(found.rotation, camera.rotation, atol=1e-5)
    assert found.fy / found.height == pytest.approx(camera.fy / camera.height, rel=1e-5)


def test_a_camera_is_stored_as_a_viewpoint_and_comes_back(here):
    _, scene, cameras = here
    for camera in [*cameras, *cameras_around(scene, "-y")]:
        view = viewpoint_of(camera, (0, 0, 0))
        info = SceneInfo(text={"camera": str(view)})
        same_view(default_camera(info, "z", 64), camera)
    behind = viewpoint_of(cameras[0], (30, 10, 20))
    same_view(default_camera(SceneInfo(text={"camera": str(behind)}), "z", 8), cameras[0])


def test_the_first_camera_of_a_file_is_the_default_or_the_one_asked_for(here, evogs, tmp_path):
    folder, _, cameras = here
    out, words = tmp_path / "x.evogs", ("--camera", folder / "cameras.json")
    for more, camera in (((), cameras[0]), (("--view", 2), cameras[2])):
        info = encoded(evogs, folder, out, *words, *more)
        same_view(default_camera(info, "z", 48), camera)
    assert "camera" not in encoded(evogs, folder, out, *words, "--view", "none").text


@pytest.mark.thorough
def test_without_cameras_nothing_is_written_unless_a_default_view_is_asked_for(
    here, evogs, tmp_path
):
    folder, scene, _ = here
    out = tmp_path / "x.evogs"
    assert "camera" not in encoded(evogs, folder, out).text
    plain = out.read_bytes()
    encoded(evogs, folder, out, "--view", "none")
    assert out.read_bytes() == plain
    info = encoded(evogs, folder, out, "--view", 5, "--up", "z")
    same_view(default_camera(info, "z", 48), cameras_around(scene, "z")[5])


@pytest.mark.parametrize("view", ["0", "3", "none"])
def test_a_scene_of_several_files_is_never_there_as_a_whole(view, here, refused, tmp_path):
    folder, *_ = here
    (tmp_path / "y.ply").write_bytes((folder / "x.ply").read_bytes())
    words = ["encode", folder / "x.ply", tmp_path / "y.ply", tmp_path / "z.evogs", "--view", view]
    refused(*words, words=["--view needs the whole scene at once"])


def test_a_view_that_is_not_there_is_refused(here, refused, tmp_path):
    folder, *_ = here
    words = ["encode", folder / "x.ply", tmp_path / "x.evogs", *QUICK]
    refused(*words, "--view", 24, words=["camera 24 is not one of 0..23"])
    refused(*words, "--view", 3, "--camera", folder / "cameras.json", words=["0..2"])
    refused(*words, "--captured", "yesterday", words=["--captured: expected a date"])
    for given in ("-1", "x", "1e3"):
        assert refused(*words, "--view", given, code=2)


def test_extract_decode_and_encode_keep_it(here, evogs, tmp_path):
    folder, *_ = here
    words = ("--camera", folder / "cameras.json", "--captured", "2026-09-30", "--device", "D 1")
    text = encoded(evogs, folder, tmp_path / "x.evogs", *words).text
    assert (text["captured"], text["device"]) == ("2026-09-30", "D 1")
    assert evogs("extract", tmp_path / "x.evogs", tmp_path / "y.evogs", "--level", 0)[0] == 0
    assert read_directory(tmp_path / "y.evogs").info.text == text
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "y.ply")[0] == 0
    found = read_scene(tmp_path / "y.ply").info.text
    assert found == {key: text[key] for key in ("camera", "captured")}
    assert evogs("convert", tmp_path / "x.evogs", tmp_path / "y.glb")[0] == 0
    found = read_scene(tmp_path / "y.glb").info.text
    assert found == {key: text[key] for key in ("camera", "captured", "device")}
    again = [tmp_path / "y.ply", tmp_path / "z.evogs", *QUICK]
    assert evogs("encode", *again)[0] == 0
    assert read_directory(tmp_path / "z.evogs").info.text["camera"] == text["camera"]


def test_a_camera_does_not_hold_in_other_axes(here, evogs, tmp_path):
    folder, *_ = here
    words = ("--camera", folder / "cameras.json", "--coordinate-system", "RFU")
    encoded(evogs, folder, tmp_path / "x.evogs", *words)
    assert evogs("convert", tmp_path / "x.evogs", tmp_path / "y.glb")[0] == 0
    assert read_scene(tmp_path / "y.glb").info.text == {}


def test_comments_of_others_that_are_no_values_are_nothing(tmp_path):
    comments = ["camera: Canon", "crs: 4978", "transform: none", "captured: today", "camera: {}"]
    write_ply(tmp_path / "x.ply", make_scene(20), comments)
    assert read_scene(tmp_path / "x.ply").info.text == {}
    rows = "1 0 0 4027893.75 0 1 0 -3e5 0 0 1 4.5 0 0 0 1"
    write_ply(tmp_path / "x.ply", make_scene(20), ["crs: EPSG:4978", f"transform: {rows}"])
    expected = {"crs": "EPSG:4978", "transform": rows}
    assert read_scene(tmp_path / "x.ply").info.text == expected


def test_info_shows_the_camera_and_the_bounds(here, evogs, tmp_path):
    folder, scene, _ = here
    encoded(evogs, folder, tmp_path / "x.evogs", "--camera", folder / "cameras.json")
    found = json.loads(evogs("info", tmp_path / "x.evogs", "--json")[1])
    expected = default_viewpoint(read_directory(tmp_path / "x.evogs").info.text)
    assert found["camera"] == json.loads(str(expected))
    low, high = found["bounds"]["low"], found["bounds"]["high"]
    assert (np.array(low) <= scene.means.min(0) + 0.01).all()
    assert (np.array(high) >= scene.means.max(0) - 0.01).all()
    said = evogs("info", tmp_path / "x.evogs")[1]
    assert "camera  {" in said
    assert "bounds  -" in said


def test_it_is_view_0_of_pictures(here, evogs, tmp_path):
    folder, scene, cameras = here
    info = encoded(evogs, folder, tmp_path / "x.evogs", "--camera", folder / "cameras.json")
    args = parse(["render", str(tmp_path / "x.evogs"), "out.png", "--up", "z"])
    found, _, is_own = cameras_to_show(args, scene, info, size=32)
    assert is_own
    same_view(found[0], cameras[0])
    assert (len(found), found[0].width, found[0].height) == (25, 32, 32)
    for one, other in zip(found[1:], cameras_around(scene, "z", 32), strict=True):
        same_view(one, other)


def test_figures_are_over_the_same_24_views_with_it_and_without(here, evogs, tmp_path):
    folder, scene, _ = here
    words = ("--camera", folder / "cameras.json")
    info = encoded(evogs, folder, tmp_path / "x.evogs", *words)
    encoded(evogs, folder, tmp_path / "plain.evogs")
    args = parse(["psnr", str(tmp_path / "x.evogs"), str(folder / "x.ply"), "--up", "z"])
    found, _ = cameras_of(args, scene, info, size=32)
    for one, other in zip(found, cameras_around(scene, "z", 32), strict=True):
        same_view(one, other)
    said = evogs("compare", tmp_path / "x.evogs", folder / "x.ply", "--size", 8)[1]
    assert "24 on a circle" in said
    assert "default camera" not in said
    look = (tmp_path / "y.ply", "--up", "z", "--size", 8)
    assert evogs("decode", tmp_path / "x.evogs", tmp_path / "y.ply")[0] == 0
    both = [evogs("psnr", tmp_path / name, *look)[1] for name in ("x.evogs", "plain.evogs")]
    assert all("over 24 views" in line for line in both)
    both = [
        evogs("psnr", folder / "x.ply", tmp_path / name, *look[1:])[1]
        for name in ("x.evogs", "plain.evogs")
    ]
    assert both[0] == both[1]


def test_render_shows_it_or_the_view_with_the_most_detail_or_the_one_asked_for(
    here, evogs, tmp_path
):
    folder, scene, _ = here
    encoded(evogs, folder, tmp_path / "x.evogs", "--camera", folder / "cameras.json")
    number = most_detailed(scene, cameras_around(scene, "z", 16))
    assert number > 0
    for source, words, view in (
        (tmp_path / "x.evogs", (), 0),
        (folder / "x.ply", (), number),
        (folder / "x.ply", ("--view", 0), 0),
    ):
        said = evogs("render", source, tmp_path / "x.png", "--up", "z", "--size", 16, *words)[1]
        assert f"view {view}, 300 splats, 1 view" in said


def test_a_scene_that_a_page_is_made_of_opens_on_the_view_that_render_shows(here):
    folder, scene, cameras = here
    info = read_directory(encode_file(folder / "x.ply", no_progress, "fast")).info
    around = cameras_around(scene)
    same_view(default_camera(info, "z", 100), around[most_detailed(scene, around)])
    # One that names a camera keeps it.
    known = SceneInfo(text={"camera": str(viewpoint_of(cameras[0], (0.1, 0, 0.2)))})
    assert with_opening_view(scene, known) == known
    assert with_opening_view(scene.take(slice(0)), SceneInfo()) == SceneInfo()
