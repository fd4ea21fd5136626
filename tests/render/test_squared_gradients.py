"""Squared changes of pictures: those of all gradients, number by number of the picture."""

import numba
import numpy as np
import pytest

from evogs_codec.render import draw, gradients
from evogs_codec.render import tiles as tiles_module
from evogs_codec.render.gradients import add_squared_gradients
from evogs_codec.render.options import DEFAULT
from tests.render import scenes
from tests.render.scenes import BACKGROUND
from tests.render.test_gradients import LOOKS
from tests.render.test_traps import LONELY


def squares(splats, camera, options=DEFAULT, dtype=np.float64, shown=None, background=BACKGROUND):
    """By name, the mean squared change of the picture to that of each number."""
    drawing = draw(splats, camera, background, options=options, dtype=dtype)
    totals = [np.zeros(getattr(splats, name).shape, dtype) for name in scenes.FIELDS]
    add_squared_gradients(totals, drawing, splats, shown)
    return dict(zip(scenes.FIELDS, totals, strict=True))


def one_by_one(splats, camera, options, shown):
    """The same, by the gradient of each number of the picture."""
    drawing = draw(splats, camera, BACKGROUND, options=options, dtype=np.float64)
    totals = {name: np.zeros(getattr(splats, name).shape) for name in scenes.FIELDS}
    for place in np.ndindex(drawing.image.shape):
        one = np.zeros_like(drawing.image)
        one[place] = shown[place[:2]]
        found = gradients(drawing, splats, one)
        for name, total in totals.items():
            total += getattr(found, name) ** 2 / drawing.image.size
    return totals


@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize("degree", [0, 3])
def test_they_are_those_of_the_gradients_of_each_number_of_the_picture(look, degree):
    splats = scenes.as_float64(scenes.ball(25, 3, size=0.15, degree=degree))
    camera = scenes.camera(14, 11)
    shown = np.random.default_rng(0).random((11, 14))
    found = squares(splats, camera, LOOKS[look], shown=shown)
    for name, expected in one_by_one(splats, camera, LOOKS[look], shown).items():
        assert expected.max() > 1e-6, name
        if name == "means" and degree:
            # What a moved splat changes by its colour is added as if it were in other pixels. The
            # square of a sum is at most twice the sum of the squares.
            assert (expected <= 2 * found[name]).all()
            assert abs(expected.sum() / found[name].sum() - 1) < 0.05
        else:
            np.testing.assert_allclose(found[name], expected, 1e-9, expected.max() * 1e-12)


def test_close_to_the_camera_where_slopes_are_clamped_they_are():
    rng = np.random.default_rng(0)
    splats = scenes.as_float64(scenes.ball(30, 5, size=0.3, degree=0))
    splats.means[:] = rng.normal(size=(30, 3)) * (1.5, 1.5, 0.2) + (0, 0, 0.8)
    camera = scenes.facing(12, 10)
    shown = np.ones((10, 12))
    found = squares(splats, camera)
    for name, expected in one_by_one(splats, camera, DEFAULT, shown).items():
        np.testing.assert_allclose(found[name], expected, 1e-9, expected.max() * 1e-12)


def test_float32_ones_are_close_to_float64_ones():
    splats, camera = scenes.ball(200, 4), scenes.camera(80)
    exact = squares(scenes.as_float64(splats), camera)
    for name, found in squares(splats, camera, dtype=np.float32).items():
        assert found.dtype == np.float32
        assert np.abs(found - exact[name]).max() < 1e-4 * exact[name].max(), name


def test_needles_are_as_exact_as_others():
    """A needle across a corner of the picture: far along it, large numbers cancel."""
    needle = scenes.row(
        mean=(0.3, 0.2, 3), quat=(0.92, 0.1, 0.05, 0.38), log_scale=(0.5, -7.0, -7.0)
    )
    camera = scenes.facing()
    exact = squares(scenes.as_float64(needle), camera)
    for name, found in squares(needle, camera, dtype=np.float32).items():
        np.testing.assert_allclose(found, exact[name], 1e-3, exact[name].max() * 1e-6)


def test_they_are_the_same_for_any_number_of_threads():
    splats, camera = scenes.ball(3000, 3), scenes.camera(150)
    expected = squares(splats, camera, dtype=np.float32)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        single = squares(splats, camera, dtype=np.float32)
    finally:
        numba.set_num_threads(before)
    for name, found in single.items():
        np.testing.assert_array_equal(found, expected[name])


def test_before_a_picture_they_are_those_of_its_colours():
    splats = scenes.as_float64(scenes.ball(20, 3, size=0.15, degree=0))
    camera = scenes.camera(14, 11)
    grey = np.full((11, 14, 3), BACKGROUND)
    one, other = (squares(splats, camera, background=behind) for behind in (BACKGROUND, grey))
    for name, found in one.items():
        np.testing.assert_allclose(found, other[name], 1e-12)
    black = squares(splats, camera, background=(0.0, 0.0, 0.0))
    assert not np.allclose(black["opacity_logits"], one["opacity_logits"])


def test_in_any_number_of_chunks_they_are_the_same(monkeypatch):
    splats, camera = scenes.ball(300, 4), scenes.camera(80)
    expected = squares(splats, camera, dtype=np.float32)
    monkeypatch.setattr(tiles_module, "CHUNK", 100)
    for name, found in squares(splats, camera, dtype=np.float32).items():
        np.testing.assert_array_equal(found, expected[name])


@pytest.mark.parametrize("name", LONELY)
@pytest.mark.parametrize("antialiased", [False, True])
def test_those_of_an_extreme_splat_are_finite(name, antialiased):
    found = squares(
        LONELY[name], scenes.facing(), LOOKS["antialiased" if antialiased else "classic"],
        dtype=np.float32,
    )  # fmt: skip
    for name, of_one in found.items():
        assert np.isfinite(of_one).all(), name
        assert of_one.min() >= 0, name


def test_a_splat_of_size_zero_is_worth_what_a_thin_one_is():
    flat = scenes.row(log_scale=(-1, -1, -1000))
    found = squares(scenes.as_float64(flat), scenes.facing())
    thin = squares(scenes.as_float64(scenes.row(log_scale=(-1, -1, -40))), scenes.facing())
    for name, of_one in found.items():
        np.testing.assert_allclose(of_one, thin[name], 1e-9, of_one.max() * 1e-12)


def test_a_splat_that_is_not_seen_has_none():
    behind = scenes.row(mean=(0, 0, -3))
    for of_one in squares(behind, scenes.facing()).values():
        assert not of_one.any()
    for of_one in squares(scenes.row(), scenes.facing(), shown=np.zeros((32, 48))).values():
        assert not of_one.any()


def test_what_is_behind_a_splat_may_be_as_bright_as_float32_goes():
    front = scenes.row(mean=(0, 0, 2), quat=(1, 0.2, 0.3, 0.4), log_scale=(-2, -2.5, -3), logit=0.0)
    behind = scenes.row(mean=(0, 0, 3), log_scale=(-1, -1, -1), colour=1e21)
    both = scenes.joined(front, behind)
    for name, found in squares(both, scenes.facing(), dtype=np.float32).items():
        assert np.isfinite(found).all()
        assert found[0].max() > 0, name


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_where_place_changes_nothing_positions_are_worth_what_their_colour_is(degree):
    splats = scenes.as_float64(scenes.ball(6, 3, degree=degree))
    splats.log_scales[:], splats.opacity_logits[:] = 12, -1.5
    camera = scenes.camera(8, 6)
    expected = one_by_one(splats, camera, DEFAULT, np.ones((6, 8)))["means"]
    assert expected.max() > 0
    np.testing.assert_allclose(squares(splats, camera)["means"], expected, 1e-9)


def test_a_veil_of_another_shape_is_refused():
    drawing = draw(scenes.row(), scenes.facing())
    totals = [np.zeros(getattr(scenes.row(), name).shape, np.float32) for name in scenes.FIELDS]
    with pytest.raises(ValueError, match=r"shown of shape \(48, 32\)"):
        add_squared_gradients(totals, drawing, scenes.row(), np.ones((48, 32)))


def test_they_are_added_to_totals():
    once = squares(scenes.row(), scenes.facing(), dtype=np.float32)
    totals = [np.ones_like(one) for one in once.values()]
    drawing = draw(scenes.row(), scenes.facing(), BACKGROUND)
    add_squared_gradients(totals, drawing, scenes.row())
    for total, one in zip(totals, once.values(), strict=True):
        np.testing.assert_allclose(total, 1 + one, 1e-6)


def test_a_drawing_of_other_splats_is_refused():
    drawing = draw(scenes.row(2), scenes.facing())
    totals = [np.zeros(getattr(scenes.row(), name).shape, np.float32) for name in scenes.FIELDS]
    with pytest.raises(ValueError, match="1 splats, the drawing is of 2"):
        add_squared_gradients(totals, drawing, scenes.row())
