"""Which of the cameras that somebody gave are rendered from, and what they show."""

import numpy as np
import pytest

pytest.importorskip("numba")

from evogs_codec import encode_scene
from evogs_codec.render import Camera, Views, cameras_around
from evogs_codec.render.camera import orbit
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.viewpoints import most_different, share_shown
from evogs_codec.render.views import DRAWN, MORE_OF_GIVEN


def turning(n):
    """Cameras in one place, each of which looks a little further to the left."""
    turns = 2 * np.pi * np.arange(n) / n
    ways = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(n)])
    return [Camera.look_at((0, 0, 0), way, width=40, height=30, fov_x=1.0) for way in ways]


def key(camera):
    return (*camera.position, *camera.rotation.ravel())


def test_cameras_that_differ_are_chosen_whatever_their_order():
    cameras = turning(48) + orbit(48, radius=9.0, width=40, height=30, fov_x=1.0)
    shuffled = [cameras[k] for k in np.random.default_rng(0).permutation(96)]
    found = most_different(cameras, 24)
    assert list(map(key, most_different(shuffled, 24))) == list(map(key, found))
    assert len({key(camera) for camera in found}) == 24
    assert list(map(key, most_different(cameras, 12))) == list(map(key, found[:12]))


@pytest.mark.parametrize("n", [2, 4, 8])
def test_cameras_that_turn_are_chosen_all_round(n):
    axes = np.array([camera.rotation[2] for camera in most_different(turning(64), n)])
    angles = np.sort(np.arctan2(axes[:, 1], axes[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    assert gaps.max() == pytest.approx(2 * np.pi / n, abs=0.11)


def test_all_of_a_few_cameras_are_there_and_none_of_none():
    cameras = turning(5)
    assert sorted(map(key, most_different(cameras, 9))) == sorted(map(key, cameras))
    assert most_different([], 9) == []
    same = cameras[:1] * 4
    assert list(map(key, most_different(same, 3))) == [key(cameras[0])] * 3


def test_more_of_given_cameras_weigh_errors():
    cameras = orbit(100, radius=9.0, width=40, height=30, fov_x=1.0)
    views = Views.of(make_scene(50), cameras)
    assert len(views.cameras) == 100
    assert len(views._weighing.cameras) == MORE_OF_GIVEN * DRAWN


def test_what_part_of_a_scene_cameras_show():
    scene = make_scene(3000)
    around = cameras_around(scene, "z")
    away = [Camera.look_at((1e4, 0, 0), (2e4, 0, 0), width=40, height=30, fov_x=1.0)]
    assert share_shown(scene, around) > 0.7
    assert share_shown(scene, away) == 0
    assert share_shown(scene, away + around[:1]) == share_shown(scene, around[:1])
    assert share_shown(scene.take(slice(0)), around) == 1


def test_cameras_of_another_world_are_told_of():
    scene = make_scene(300)
    away = [
        Camera.look_at((1e4, k, 0), (2e4, 0, 0), width=40, height=30, fov_x=1.0) for k in range(2)
    ]
    with pytest.warns(UserWarning, match="show 0% of the splats.* same world"):
        encode_scene(scene, cameras=away)
    encode_scene(scene, cameras=away, preset="scene")  # whose steps do not depend on cameras
