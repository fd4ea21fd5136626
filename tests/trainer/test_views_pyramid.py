"""Smaller pictures: every pixel is the mean of what it covers."""

import numpy as np
import pytest

from evogs_codec.render import Camera, Options, psnr, render
from evogs_codec.render.demo_scene import make_scene
from reference_trainer.data import View, at_scale
from reference_trainer.data.pyramid import area_average, on_shifted_grids
from tools.photos import shooting_cameras


def picture(height, width, seed=0):
    rng = np.random.Generator(np.random.PCG64(seed))
    return rng.random((height, width, 3), np.float32)


def view_of(height, width):
    camera = Camera.look_at((4, 1, 2), (0, 0, 0), width=width, height=height, fov_x=0.8)
    return View("v", camera, picture(height, width))


@pytest.mark.parametrize("factor", [1, 2, 4, 8])
def test_a_level_of_the_pyramid_is_the_mean_of_squares(factor):
    view = view_of(16, 24)
    small = at_scale(view, factor)
    means = view.image.reshape(16 // factor, factor, 24 // factor, factor, 3).mean((1, 3))
    np.testing.assert_allclose(small.image, means, atol=1e-6)
    assert small.image.dtype == np.float32
    assert (small.camera.height, small.camera.width) == (16 // factor, 24 // factor)
    assert small.camera.fx == view.camera.fx / factor
    assert small.name == "v"


@pytest.mark.parametrize("height", [7, 8, 13, 31])
@pytest.mark.parametrize("factor", [2, 4, 8])
def test_sides_that_do_not_divide_keep_the_mean_and_the_field_of_view(height, factor):
    view = view_of(height, 29)
    small = at_scale(view, factor)
    np.testing.assert_allclose(small.image.mean((0, 1)), view.image.mean((0, 1)), atol=1e-6)
    assert small.camera.height == max(1, round(height / factor))
    ray = (view.camera.width - view.camera.cx) / view.camera.fx
    assert (small.camera.width - small.camera.cx) / small.camera.fx == pytest.approx(ray)


def test_a_pixel_on_a_border_counts_by_the_share_covered():
    image = np.arange(3, dtype=np.float32).reshape(1, 3, 1)
    np.testing.assert_allclose(area_average(image, 2, 1).ravel(), [1 / 3, 5 / 3], rtol=1e-6)


def test_a_constant_picture_stays_exactly_constant():
    for n in range(1, 41):
        assert np.all(area_average(np.ones((41, 41, 3), np.float32), n, n) == 1)


def test_a_smaller_camera_sees_the_smaller_picture():
    scene, camera = make_scene(2000), shooting_cameras(1, 128)[0]
    # A pixel blurs splats by its own size, unless told to keep their opacity in proportion.
    options = Options(antialiased=True)
    full = np.clip(render(scene, camera, (1, 1, 1), options=options), 0, 1).astype(np.float32)
    small = at_scale(View("v", camera, full), 4)
    again = np.clip(render(scene, small.camera, (1, 1, 1), options=options), 0, 1)
    assert psnr(again, small.image) > 33
    assert psnr(np.roll(again, 1, axis=1), small.image) < 25


def test_impossible_sizes_are_refused():
    view = view_of(4, 4)
    with pytest.raises(ValueError, match="factor is 0"):
        at_scale(view, 0)
    with pytest.raises(ValueError, match="do not average to 5"):
        area_average(view.image, 5, 4)
    with pytest.raises(ValueError, match=r"expected float32 \(4, 4, 3\)"):
        View("v", view.camera, picture(4, 5))


def test_shifted_grids_are_what_a_camera_half_a_pixel_aside_sees():
    scene, camera = make_scene(2000), shooting_cameras(1, 96)[0]
    options = Options(antialiased=True)
    full = np.clip(render(scene, camera, (1, 1, 1), options=options), 0, 1).astype(np.float32)
    finer = View("v", camera, full)
    small = at_scale(finer, 4)
    found = on_shifted_grids((small,), (at_scale(finer, 2),))
    assert found[0] is small
    n = small.camera.width
    assert [v.image.shape[:2] for v in found[1:]] == [(n, n - 1), (n - 1, n), (n - 1, n - 1)]
    drawn = [
        np.clip(render(scene, v.camera, (1, 1, 1), options=options), 0, 1).astype(np.float32)
        for v in found
    ]
    plain, *others = [psnr(image, v.image) for image, v in zip(drawn, found, strict=True)]
    assert min(others) > plain - 0.5
    for view in found[1:]:
        unmoved = drawn[0][: view.camera.height, : view.camera.width]
        assert psnr(unmoved, view.image) < plain - 2


@pytest.mark.parametrize(("height", "width"), [(16, 24), (13, 29), (27, 31)])
def test_pixels_of_shifted_grids_are_means_of_what_they_cover(height, width):
    finer = view_of(height, width)
    _, right, below, both = on_shifted_grids((at_scale(finer, 2),), (finer,))
    across, down = width / (right.camera.width + 1), height / (right.camera.height)
    # A picture that rises by 1 a pixel: its means are the middles of what they cover.
    ramp = np.empty((height, width, 3), np.float32)
    ramp[..., 0], ramp[..., 1:] = np.arange(width) + 0.5, 0
    (_, found, *_) = on_shifted_grids((at_scale(finer, 2),), (View("v", finer.camera, ramp),))
    middles = (np.arange(found.camera.width) + 1) * across
    expected = np.tile(middles, (found.camera.height, 1))
    np.testing.assert_allclose(found.image[:, :, 0], expected, atol=0.03)  # sides that are odd
    assert below.camera.height == both.camera.height == round(height / down) - 1
    assert (both.camera.cx, both.camera.cy) == (right.camera.cx, below.camera.cy)


def test_views_without_a_picture_of_half_the_pixels_have_no_shifted_grids():
    view = view_of(16, 16)
    assert on_shifted_grids((view, view), ()) == (view, view)
    assert on_shifted_grids((view,), (view,)) == (view,)
    assert len(on_shifted_grids((at_scale(view, 16),), (view,))) == 1  # one pixel
