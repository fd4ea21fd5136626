"""Errors per group: of splats that correspond, whatever their order and the names of their axes."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="the package renders")
from evogs_codec import SplatParams
from evogs_codec.comparison import group_errors as module
from evogs_codec.comparison.group_errors import group_errors
from evogs_codec.lifting.orientations import N_TURNS, PERMUTE, TURNS, multiply
from evogs_codec.render.demo_scene import make_scene


@pytest.fixture(scope="module")
def scene():
    return make_scene(500)


def with_channels(scene, change):
    channels = scene.channels()
    change(channels)
    return SplatParams.from_channels(channels)


def found(splats, reference):
    errors = group_errors(splats, reference)
    assert errors is not None
    return errors, {one.group: one for one in errors.groups}


def shuffled(scene, seed=0):
    return scene.take(np.random.default_rng(seed).permutation(len(scene)))


def test_equal_scenes_have_no_error_in_any_order(scene):
    for other, matching in ((scene, "same count and order"), (shuffled(scene), "nearest match")):
        errors, groups = found(other, scene)
        assert (errors.matching, errors.n_compared) == (matching, 500)
        assert all(one.rms == one.largest == 0 for one in groups.values())


def test_the_names_of_the_axes_and_the_sign_of_a_quaternion_make_no_difference(scene):
    turn = np.arange(len(scene)) % N_TURNS
    quats = multiply(scene.quats.T.astype(np.float64), TURNS[turn].T).T
    scales = np.take_along_axis(scene.log_scales, PERMUTE[turn], axis=1)
    other = SplatParams(
        scene.means,
        (-3 * quats).astype(np.float32),
        scales,
        scene.opacity_logits,
        scene.sh,
    )
    _, groups = found(other, scene)
    assert groups["rotation"].largest < 0.001
    assert groups["scale"].largest == 0


def test_each_group_has_its_own_error_in_its_own_unit(scene):
    def moved(channels):
        channels[0] += 0.03
        channels[1] += 0.04
        channels[7:10] += 0.5
        channels[11:14] += 0.25

    errors, groups = found(with_channels(scene, moved), scene)
    assert errors.matching == "same count and order"
    assert groups["position"].rms == pytest.approx(0.05, rel=1e-3)
    assert groups["rotation"].largest == 0
    assert groups["scale"].largest == pytest.approx(0.5, rel=1e-3)
    assert groups["opacity"].rms == 0
    assert groups["sh"].largest == pytest.approx(0.25, rel=1e-3)
    assert groups["sh"].rms == pytest.approx(0.25 / 4, rel=1e-3)  # of 16 coefficients, one moved


def test_a_turn_is_counted_in_degrees(scene):
    half = np.radians(7) / 2
    turn = np.array([np.cos(half), 0, np.sin(half), 0])[:, None]
    quats = multiply(scene.quats.T.astype(np.float64), turn).T.astype(np.float32)
    other = SplatParams(scene.means, quats, scene.log_scales, scene.opacity_logits, scene.sh)
    _, groups = found(other, scene)
    assert groups["rotation"].rms == pytest.approx(7, rel=1e-3)
    assert groups["rotation"].largest == pytest.approx(7, rel=1e-3)


def test_opacity_counts_after_activation(scene):
    opaque = with_channels(scene, lambda channels: channels.__setitem__(10, 12.0))
    _, groups = found(with_channels(scene, lambda c: c.__setitem__(10, 18.0)), opaque)
    assert groups["opacity"].largest < 1e-5


def test_bands_that_one_scene_lacks_are_zeros_there(scene):
    flat = SplatParams(
        scene.means, scene.quats, scene.log_scales, scene.opacity_logits, scene.sh[:, :1]
    )
    _, groups = found(flat, scene)
    assert groups["sh"].largest == pytest.approx(np.abs(scene.sh[:, 1:]).max())
    assert found(scene, flat)[1]["sh"] == groups["sh"]


def test_scenes_of_other_counts_are_matched_by_the_nearest(scene):
    errors, groups = found(scene.take(slice(0, 300)), shuffled(scene))
    assert (errors.matching, errors.n_compared) == ("nearest match", 300)
    assert all(one.largest == 0 for one in groups.values())


def test_splats_of_one_place_are_told_apart_by_the_rest(scene):
    both = [scene.channels(), scene.channels()]
    both[1][11:14] += 1.0
    twice = SplatParams.from_channels(np.concatenate(both, axis=1))
    _, groups = found(shuffled(twice), twice)
    assert groups["sh"].largest == 0


def test_of_many_splats_some_are_compared(scene, monkeypatch):
    monkeypatch.setattr(module, "MAX_COMPARED", 100)
    errors, _ = found(scene, scene)
    assert (errors.matching, errors.n_compared) == (
        "same count and order, 100 of 500 splats",
        100,
    )


def test_scenes_without_splats_have_no_errors(scene):
    nothing = scene.take(slice(0, 0))
    assert group_errors(nothing, scene) is None
    assert group_errors(scene, nothing) is None
    broken = with_channels(scene, lambda channels: channels.__setitem__((0, slice(0, 9)), np.nan))
    assert found(broken, scene)[0].n_compared == 491
