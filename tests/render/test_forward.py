"""The kernels draw what the definition says, and the same for any number of threads."""

import numba
import numpy as np
import pytest

from evogs_codec.render import Options, draw, render, render_counted
from evogs_codec.render import tiles as tiles_module
from evogs_codec.render.options import ALPHA_MIN, DEFAULT, T_MIN
from evogs_codec.render.oracle import project_one, render_exactly
from tests.render import scenes
from tests.render.scenes import BACKGROUND

TOLERANCE = {np.float32: 1e-5, np.float64: 1e-12}
LOOKS = {
    "classic": Options(),
    "antialiased": Options(antialiased=True),
    "far near plane, soft clamp, wide dilation": Options(near=2.2, alpha_max=0.5, dilation=1.0),
}


def assert_agrees(splats, camera, options=DEFAULT, dtype=np.float32):
    picture = render_exactly(splats, camera, BACKGROUND, options=options)
    image, counts = render_counted(splats, camera, BACKGROUND, options=options, dtype=dtype)
    assert image.dtype == dtype
    assert np.isfinite(image).all()
    scale = np.maximum(1, np.abs(picture.image))
    difference = (np.abs(image - picture.image) / scale).max(axis=2)
    assert difference[~picture.doubtful].max(initial=0) <= TOLERANCE[dtype]
    assert np.mean(difference > TOLERANCE[dtype]) <= 1e-4
    assert np.abs(image - picture.image).max() <= largest_flip(splats, camera, options)
    assert counts.n_non_finite == picture.n_non_finite
    assert counts.n_drawn + counts.n_invisible + counts.n_non_finite == len(splats.means)
    return picture


def largest_flip(splats, camera, options):
    """What one decision that goes the other way can change: a splat at 1/255, or the last one."""
    projected = (projected_or_none(splats, i, camera, options) for i in range(len(splats.means)))
    colours = [splat.colour.max() for splat in projected if splat is not None]
    most = max([*colours, *BACKGROUND])
    return most * max(ALPHA_MIN, T_MIN / (1 - options.alpha_max)) * (1 + 1e-4)


def projected_or_none(splats, i, camera, options):
    try:
        return project_one(splats, i, camera, options)
    except ArithmeticError:
        return None


@pytest.mark.parametrize(
    "dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize(
    ("n", "width", "height", "size"),
    [pytest.param(1500, 64, 59, 0.05, marks=pytest.mark.thorough), (250, 150, 130, 0.2)],
)
def test_the_kernels_agree_with_the_oracle(n, width, height, size, look, dtype):
    splats = scenes.ball(n, n, size=size)
    assert_agrees(splats, scenes.camera(width, height), LOOKS[look], dtype)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_sh_degree_agrees_with_the_oracle(degree):
    assert_agrees(scenes.ball(300, degree, degree=degree), scenes.camera(40))


def test_a_camera_inside_the_scene_agrees_with_the_oracle():
    splats = scenes.ball(800, 5, size=0.2)
    assert_agrees(splats, scenes.facing(70, 50), Options(near=0.01))


def test_most_pixels_of_the_comparison_are_beyond_doubt():
    picture = render_exactly(scenes.ball(1500, 1), scenes.camera(64), BACKGROUND)
    assert 0 < picture.doubtful.mean() < 0.2


def test_a_picture_is_the_same_for_any_number_of_threads():
    splats, camera = scenes.ball(5000, 3), scenes.camera(200)
    before = numba.get_num_threads()
    pictures = []
    try:
        for n_threads in range(1, before + 1):
            numba.set_num_threads(n_threads)
            drawing = draw(splats, camera, BACKGROUND)
            pictures.append((drawing.image, drawing.transmittance, drawing.last))
    finally:
        numba.set_num_threads(before)
    for other in pictures[1:]:
        for ours, theirs in zip(pictures[0], other, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_picture_is_the_same_in_any_number_of_chunks(monkeypatch):
    splats, camera = scenes.ball(2000, 3), scenes.camera(100, 70)
    whole, counts = render_counted(splats, camera, BACKGROUND)
    for chunk in (1, 100, counts.n_intersections // 3):
        monkeypatch.setattr(tiles_module, "CHUNK", chunk)
        np.testing.assert_array_equal(render(splats, camera, BACKGROUND), whole)


def test_lists_are_in_depth_order_and_equal_depths_in_order_of_index():
    rng = np.random.default_rng(0)
    depths = rng.integers(1, 50, 4000) / 7
    status = (rng.random(4000) < 0.2).astype(np.uint8)
    order = tiles_module.depth_order(depths, status)
    drawn = np.flatnonzero(status == 0)
    np.testing.assert_array_equal(order, drawn[np.argsort(depths[drawn], kind="stable")])


def test_tile_lists_hold_every_splat_that_contributes():
    splats, camera = scenes.ball(400, 9, size=0.15), scenes.camera(80)
    drawing = draw(splats, camera)
    (chunk,) = drawing.tiles.chunks()
    for tile in range(len(chunk.offsets) - 1):
        listed = set(chunk.entries[chunk.offsets[tile] : chunk.offsets[tile + 1]].tolist())
        x = np.arange(16) + tile % drawing.tiles.columns * 16 + 0.5
        y = np.arange(16) + tile // drawing.tiles.columns * 16 + 0.5
        for i in np.flatnonzero(drawing.status == 0):
            mx, my, weight, slope, curve, log_opacity = drawing.tiles.records[i, :6]
            dx, dy = x[None, :] - mx, y[:, None] - my
            t = log_opacity - (weight * (dx - slope * dy)) ** 2 - curve * dy**2
            inside = (x < camera.width)[None, :] & (y < camera.height)[:, None]
            assert i in listed or not (t[inside] > -np.log2(255)).any()


def test_a_background_shows_where_nothing_is():
    image = render(scenes.EMPTY, scenes.camera(20), BACKGROUND)
    np.testing.assert_array_equal(image, np.broadcast_to(scenes.f32(BACKGROUND), (20, 20, 3)))


def test_one_opaque_splat_has_the_colour_and_alpha_of_the_formulas():
    splats = scenes.row(mean=(0, 0, 4), logit=3.0, log_scale=(-1, -1, -1), colour=0.7)
    camera = scenes.facing(33, 33)
    image = render(splats, camera, (1, 0, 0), dtype=np.float64)
    colour = 0.5 + 0.28209479177387814 * float(np.float32(0.7))
    variance = (33 * np.exp(-1.0) / 4) ** 2 + 0.3
    alpha = 1 / (1 + np.exp(-3.0)) * np.exp(-0.5 * 5**2 / variance)
    expected = alpha * colour + (1 - alpha) * np.array([1, 0, 0])
    np.testing.assert_allclose(image[16, 21], expected, rtol=1e-12)


def test_an_option_out_of_range_is_refused():
    for wrong in ({"near": 0}, {"alpha_max": 1.0}, {"dilation": 0}, {"near": float("nan")}):
        with pytest.raises(ValueError, match="expected"):
            Options(**wrong)
