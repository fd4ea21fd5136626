"""Gradients are those of the pictures: finite differences, both precisions, any threads."""

import numba
import numpy as np
import pytest

from evogs_codec.render import Camera, Options, draw, gradients, render
from evogs_codec.render import tiles as tiles_module
from evogs_codec.render.options import DEFAULT
from tests.render import scenes
from tests.render.scenes import BACKGROUND, f32
from tests.render.test_traps import LONELY

LOOKS = {
    "classic": Options(),
    "antialiased": Options(antialiased=True),
    "clamped early": Options(alpha_max=0.5),
}
STEPS = (1e-5, 1e-6, 1e-7)


def image_gradient(camera, seed=0, dtype=np.float64):
    return np.random.default_rng(seed).normal(size=(camera.height, camera.width, 3)).astype(dtype)


def of(splats, camera, options=DEFAULT, dtype=np.float32):
    drawing = draw(splats, camera, BACKGROUND, options=options, dtype=dtype)
    return gradients(drawing, splats, image_gradient(camera))


def assert_finite(found):
    for name in (*scenes.FIELDS, "centers"):
        assert np.isfinite(getattr(found, name)).all(), name


def assert_equal(ours, theirs):
    for name in (*scenes.FIELDS, "centers"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def assert_is_the_finite_difference(splats, camera, options, n=25):
    """Of a random linear loss. Pictures jump where a splat passes 1/255: the best step counts."""
    splats = scenes.as_float64(splats)
    found = of(splats, camera, options, np.float64)
    g = image_gradient(camera)

    def loss():
        image = render(splats, camera, BACKGROUND, options=options, dtype=np.float64)
        return np.vdot(image, g)

    rng = np.random.default_rng(1)
    for name in scenes.FIELDS:
        array, gradient = getattr(splats, name), getattr(found, name)
        assert np.abs(gradient).max() > 1e-3
        for _ in range(n):
            place = tuple(rng.integers(0, size) for size in array.shape)
            value, errors = array[place], []
            for step in STEPS:
                array[place] = value + step
                above = loss()
                array[place] = value - step
                errors.append(abs((above - loss()) / (2 * step) - gradient[place]))
                array[place] = value
            assert min(errors) <= 1e-5 * abs(gradient[place]) + 1e-6, (name, place)


@pytest.mark.thorough
@pytest.mark.parametrize("look", LOOKS)
def test_gradients_are_finite_differences(look):
    assert_is_the_finite_difference(
        scenes.ball(40, 3, size=0.15), scenes.camera(40, 33), LOOKS[look]
    )


@pytest.mark.thorough
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_gradients_of_fewer_sh_coefficients_are_finite_differences(degree):
    splats = scenes.ball(30, degree, size=0.15, degree=degree)
    assert_is_the_finite_difference(splats, scenes.camera(30), Options(), n=12)


@pytest.mark.thorough
def test_gradients_close_to_the_camera_where_slopes_are_clamped_are_finite_differences():
    splats = scenes.ball(40, 8, size=0.3)
    assert_is_the_finite_difference(splats, scenes.facing(30, 26), Options(near=0.05))


@pytest.mark.thorough
def test_gradients_to_the_centres_are_those_of_moving_the_principal_point():
    splats, camera = scenes.as_float64(scenes.ball(1, 1, size=0.1)), scenes.camera(40)
    found, g = of(splats, camera, dtype=np.float64), image_gradient(camera)

    def loss(dx, dy):
        # Far from the edge of the picture, cx and cy change nothing but the centres.
        moved = Camera(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx + dx, camera.cy + dy,
            camera.rotation, camera.translation,
        )  # fmt: skip
        return np.vdot(render(splats, moved, BACKGROUND, dtype=np.float64), g)

    h = 1e-6
    expected = [loss(h, 0) - loss(-h, 0), loss(0, h) - loss(0, -h)]
    np.testing.assert_allclose(found.centers[0], np.divide(expected, 2 * h), rtol=1e-6)


@pytest.mark.thorough
def test_float32_gradients_are_close_to_float64_ones():
    splats, camera = scenes.ball(1500, 4), scenes.camera(100)
    exact, ours = of(splats, camera, dtype=np.float64), of(splats, camera)
    for name in (*scenes.FIELDS, "centers"):
        a, b = getattr(exact, name), getattr(ours, name)
        assert b.dtype == np.float32
        assert np.linalg.norm(a - b) <= 1e-5 * np.linalg.norm(a), name


def test_gradients_are_the_same_for_any_number_of_threads():
    splats, camera = scenes.ball(3000, 3), scenes.camera(150)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        single = of(splats, camera)
    finally:
        numba.set_num_threads(before)
    assert_equal(single, of(splats, camera))


def test_gradients_in_any_number_of_chunks_are_the_same(monkeypatch):
    splats, camera = scenes.ball(500, 3, size=0.2), scenes.camera(90)
    whole = of(splats, camera)
    monkeypatch.setattr(tiles_module, "CHUNK", 1000)
    assert_equal(whole, of(splats, camera))


@pytest.mark.parametrize("n_blocks", [2, 3, 7])
def test_pictures_and_gradients_in_any_number_of_blocks_are_the_same(monkeypatch, n_blocks):
    splats, camera = scenes.ball(500, 3, size=0.2), scenes.camera(90)
    image, whole = render(splats, camera, BACKGROUND), of(splats, camera)
    monkeypatch.setattr(tiles_module, "_MIN_BLOCK", 1)
    monkeypatch.setattr(tiles_module, "n_threads", lambda: n_blocks)
    drawing = draw(splats, camera, BACKGROUND)
    assert len(drawing.tiles.block_ends) == n_blocks
    np.testing.assert_array_equal(drawing.image, image)
    assert_equal(whole, of(splats, camera))
    monkeypatch.setattr(tiles_module, "CHUNK", 1000)
    assert_equal(whole, of(splats, camera))


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("name", LONELY)
def test_gradients_of_an_extreme_splat_are_finite(name, antialiased):
    options = Options(antialiased=antialiased)
    assert_finite(of(LONELY[name], scenes.facing(), options))
    company = scenes.joined(scenes.ball(40, 1, size=0.3), LONELY[name])
    assert_finite(of(company, scenes.camera(40), options))


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", scenes.FIELDS)
def test_a_splat_that_is_not_finite_has_zero_gradients_and_spoils_no_other(name, poison):
    splats, camera = scenes.ball(60, 2, size=0.3), scenes.camera(40)
    clean = of(splats.take(np.arange(60) != 33), camera)
    values = getattr(splats, name).copy()
    values[33, ...] = poison
    found = of(scenes.changed(splats, **{name: values}), camera)
    for field in (*scenes.FIELDS, "centers"):
        array = getattr(found, field)
        assert (array[33] == 0).all()
        np.testing.assert_array_equal(np.delete(array, 33, 0), getattr(clean, field))


def test_no_splat_and_no_visible_splat_have_zero_gradients():
    found = of(scenes.EMPTY, scenes.camera(20))
    assert found.means.shape == (0, 3)
    found = of(scenes.row(5, mean=(0, 0, -3)), scenes.facing())
    for field in (*scenes.FIELDS, "centers"):
        assert (getattr(found, field) == 0).all()


@pytest.mark.thorough
def test_a_million_splats_in_one_pixel_have_finite_gradients():
    splats = scenes.row(1_000_000, log_scale=(-9, -9, -9), logit=-5.5)
    assert_finite(of(splats, scenes.facing(1, 1)))


def test_a_gradient_of_another_shape_is_refused():
    splats, camera = scenes.ball(5), scenes.camera(20)
    drawing = draw(splats, camera)
    with pytest.raises(ValueError, match="shape"):
        gradients(drawing, splats, f32(np.zeros((19, 20, 3))))
    with pytest.raises(ValueError, match="4 splats"):
        gradients(drawing, splats.take(np.arange(4)), f32(np.zeros((20, 20, 3))))
