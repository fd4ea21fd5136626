"""What has crashed, hung or poisoned other rasterizers."""

import tracemalloc

import numpy as np
import pytest

from evogs_codec.render import Options, render, render_counted
from tests.render import scenes
from tests.render.scenes import BACKGROUND, f32
from tests.render.test_forward import assert_agrees

BEFORE = scenes.ball(40, 1, size=0.3)  # company, so that poison could spread
CAMERA = scenes.facing()

LONELY = {
    "needle of 1,000 pixels": scenes.row(quat=(0.9, 0.1, 0.2, 0.38), log_scale=(4, -9, -9)),
    "needle of 100,000 pixels": scenes.row(quat=(0.9, 0.1, 0.2, 0.38), log_scale=(9, -20, -20)),
    "needle along the view": scenes.row(log_scale=(-20, -20, 8)),
    "pancake edge on": scenes.row(quat=(0.7, 0, 0.7, 0), log_scale=(2, 2, -20)),
    "pancake face on": scenes.row(log_scale=(2, 2, -40)),
    "a point": scenes.row(log_scale=(-90, -90, -90)),
    "larger than the world": scenes.row(log_scale=(15, 15, 15)),
    "scales of e^80": scenes.row(log_scale=(80, 80, 80)),
    "scales of e^80, flat": scenes.row(quat=(0.3, 0.5, 0.1, 0.9), log_scale=(80, -80, 3)),
    "zero quaternion": scenes.row(quat=(0, 0, 0, 0), log_scale=(-1, -2, -3)),
    "tiny quaternion": scenes.row(quat=(1e-25, 2e-25, 0, 1e-25), log_scale=(-1, -2, -3)),
    "huge quaternion": scenes.row(quat=(1e30, 2e30, 0, 1e30), log_scale=(-1, -2, -3)),
    "opaque": scenes.row(logit=100.0),
    "invisible": scenes.row(logit=-100.0),
    "opacity close to 1/255": scenes.row(logit=-5.5373),
    "just past the near plane": scenes.row(mean=(0.01, 0, 0.2001), log_scale=(-1, -1, -1)),
    "just past it, far to the side": scenes.row(mean=(90, 70, 0.2001), log_scale=(3, 3, 3)),
    "far away": scenes.row(mean=(0, 0, 1e30)),
    "far to the side": scenes.row(mean=(1e30, -1e30, 1)),
    "blinding": scenes.row(colour=1e30),
    "black": scenes.row(colour=-1e30),
}


@pytest.mark.parametrize("name", LONELY)
def test_an_extreme_splat_is_drawn_as_defined(name):
    assert_agrees(LONELY[name], CAMERA)
    assert_agrees(scenes.joined(BEFORE, LONELY[name]), scenes.camera(40))


BEHIND = {
    "at the camera": (0, 0, 0),
    "behind the camera": (0.1, 0, -3),
    "on the near plane": (0, 0, 0.2),
}


@pytest.mark.parametrize("name", BEHIND)
def test_a_splat_that_is_not_in_front_is_invisible(name):
    splats = scenes.row(500, mean=BEHIND[name], log_scale=(1, 1, 1))
    image, counts = render_counted(splats, CAMERA, BACKGROUND, options=Options(near=f32(0.2)))
    assert (counts.n_drawn, counts.n_invisible, counts.n_non_finite) == (0, 500, 0)
    np.testing.assert_array_equal(image, render(scenes.EMPTY, CAMERA, BACKGROUND))


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", scenes.FIELDS)
def test_a_number_that_is_not_finite_makes_its_splat_invisible_and_counted(name, poison):
    splats, camera = scenes.ball(60, 2, size=0.3), scenes.camera(40)
    field = getattr(splats, name)
    clean = render(splats.take(np.arange(60) != 33), camera, BACKGROUND)
    for place in np.ndindex(field.shape[1:]):
        values = field.copy()
        values[(33, *place)] = poison
        image, counts = render_counted(scenes.changed(splats, **{name: values}), camera, BACKGROUND)
        np.testing.assert_array_equal(image, clean)
        assert counts.n_non_finite == 1


def test_splats_at_one_depth_are_drawn_in_order_of_index():
    rng = np.random.default_rng(4)
    splats = scenes.row(300, log_scale=(-1.5, -2, -2))
    means = splats.means.copy()
    means[:, :2] = rng.uniform(-1, 1, (300, 2))
    splats = scenes.changed(splats, means=means, sh=f32(rng.normal(size=(300, 1, 3))))
    picture = assert_agrees(splats, CAMERA)
    difference = np.abs(render(splats, CAMERA, BACKGROUND) - picture.image)
    assert difference.max() < 1e-5  # exact ties: not even the doubtful pixels differ
    assert np.abs(render(splats.take(np.arange(300)[::-1]), CAMERA) - picture.image).max() > 0.1


def test_no_splat_at_all_is_a_picture_of_the_background():
    image, counts = render_counted(scenes.EMPTY, CAMERA, BACKGROUND)
    assert (counts.n_drawn, counts.n_intersections) == (0, 0)
    assert (image == scenes.f32(BACKGROUND)).all()


@pytest.mark.parametrize(
    "logit", [-5.5, *(pytest.param(logit, marks=pytest.mark.thorough) for logit in (0.0, 30.0))]
)
def test_a_million_splats_in_one_pixel_need_bounded_memory(logit):
    splats = scenes.row(1_000_000, log_scale=(-9, -9, -9), logit=logit)
    camera = scenes.facing(1, 1)
    render(splats.take(np.arange(2)), camera)
    tracemalloc.start()
    image, counts = render_counted(splats, camera, BACKGROUND)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert counts.n_intersections == 1_000_000
    assert peak < 160 * 1_000_000
    assert np.isfinite(image).all()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 300), (300, 1), (17, 15)])
def test_pictures_of_few_pixels_agree_with_the_oracle(width, height):
    assert_agrees(scenes.ball(200, 2, size=0.3), scenes.facing(width, height))


def test_more_intersections_than_allowed_are_refused():
    splats = scenes.row(1000, log_scale=(5, 5, 5))
    with pytest.raises(ValueError, match="max_intersections"):
        render(splats, scenes.facing(160, 160), options=Options(max_intersections=99_999))
    image = render(splats, scenes.facing(160, 160), options=Options(max_intersections=100_000))
    assert np.isfinite(image).all()


@pytest.mark.slow
def test_a_picture_of_8192_by_8192_pixels_is_drawn():
    splats = scenes.joined(
        scenes.ball(1000, 3), scenes.row(40, mean=(0, 0, 0), log_scale=(4, 4, 4), logit=-4.0)
    )
    image, counts = render_counted(splats, scenes.camera(8192), BACKGROUND)
    assert image.shape == (8192, 8192, 3)
    assert counts.n_intersections > 40 * 512 * 512
    assert all(np.isfinite(image[i]).all() for i in range(0, 8192, 64))
