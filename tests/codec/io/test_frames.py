"""Turned scenes: from the turned camera they give the same picture."""

import itertools

import numpy as np
import pytest

from evogs_codec import SceneInfo
from evogs_codec._generated import registry
from evogs_codec.io.interchange.frames import frame_of, info_of_frame, transformed, turn
from tests.support.odd_scenes import covariances, odd_scene

render = pytest.importorskip("evogs_codec.render", reason="the rasterizer is compiled")

FRAMES = [
    "".join(letters)
    for order in itertools.permutations(["RL", "UD", "FB"])
    for letters in itertools.product(*order)
]
UPRIGHT = [frame for frame in FRAMES if frame[0] in "RL" and frame[1] in "UD"]  # only flips


def picture(splats, rotation, translation):
    camera = render.Camera(64, 48, 60.0, 60.0, 32.0, 24.0, rotation, translation)
    return render.render(splats, camera, (0.2, 0.5, 0.7))


def assert_same_picture(scene, moved, linear):
    """The picture of `moved`, which is `linear` @ `scene`, is that of `scene`, perhaps mirrored."""
    mirror = np.linalg.det(linear) < 0
    for eye in ([1.0, -1, -9], [9.0, 2, 3]):
        camera = render.Camera.look_at(
            eye, [1.3, -0.7, 2.1], (0, -1, 0), width=64, height=48, fov_x=1.2
        )
        rotation, translation = camera.rotation, camera.translation
        # x_camera = R x + t = (R L^-1) (L x) + t; a mirrored camera is mirrored once more.
        flip = np.diag([-1.0 if mirror else 1.0, 1, 1])
        there = picture(scene, rotation, translation)
        here = picture(moved, flip @ rotation @ linear.T, flip @ translation)
        assert there.std() > 0.05
        np.testing.assert_allclose(here[:, ::-1] if mirror else here, there, atol=2e-5)


@pytest.mark.parametrize("frame", UPRIGHT)
@pytest.mark.parametrize("degree", range(4))
def test_flips_show_the_same_picture_from_the_flipped_camera(frame, degree):
    scene, linear = odd_scene(degree=degree), turn("RDF", frame)
    moved = transformed(scene, linear)
    np.testing.assert_array_equal(np.abs(moved.sh), np.abs(scene.sh))  # signs are all that changes
    np.testing.assert_array_equal(np.abs(moved.quats), np.abs(scene.quats))
    assert_same_picture(scene, moved, linear)


@pytest.mark.parametrize("frame", [frame for frame in FRAMES if frame not in UPRIGHT])
def test_other_turns_show_the_same_picture_from_the_turned_camera(frame):
    scene, linear = odd_scene(), turn("RDF", frame)
    assert_same_picture(scene, transformed(scene, linear), linear)


def test_any_rotation_shows_the_same_picture_and_any_factor_its_size():
    scene = odd_scene()
    angle = 0.7
    about_z = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    rotation = about_z @ turn("RDF", "DFR") @ about_z
    assert_same_picture(scene, transformed(scene, rotation), rotation)
    larger = transformed(scene, 3 * rotation, np.array([1.0, 2, 3]))
    expected = 9 * np.einsum("ij,njk,lk->nil", rotation, covariances(scene), rotation)
    np.testing.assert_allclose(covariances(larger), expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(larger.means, 3 * scene.means @ rotation.T + [1, 2, 3], atol=1e-5)


@pytest.mark.parametrize("frame", FRAMES)
def test_a_scene_turned_back_is_the_scene(frame):
    scene = odd_scene()
    back = transformed(transformed(scene, turn("RDF", frame)), turn(frame, "RDF"))
    np.testing.assert_array_equal(back.means, scene.means)
    np.testing.assert_allclose(back.sh, scene.sh, atol=1e-6)
    np.testing.assert_allclose(covariances(back), covariances(scene), rtol=1e-4, atol=1e-7)


def test_a_frame_that_is_that_of_a_ply_changes_nothing():
    scene = odd_scene()
    assert transformed(scene, turn("RDF", "RDF")) is scene


def test_the_header_says_where_up_is_after_the_turn():
    for frame in ("RUB", "LUF", "RFU", "RDF", "FLU"):
        info = info_of_frame(SceneInfo(antialiased=True), frame)
        assert info.antialiased
        assert registry.COORDINATE_SYSTEMS[info.coordinate_system] == "RDF"
        assert registry.UP_AXES[info.up_axis] == "-y"


def test_a_scene_that_says_no_frame_has_that_of_a_ply():
    assert frame_of(SceneInfo()) == "RDF"
    assert frame_of(SceneInfo(coordinate_system=200)) == "RDF"
    assert frame_of(SceneInfo(coordinate_system=2)) == "RUB"
