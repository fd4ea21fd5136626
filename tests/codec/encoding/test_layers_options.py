"""Layers of precision: scenes of every kind, with every option, and what cannot be done."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from numpy.testing import assert_array_equal

from evogs_codec import (
    InputError,
    SplatParams,
    decode,
    encode_scene,
    encode_scene_with_order,
    encode_tree,
    lift,
    read_directory,
)
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.layers import MAX_LAYERS, Layered, Layering
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.encoding.write import write
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views
from tests.support.layered import (
    N_LEVELS,
    PRICE,
    SETTINGS,
    aim,
    at_a_price,
    dropping,
    psnr,
    scene,
    stream,
    views_of,
)
from tests.support.quanta import in_quanta
from tests.support.shared_scenes import shared_scene, shared_tree

# --- scenes and options ---------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_same_bytes_twice():
    assert aim(layers=2).at_psnr(40) == stream(2)


def test_a_palette_is_as_exact_as_in_one_layer_because_no_layer_refines_it():
    _, tree = shared_tree(shared_scene(600, 30), N_LEVELS)
    tiles = arrange(tree, 1)
    importance = Importance.of(tiles, N_LEVELS, views_of(tree.leaves()).sensitivity)
    found = Layered.of(tiles, N_LEVELS, importance, Layering(3)).steps(PRICE, 1.0)
    assert_array_equal(found[0, 5:], importance.steps(PRICE, 1.0)[0, 5:])
    assert np.all(found[0, :5] > importance.steps(PRICE, 1.0)[0, :5])


@pytest.mark.thorough
@pytest.mark.parametrize("layers", [2, 3])
def test_a_scene_with_a_palette_meets_its_target_in_layers(layers):
    splats = shared_scene(600, 30)
    cameras = views_of(splats).cameras
    found = encode_scene_with_order(
        splats, levels=N_LEVELS, target_psnr=45, layers=layers, cameras=cameras, effort=1
    )
    one = encode_scene(splats, levels=N_LEVELS, target_psnr=45, cameras=cameras, effort=1)
    assert read_directory(found.data).has_palette
    assert views_of(splats).psnr(decode(found.data).leaves()) == pytest.approx(45, abs=0.2)
    assert len(found.data) < 1.2 * len(one)


@pytest.mark.parametrize("n_tiles", [2, pytest.param(5, marks=pytest.mark.thorough)])
def test_several_tiles(n_tiles):
    price = 2e-9  # about 46 dB: at 54 dB and more one pixel of these views moves a PSNR by 5 dB
    one = at_a_price(scene()[0], 2, price)
    data = at_a_price(scene()[0], 2, price, n_tiles=n_tiles)
    found = decode(data, verify=True)
    assert len(found.directory.tiles) == n_tiles
    assert found.n_leaves == 400
    assert psnr(data) == pytest.approx(psnr(one), abs=1)


def test_a_tree_of_one_level():
    tree = lift(make_scene(300), 1)
    data = aim(tree, layers=3).at_psnr(40)
    found = decode(data, verify=True)
    assert (found.n_leaves, found.directory.n_levels) == (300, 3)
    assert psnr(data, tree) == pytest.approx(40, abs=0.2)


@pytest.mark.parametrize("n", [1, 2, 7])
@pytest.mark.parametrize("n_tiles", [1, 3])
def test_few_splats(n, n_tiles):
    tree = lift(make_scene(50).take(np.arange(n)), N_LEVELS)
    data = at_a_price(tree, 3, 1e-8, n_tiles=n_tiles)
    found = decode(data, verify=True)
    assert (found.n_leaves, found.directory.n_levels) == (n, N_LEVELS + 2)
    assert psnr(data, tree) > 35


def test_no_splats_have_no_layers():
    empty = make_scene(10).take(np.zeros(0, np.int64))
    with pytest.raises(InputError, match="without splats has nothing to aim at"):
        encode_scene(empty, target_psnr=40, layers=2)
    tree = scene()[0]
    gone = dropping(tree, np.arange(tree.n_leaves))
    data = write(Prepared(TargetEncoder(gone, SETTINGS, scene()[1], layers=2)).coded(PRICE))
    assert (decode(data).n_leaves, read_directory(data).n_levels) == (0, N_LEVELS)


@pytest.mark.parametrize("n_tiles", [pytest.param(1, marks=pytest.mark.thorough), 4])
def test_leaves_that_were_dropped_are_not_refined(n_tiles):
    """Half of the slots; of four tiles some have no leaves then."""
    tree = scene()[0]
    (*_, state) = tree.states()
    gone = np.flatnonzero(state.values[0] > np.median(state.values[0]))
    cut = dropping(tree, gone)
    data = at_a_price(cut, 3, n_tiles=n_tiles)
    found = decode(data, verify=True)
    assert found.n_leaves == cut.n_leaves == 200
    assert psnr(data, cut) > 38


@pytest.mark.thorough
def test_a_tree_that_was_trained_in_integers():
    tree = in_quanta()
    cameras = views_of(tree.leaves()).cameras
    data = encode_tree(tree, target_psnr=44, layers=2, effort=1, cameras=cameras)
    assert read_directory(data).n_levels == tree.n_levels + 1
    assert psnr(data, tree) == pytest.approx(44, abs=0.2)


@pytest.mark.thorough
def test_polishing_moves_the_last_layer_even_of_a_tree_of_one_level(recwarn):
    splats = make_scene(300)
    cameras = cameras_around(splats, "z", 64)
    for levels in (1, 3):
        options: dict[str, Any] = {
            "levels": levels,
            "target_psnr": 38,
            "layers": 2,
            "effort": 1,
            "cameras": cameras,
        }
        plain = encode_scene(splats, **options)
        found = encode_scene(splats, polish=60, **options)
        assert len(found) < len(plain)
        views = Views.of(lift(splats, levels).leaves(), cameras, descent=True)
        assert views.psnr(decode(found).leaves()) == pytest.approx(38, abs=0.2)
    assert not [warning for warning in recwarn if "polishing" in str(warning.message)]


@pytest.mark.thorough
def test_a_target_of_bytes():
    n_bytes = 9000
    data = aim(layers=3).at_bytes(n_bytes)
    assert 0.98 * n_bytes <= len(data) <= n_bytes
    assert read_directory(data).n_levels == N_LEVELS + 2


@pytest.mark.thorough
def test_more_effort_takes_no_more_bytes_for_the_same_splats():
    hard = replace(aim(layers=2), settings=replace(SETTINGS, zstd_level=19)).at_psnr(40)
    assert len(hard) <= len(stream(2))
    assert_array_equal(decode(hard).leaves().channels(), decode(stream(2)).leaves().channels())


def test_as_many_layers_as_there_may_be():
    data = at_a_price(scene()[0], MAX_LAYERS)
    assert read_directory(data).n_levels == N_LEVELS + MAX_LAYERS - 1
    assert psnr(data) > 38


# --- what cannot be done --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"layers": 2, "preset": "scene"}, ValueError, "layers do not go with a preset"),
        (
            {"layers": 2, "max_error": 0.1},
            ValueError,
            "layers do not go with a preset or max_error",
        ),
        ({"layers": 0, "target_psnr": 40}, ValueError, r"layers is 0, expected 1\.\.8"),
        ({"layers": 9, "target_psnr": 40}, ValueError, r"layers is 9, expected 1\.\.8"),
        ({"layers": 2.5, "target_psnr": 40}, ValueError, r"layers is 2\.5, expected 1\.\.8"),
        (
            {"layers": 2, "target_psnr": 40, "cameras": ()},
            InputError,
            "a target PSNR needs rendered views: there are no cameras",
        ),
        (
            {"layers": 2, "target_bytes": 4000, "cameras": ()},
            InputError,
            "several layers need rendered views: there are no cameras",
        ),
        (
            {"layers": 2, "target_psnr": 40, "levels": 64},
            InputError,
            "a tree of 64 levels in 2 layers has 65 levels: a stream has at most 64",
        ),
    ],
)
def test_what_does_not_go_with_layers_is_refused(options, error, words):
    with pytest.raises(error, match=words):
        encode_scene(make_scene(60), effort=1, **options)


def test_without_numba_layers_have_no_views(monkeypatch):
    monkeypatch.setattr("evogs_codec.scene.request.find_spec", lambda _: None)
    with pytest.raises(InputError, match="several layers need rendered views: numba is missing"):
        encode_scene(make_scene(60), target_bytes=4000, layers=2)


@pytest.mark.thorough
def test_an_encoder_without_views_refuses_layers_and_bounds_errors_without_them():
    plain = TargetEncoder(scene()[0], SETTINGS, layers=2)
    with pytest.raises(ValueError, match="layers need views"):
        plain.at_bytes(9000)
    assert read_directory(plain.within({"position": 0.01})).n_levels == N_LEVELS


def test_a_splat_far_away_and_numbers_at_their_limits_are_layered():
    channels = make_scene(200).channels().copy()
    channels[0:3, 0] = 1e6
    channels[7:10, 1] = 12
    channels[10, 2:4] = [80, -80]
    tree = lift(SplatParams.from_channels(channels), N_LEVELS)
    data = at_a_price(tree, 3)
    assert decode(data, verify=True).n_leaves == 200
