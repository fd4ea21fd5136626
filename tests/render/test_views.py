"""Views by which an encoder judges."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec import lift
from evogs_codec.render import (
    Camera,
    Views,
    cameras_all_around,
    cameras_around,
    weighing_cameras,
)
from evogs_codec.render import views as module
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.viewpoints import most_different


@pytest.fixture(scope="module")
def tree():
    return lift(make_scene(400), 4)


@pytest.fixture
def views(tree):
    leaves = tree.leaves()
    return Views(leaves, cameras_around(leaves, "z", 48, n=12))


def drawn(monkeypatch):
    """Cameras of pictures that are drawn from now on, with gradients and without."""
    found: dict[str, list[Camera]] = {"draw": [], "render": []}
    for name, cameras in found.items():
        own = getattr(module, name)

        def noted(splats, camera, *more, _own=own, _cameras=cameras, **options):
            _cameras.append(camera)
            return _own(splats, camera, *more, **options)

        monkeypatch.setattr(module, name, noted)
    return found


@pytest.mark.parametrize("level", [2, 3])
def test_one_drawing_tells_what_two_would(tree, views, level):
    splats = tree.leaves(level)
    found, decibels = views.sensitivity_and_psnr(splats)
    assert np.array_equal(found, views.sensitivity(splats))
    assert decibels == views.fewer(module.COMPARED).psnr(splats)


def test_of_a_coarse_level_fewer_views_are_drawn(tree, views, monkeypatch):
    few = views.fewer(module.COMPARED)
    assert list(few.cameras) == list(views.cameras[::2])
    splats = tree.leaves(0)
    assert 4 * len(splats) <= len(views.scene)
    cameras = drawn(monkeypatch)
    found, decibels = views.sensitivity_and_psnr(splats)
    assert cameras == {"draw": few.cameras, "render": few.cameras}  # render: the scene
    assert np.array_equal(found, few.sensitivity(splats))
    assert decibels == few.psnr(splats)


def test_a_coarse_level_of_many_splats_is_drawn_in_smaller_pictures(tree, monkeypatch):
    monkeypatch.setattr(module, "SMALLER_ABOVE", 100)
    leaves = tree.leaves()
    views = Views(leaves, cameras_around(leaves, "z", 320, n=12))
    small = views.fewer(module.COMPARED).within(200)
    for level, sizes in ((0, [200] * 6), (3, [320] * 12)):
        cameras = drawn(monkeypatch)
        found, decibels = views.sensitivity_and_psnr(tree.leaves(level))
        assert [camera.width for camera in cameras["draw"]] == sizes
        assert {camera.width for camera in cameras["render"]} == {200}
        worth = (small if level == 0 else views).sensitivity(tree.leaves(level))
        assert np.array_equal(found, worth)
        assert decibels == small.psnr(tree.leaves(level))


def test_where_something_is_between_pictures_keep_their_size(tree, monkeypatch):
    monkeypatch.setattr(module, "SMALLER_ABOVE", 100)
    leaves = tree.leaves()
    views = Views(leaves, cameras_around(leaves, "z", 320, n=2))
    nothing = np.ones((320, 320, 1), np.float32), np.ones((320, 320, 3), np.float32)
    between = {camera: module.Between(*nothing) for camera in views.cameras}
    splats = tree.leaves(0)
    found, decibels = replace(views, between=between).sensitivity_and_psnr(splats)
    assert np.array_equal(found, views.sensitivity(splats))
    assert decibels == views.psnr(splats)


def test_of_no_splats_there_is_a_picture(tree, views):
    blank = views.scene.take([])
    found, decibels = views.sensitivity_and_psnr(blank)
    assert found.shape == (59, 0)
    assert decibels == views.fewer(module.COMPARED).psnr(blank)


def test_the_scene_is_drawn_once(tree, views, monkeypatch):
    cameras = drawn(monkeypatch)
    few = views.fewer(3)
    for one in (views, few, views.fewer(5)):
        one.psnr(views.scene.take([]))
    assert len(cameras["render"]) == 12 + 12 + 3 + 4


def test_what_is_known_of_splats_is_not_drawn_again(tree, views, monkeypatch):
    leaves = tree.leaves(2)
    expected = views.psnr_of_each(leaves)
    views = replace(views, known={})
    cameras = drawn(monkeypatch)["render"]
    views.fewer(6).psnr_of_each(leaves)
    assert cameras == views.cameras[::2]
    assert np.array_equal(views.psnr_of_each(leaves), expected)
    assert len(cameras) == len(views.cameras)
    views.psnr_of_each(tree.leaves(1))
    assert len(cameras) == 2 * len(views.cameras)


@pytest.mark.parametrize(("n", "counts"), [(6, (4, 1, 1)), (12, (8, 2, 2)), (24, (16, 4, 4))])
def test_errors_are_weighed_from_the_circle_from_below_and_from_far_above(n, counts):
    splats = make_scene(400)
    cameras = weighing_cameras(splats, "z", n)
    level = cameras_around(splats, "z")[0].position[2]
    heights = np.array([camera.position[2] - level for camera in cameras])
    on_it = int((np.abs(heights) < 1e-6).sum())
    below, above = int((heights < -0.1).sum()), int((heights > 0.1).sum())
    assert (on_it, below, above) == counts


def test_what_stands_only_below_is_worth_something():
    splats = make_scene(400)
    plain = Views.of(splats, up="z")
    of_circle = Views(splats, plain.cameras, options=plain.options)
    low = np.argsort(splats.means[:, 2])[:40]
    opacities = slice(10, 11)
    worth = plain.sensitivity(splats)[opacities, low].sum()
    assert worth > 1.2 * of_circle.sensitivity(splats)[opacities, low].sum()


def test_cameras_that_are_given_weigh_alone():
    splats = make_scene(400)
    cameras = cameras_around(splats, "z", 48, n=12)
    given = Views.of(splats, cameras)
    alone = Views(splats, most_different(cameras, 12), options=given.options)
    assert np.array_equal(given.sensitivity(splats), alone.sensitivity(splats))


@pytest.mark.parametrize("has_others", [False, True])
def test_errors_are_weighed_in_smaller_views_and_measured_in_larger(has_others):
    splats = make_scene(50)
    large = cameras_around(splats, "z", 64, n=2)
    others = cameras_around(splats, "z", 64, n=2, elevation=1.0) if has_others else []
    views = Views(splats, large, weighing=others)
    smaller = views.weighing_within(16)
    assert smaller.cameras == large
    assert [camera.width for camera in smaller.weighing] == [16, 16]
    for one, other in zip(smaller.weighing, others or large, strict=True):
        assert np.array_equal(one.translation, other.translation)
    assert views.weighing_within(None) is views


def test_descent_looks_from_all_around():
    splats = make_scene(300)
    cameras = cameras_all_around(splats, "z")
    heights = np.array([camera.position[2] for camera in cameras])
    circle = cameras_around(splats, "z")[0].position[2]
    assert (len(cameras), (heights < 0).sum(), (heights > 2.5 * circle).sum()) == (108, 16, 12)
    assert np.abs(heights - circle).min() > 0.2 * circle  # no camera stands where one judges
    others = Views.of(splats, up="z", descent=True).others
    np.testing.assert_array_equal([camera.position[2] for camera in others], heights)
