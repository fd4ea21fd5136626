"""Camera conventions, and files of cameras."""

import math
from typing import Any

import numpy as np
import pytest

from evogs_codec.render import Camera, Options, load_cameras, orbit, render, save_cameras
from tests.render import scenes

SIZE: dict[str, Any] = {"width": 65, "height": 49, "fov_x": 0.9}


def pixel_of(camera, point):
    x, y, z = camera.rotation @ np.asarray(point, float) + camera.translation
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    camera = Camera.look_at((3, -2, 1), (0.5, 0, 0.2), **SIZE)
    x, y, z = pixel_of(camera, (0.5, 0, 0.2))
    assert (x, y) == pytest.approx((32.5, 24.5))
    assert z == pytest.approx(np.linalg.norm([2.5, -2, 0.8]))
    assert pixel_of(camera, (0.5, 0, 0.4))[1] < y
    np.testing.assert_allclose(camera.position, (3, -2, 1), atol=1e-12)


def test_x_is_to_the_right():
    camera = Camera.look_at((0, -3, 0), (0, 0, 0), **SIZE)  # looks along +y, up is +z
    assert pixel_of(camera, (1, 0, 0))[0] > 32.5


def test_the_field_of_view_spans_the_width():
    camera = Camera.look_at((0, -3, 0), (0, 0, 0), **SIZE)
    assert pixel_of(camera, (3 * np.tan(0.45), 0, 0))[0] == pytest.approx(65)


def test_a_splat_is_drawn_at_the_pixel_it_projects_to():
    splats = scenes.row(mean=(0.3, -0.2, 0.1), log_scale=(-5, -5, -5), logit=5.0)
    for camera in orbit(5, radius=3, width=64, height=48, fov_x=0.7):
        image = render(splats, camera)[..., 0]
        y, x = np.unravel_index(np.argmax(image), image.shape)
        assert (x + 0.5, y + 0.5) == pytest.approx(pixel_of(camera, (0.3, -0.2, 0.1))[:2], abs=0.51)


def test_blender_matrices_mean_camera_to_world_y_up_z_backward():
    # At (0, -3, 0), looking along +y with z up: x stays x, y is world z, z is world -y.
    matrix = [[1, 0, 0, 0], [0, 0, -1, -3], [0, 1, 0, 0], [0, 0, 0, 1]]
    ours = Camera.from_blender(matrix, 0.9, width=65, height=49)
    expected = Camera.look_at((0, -3, 0), (0, 0, 0), **SIZE)
    np.testing.assert_allclose(ours.rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(ours.translation, expected.translation, atol=1e-12)
    assert ours.fx == expected.fx


def test_colmap_images_are_world_to_camera_already():
    half = np.sqrt(0.5)
    camera = Camera.from_colmap(
        (half, half, 0, 0), (1, 2, 3), (50, 60, 20, 10), width=40, height=20
    )
    # A quarter turn about x takes y to z and z to -y.
    np.testing.assert_allclose(camera.rotation @ (0, 1, 0), (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(camera.rotation @ (0, 0, 1), (0, -1, 0), atol=1e-12)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50, 60, 20, 10)
    simple = Camera.from_colmap((2, 0, 0, 0), (0, 0, 0), (50, 20, 10), width=40, height=20)
    assert (simple.fx, simple.fy) == (50, 50)


def test_the_clamp_of_steep_splats_follows_the_principal_point():
    view = scenes.facing(100, 80).view(Options())
    # Entries 19..22: x/z and y/z within 1.3 tan(fov / 2) when the centre is in the middle.
    np.testing.assert_allclose(view[19:23], (-0.65, 0.65, -0.52, 0.52))


def test_orbits_keep_their_distance_and_look_at_the_target():
    cameras = orbit(8, (1, 2, 3), radius=4, elevation=0.3, up=(0, 1, 0), **SIZE)
    assert len(cameras) == 8
    for camera in cameras:
        assert np.linalg.norm(camera.position - (1, 2, 3)) == pytest.approx(4)
        assert camera.position[1] == pytest.approx(2 + 4 * np.sin(0.3))
        assert pixel_of(camera, (1, 2, 3))[:2] == pytest.approx((32.5, 24.5))


def test_an_orbit_needs_an_axis():
    with pytest.raises(ValueError, match=r"up is \[0, 0, 0\]"):
        orbit(3, radius=2.2, up=(0, 0, 0), **SIZE)


def test_resizing_keeps_what_is_seen():
    camera = scenes.camera(64)
    x, y, _ = pixel_of(camera, (0.1, 0.2, 0.3))
    assert pixel_of(camera.resized(128, 32), (0.1, 0.2, 0.3))[:2] == pytest.approx((2 * x, y / 2))


def test_a_file_of_cameras_gives_the_same_numbers_back(tmp_path):
    cameras = orbit(3, radius=2.2, **SIZE)
    save_cameras(tmp_path / "cameras.json", cameras)
    for ours, theirs in zip(cameras, load_cameras(tmp_path / "cameras.json"), strict=True):
        np.testing.assert_array_equal(ours.view(Options()), theirs.view(Options()))
        assert (ours.width, ours.height) == (theirs.width, theirs.height)


@pytest.mark.parametrize(
    "text", ['{"frames": []}', '{"cameras": [{"width": 3}]}', '{"cameras": []}', "[]", "{", ""]
)
def test_a_file_of_something_else_is_refused(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(ValueError, match=r"x\.json"):
        load_cameras(tmp_path / "x.json")


@pytest.mark.parametrize(
    "wrong",
    [
        {"width": 0},
        {"width": 48.0},
        {"height": True},
        {"fx": 0.0},
        {"cx": float("nan")},
        {"rotation": -np.eye(3)},
        {"rotation": 2 * np.eye(3)},
        {"translation": np.full(3, np.nan)},
        {"translation": np.zeros(4)},
    ],
)
def test_an_impossible_camera_is_refused(wrong):
    right: dict[str, Any] = {
        "width": 8, "height": 8, "fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 4.0,
        "rotation": np.eye(3), "translation": np.zeros(3),
    }  # fmt: skip
    Camera(**right)
    with pytest.raises(ValueError, match=r"."):
        Camera(**{**right, **wrong})


@pytest.mark.parametrize("fov_x", [0.0, 5e-324, -1.0, math.pi, math.nan, math.inf])
def test_a_camera_without_a_field_of_view_is_refused(fov_x):
    with pytest.raises(ValueError, match="expected above 0 and below pi"):
        Camera.look_at((0, -4, 1), (0, 0, 0), width=8, height=8, fov_x=fov_x)
