"""Integers of least cost: compiled and in numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec import PRESETS, lift
from evogs_codec.encoding import apply_step, closed_loop, rate_distortion, sibling_refines
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.rate_distortion import SPAN, cheapest
from evogs_codec.encoding.sensitivity import StepWeights
from evogs_codec.encoding.sibling_refines import cheapest_differences
from evogs_codec.model.siblings import Siblings
from evogs_codec.render.demo_scene import make_scene

loops = pytest.importorskip("evogs_codec.encoding.rate_loops", reason="numba is an extra")


def in_numpy(u, weights):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rate_distortion, "loops", lambda: None)
        return cheapest(u, weights)


def numbers(seed, n, scale):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(3, n)) * scale * np.array([[1.0], [0.1], [30.0]])
    u[:, ::7] = np.rint(u[:, ::7])  # ties, and zeros
    u[:, 3::11] = np.rint(u[:, 3::11]) + 0.5
    return u, 10.0 ** rng.uniform(-6, 3, u.shape)


@given(st.integers(0, 2**32), st.integers(0, 300), st.sampled_from([0.01, 1.0, 40.0, 5000.0]))
def test_compiled_loops_find_the_integers_of_numpy(seed, n, scale):
    u, weights = numbers(seed, n, scale)
    assert np.array_equal(cheapest(u, weights), in_numpy(u, weights))


@pytest.mark.parametrize("find", [cheapest, in_numpy])
def test_what_errors_are_worth_decides(find):
    u, weights = numbers(1, 2000, 3.0)
    assert np.abs(find(u, weights + 1e9) - u).max() <= 0.5
    assert np.count_nonzero(find(u, 1e-9 * weights)) < 0.01 * u.size


@pytest.mark.parametrize("find", [cheapest, in_numpy])
def test_integers_beyond_the_span_are_rounded(find):
    u = np.array([[*np.zeros(50), SPAN + 0.4, -3.0 * SPAN - 0.2, 1e30]])
    assert np.array_equal(find(u, np.zeros_like(u)), np.rint(u))


@pytest.mark.parametrize("n_levels", [1, 3])
def test_compiled_loops_quantise_as_numpy_does(n_levels, monkeypatch):
    tree = lift(make_scene(400), n_levels)
    tiles = arrange(tree, 2)
    weights = [[of_ones(step) for step in tile.steps] for tile in tiles]
    found = []
    for is_compiled in (True, False):
        if not is_compiled:
            monkeypatch.setattr(closed_loop, "loops", lambda: None)
            monkeypatch.setattr(apply_step, "loops", lambda: None)
            monkeypatch.setattr(sibling_refines, "loops", lambda: None)
            monkeypatch.setattr(rate_distortion, "loops", lambda: None)
        found.append(quantise(tiles, n_levels, PRESETS["scene"], weights=weights, price=1e-6))
    for one, other in zip(*(tree.tiles for tree in found), strict=True):
        for a, b in zip(one.steps, other.steps, strict=True):
            assert np.array_equal(a.psi, b.psi)
            assert np.array_equal(a.alpha, b.alpha)
            assert np.array_equal(a.adds, b.adds)


def of_ones(step):
    shape = 5 + 3, step.psi.shape[1]
    new = np.ones((8, step.n_new), np.float32)
    return StepWeights(step.level, np.ones(shape, np.float32), new)


@given(st.integers(0, 2**32), st.integers(2, 60))
def test_compiled_loops_find_the_differences_of_numpy(seed, n):
    rng = np.random.default_rng(seed)
    born_from = np.array([-1, *(rng.integers(-1, k) for k in range(1, n))])
    siblings = Siblings.of(np.arange(n, dtype=np.int32), born_from)
    u, weights = numbers(seed, n, 3.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sibling_refines, "loops", lambda: None)
        expected = cheapest_differences(u, weights, siblings)
    for a, b in zip(cheapest_differences(u, weights, siblings), expected, strict=True):
        assert np.array_equal(a, b)
