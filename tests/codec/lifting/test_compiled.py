"""Lifting in compiled loops: the trees are those of numpy, to the bit."""

import os
import sys
from contextlib import contextmanager

import numpy as np
import pytest

from evogs_codec.lifting import compiled, neighbours, pairing
from evogs_codec.lifting.compiled import dispatch
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.neighbours import nearest
from evogs_codec.render.demo_scene import make_scene
from tests.codec.lifting.test_lift import faint_but_large
from tests.codec.lifting.test_lift_extremes import ODD
from tests.support.lifted_scenes import surface, with_channels
from tests.support.odd_scenes import odd_scene

pytest.importorskip("evogs_codec.lifting.compiled.loops", reason="numba is an extra")

ALWAYS, NEVER = 0, 1 << 62  # nodes from which on the compiled loops are used


@contextmanager
def compiled_from(n_nodes):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatch, "MIN_COMPILED", n_nodes)
        patch.setattr(dispatch, "MIN_LOADING", n_nodes)
        yield


def assert_same(a, b):
    np.testing.assert_array_equal(a.leaf_of, b.leaf_of)
    for one, other in zip(a.tree.steps, b.tree.steps, strict=True):
        assert one.level == other.level
        for name in ("slots", "kinds", "psi", "alpha", "adds"):
            left, right = getattr(one, name), getattr(other, name)
            assert left.dtype == right.dtype
            assert left.tobytes() == right.tobytes(), name


def assert_both_lift_alike(splats, n_levels=5):
    with compiled_from(ALWAYS):
        by_loops = lift_with_order(splats, n_levels)
    with compiled_from(NEVER):
        assert_same(by_loops, lift_with_order(splats, n_levels))


@pytest.mark.parametrize("n", [0, 1, 2, 3, 10, 17])
def test_few_splats(n):
    assert_both_lift_alike(surface(n))


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_surfaces_of_all_degrees(sh_degree):
    assert_both_lift_alike(surface(1500, sh_degree))


@pytest.mark.parametrize("name", ODD)
def test_odd_scenes(name):
    assert_both_lift_alike(with_channels(surface(500), **ODD[name]), 4)


def test_odd_orientations():
    assert_both_lift_alike(odd_scene(400))


def test_parents_off_the_line():
    assert_both_lift_alike(faint_but_large(), 4)


def test_a_scene_of_many_things():
    assert_both_lift_alike(make_scene(2000))


def test_extremes_of_every_channel():
    rng = np.random.default_rng(1)
    n = 500
    scene = with_channels(
        surface(n),
        means=rng.uniform(-1e6, 1e6, (n, 3)),
        log_scales=rng.uniform(-30, 20, (n, 3)),
        opacity_logits=rng.choice([-40.0, 40.0], n),
    )
    assert_both_lift_alike(scene)


def test_the_largest_float32_numbers():
    sign = np.random.default_rng(2).choice([-3e38, 3e38], (300, 3))
    scene = with_channels(
        surface(300, 0),
        means=sign,
        log_scales=sign[::-1],
        opacity_logits=sign[:, 0],
        sh=sign[:, None],
    )
    assert_both_lift_alike(scene)


def test_threads_change_nothing(monkeypatch):
    splats = surface(3000)
    lifted = []
    monkeypatch.setattr(neighbours, "MIN_PART", 100)
    monkeypatch.setattr(pairing, "COMPILED_CHUNK", 512)
    for n_processors in (1, 2, 7):
        monkeypatch.setattr(os, "cpu_count", lambda n=n_processors: n)
        with compiled_from(ALWAYS):
            lifted.append(lift_with_order(splats))
    for other in lifted[1:]:
        assert_same(lifted[0], other)


def neighbours_of(points, k):
    """(n, k) neighbours of each point, in order of their numbers."""
    order, near = nearest(points, k)
    found = np.empty_like(near)
    found[order] = order[near]
    return np.sort(found, axis=1)


CLOUDS = {
    "spread": np.random.default_rng(0).normal(size=(700, 3)),
    "with one far away": np.vstack([np.random.default_rng(1).normal(size=(300, 3)), [[1e6] * 3]]),
    "on a line": np.random.default_rng(2).normal(size=(200, 1)) * [1.0, 0.0, 0.0],
    "on a grid": np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3),
    "in three places": np.repeat(np.eye(3), 50, axis=0),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_neighbours_are_those_of_scipy_whatever_is_equally_near(name):
    points = CLOUDS[name]
    with compiled_from(ALWAYS):
        by_loops = neighbours_of(points, 9)
    with compiled_from(NEVER):
        np.testing.assert_array_equal(by_loops, neighbours_of(points, 9))


def test_neighbours_that_are_nearest_are_not_asked_of_scipy(monkeypatch):
    monkeypatch.setattr("scipy.spatial.cKDTree", None)
    points = CLOUDS["spread"]
    with compiled_from(ALWAYS):
        found = neighbours_of(points, 9)
    apart = np.square(points[:, None] - points).sum(axis=2)
    np.testing.assert_array_equal(found, np.sort(np.argsort(apart, axis=1)[:, :9], axis=1))


def test_without_numba_numpy_lifts(monkeypatch):
    monkeypatch.delattr(compiled, "loops", raising=False)
    monkeypatch.setitem(sys.modules, dispatch.LOOPS, None)
    with compiled_from(ALWAYS):
        assert dispatch.compiled_for(10) is None
        without = lift_with_order(surface(300))
    with compiled_from(NEVER):
        assert_same(without, lift_with_order(surface(300)))


def test_few_nodes_load_no_compiled_code(monkeypatch):
    monkeypatch.delattr(compiled, "loops", raising=False)
    monkeypatch.delitem(sys.modules, dispatch.LOOPS, raising=False)
    assert dispatch.compiled_for(dispatch.MIN_LOADING - 1) is None
    assert dispatch.LOOPS not in sys.modules
    assert dispatch.compiled_for(dispatch.MIN_LOADING) is not None
    assert dispatch.compiled_for(dispatch.MIN_COMPILED) is not None
