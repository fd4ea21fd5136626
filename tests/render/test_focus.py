"""Where default cameras look: at the detail in a scene, if it is far smaller than the scene."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from evogs_codec import SplatParams, decode_leaves, encode_scene
from evogs_codec.render import cameras_around, weighing_cameras
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.framing import MIN_OF_DETAIL, bulk_of, focus_of
from tools.bench.landscape import OBJECT, landscape_of, standing


def distances(cameras, middle):
    return [np.linalg.norm(camera.position - middle) for camera in cameras]


@pytest.mark.parametrize("seed", range(3))
def test_cameras_look_at_the_object_of_a_landscape(seed):
    scene = landscape_of(3000, seed)
    focus, bulk = focus_of(scene), bulk_of(scene)
    assert np.abs(focus.middle).max() < OBJECT
    assert 0.3 * OBJECT < focus.size < 3 * OBJECT
    assert bulk.size > 5 * focus.size
    away = distances(cameras_around(scene, "z"), focus.middle)
    assert away == pytest.approx([2 * focus.size] * 24)


def test_some_cameras_that_weigh_errors_stand_around_the_whole():
    scene = landscape_of(3000)
    cameras = weighing_cameras(scene, "z", 12)
    assert len(cameras) == 12
    assert distances(cameras[:8], focus_of(scene).middle) == pytest.approx(
        [2 * focus_of(scene).size] * 8
    )
    assert distances(cameras[8:], bulk_of(scene).middle) == pytest.approx(
        [2 * bulk_of(scene).size] * 4
    )


@pytest.mark.parametrize("change", [0.0, -2.0, 2.0])
def test_most_scenes_are_looked_at_as_a_whole(change):
    scene = make_scene(3000)
    scene = replace(scene, log_scales=scene.log_scales + np.float32(change))
    assert focus_of(scene) is bulk_of(scene)


def test_an_insect_in_a_city_and_a_few_splats_are_no_focus():
    city = make_scene(1000)
    tiny = replace(
        city, means=city.means * np.float32(1e-4), log_scales=city.log_scales - np.float32(9)
    )
    both = SplatParams.joined([city, tiny])
    assert focus_of(both) is bulk_of(both)
    few = landscape_of(MIN_OF_DETAIL // 2)
    assert focus_of(few) is bulk_of(few)


def test_splats_that_are_not_finite_are_not_looked_at():
    scene = landscape_of(3000)
    means = scene.means.copy()
    means[::3] = np.nan
    rest = scene.take(np.arange(len(scene)) % 3 != 0)
    found, right = focus_of(replace(scene, means=means)), focus_of(rest)
    assert found.size == right.size
    np.testing.assert_array_equal(found.middle, right.middle)


@pytest.mark.thorough
def test_the_object_of_a_landscape_looks_right_from_where_people_stand():
    scene = landscape_of(8000, 5)
    leaves = decode_leaves(encode_scene(scene, up="z"))
    near, far = (standing(scene, away) for away in (2 * OBJECT, 40.0))
    assert near.psnr(leaves) > 36
    assert far.psnr(leaves) > 32
