"""Integers of least cost: compiled and in numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogs_codec.encoding import rate_distortion
from evogs_codec.encoding.rate_distortion import SPAN, cheapest

loops = pytest.importorskip("evogs_codec.encoding.rate_loops", reason="numba is an extra")


def in_numpy(u, weights):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rate_distortion, "_loops", lambda: None)
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
