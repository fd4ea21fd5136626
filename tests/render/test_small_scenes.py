"""Scenes whose unit is large, so that all of one is nearer than what is cut off of others."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import decode, encode_scene
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.framing import options_for
from evogs_codec.render.options import DEFAULT
from evogs_codec.render.views import Views
from tests.support.lifted_scenes import with_channels


def scaled(scene, factor):
    means = scene.means * np.float32(factor)
    return replace(scene, means=means, log_scales=scene.log_scales + np.float32(np.log(factor)))


@pytest.fixture(scope="module")
def scene():
    return make_scene(800)


@pytest.mark.parametrize("factor", [1, 30])
def test_scenes_of_usual_size_are_rendered_as_others_render_them(scene, factor):
    assert options_for(scaled(scene, factor)) == DEFAULT


def test_a_scene_of_a_centimetre_looks_as_it_does_in_metres(scene):
    large, small = (Views.of(scaled(scene, k), n_views=2) for k in (1, 1e-3))
    for a, b in zip(large.pictures, small.pictures, strict=True):
        assert (b != 1).any(), "not all of it is cut off"
        np.testing.assert_allclose(a, b, atol=2e-3)


@pytest.mark.thorough
def test_scenes_of_a_centimetre_are_encoded_as_exactly_as_in_metres():
    """In the mean of scenes: of 800 splats, sizes move by 3 % if a scene is scaled by 1.001."""
    metres: list[tuple[int, float]] = []
    centimetres: list[tuple[int, float]] = []
    for seed in range(6):
        scene = make_scene(800, seed)
        for found, factor in ((metres, 1), (centimetres, 1e-3)):
            one = scaled(scene, factor)
            data = encode_scene(one, levels=3)
            psnr = Views.of(one, n_views=4).psnr(decode(data).leaves())
            found.append((len(data), psnr))
    sizes, decibels = (np.mean(centimetres, axis=0) - np.mean(metres, axis=0)).tolist()
    assert abs(sizes / np.mean(metres, axis=0)[0]) < 0.01
    assert abs(decibels) < 0.25


def test_a_scene_in_one_place_or_without_splats_has_the_options_of_others(scene):
    assert options_for(with_channels(scene, means=np.zeros(3))) == DEFAULT
    assert options_for(scene.take(slice(0, 0))) == DEFAULT
