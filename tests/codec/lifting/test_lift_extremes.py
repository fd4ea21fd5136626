"""Lifting of odd and extreme scenes, and the turns of quaternions."""

import numpy as np
import pytest

from evogs_codec.lifting.lift import lift
from evogs_codec.lifting.orientations import (
    COMPOSE,
    N_TURNS,
    TURNS,
    largest_w,
    matrices,
    multiply,
    turned,
)
from tests.support.lifted_scenes import assert_leaves_are, surface, with_channels

# --- odd and extreme scenes -----------------------------------------------------------------------


ODD: dict[str, dict[str, object]] = {
    "all_at_one_point": {"means": [1.0, 2.0, 3.0]},
    "zero_quaternions": {"quats": 0.0},
    "huge_quaternions": {"quats": [1e38, -1e38, 1e37, 3e38]},
    "tiny_quaternions": {"quats": [1e-44, 0.0, 1e-44, 0.0]},
    "half_turns": {"quats": [0.0, 1.0, 1.0, 0.0]},
    "isotropic": {"log_scales": -3.0},
    "points": {"log_scales": -30.0},
    "needles": {"log_scales": [-30.0, -30.0, 20.0]},
    "transparent": {"opacity_logits": -40.0},
    "opaque": {"opacity_logits": 40.0},
    "grey": {"sh": 0.0},
}


@pytest.mark.parametrize("name", ODD)
def test_odd_scenes_are_lifted(name):
    assert_leaves_are(with_channels(surface(1500), **ODD[name]), 4)


def test_identical_splats_are_lifted_and_halve():
    splats = surface(1).take(np.zeros(4096, np.int64))
    assert_leaves_are(splats)
    tree = lift(splats)
    assert len(tree.leaves(0)) < 270
    assert np.abs(tree.steps[1].psi).max() == 0


def test_scenes_that_mix_extremes_are_lifted():
    rng = np.random.default_rng(1)
    n = 1500
    splats = with_channels(
        surface(n),
        means=rng.uniform(-1e6, 1e6, (n, 3)),
        log_scales=rng.uniform(-30, 20, (n, 3)),
        opacity_logits=rng.choice([-40.0, 40.0], n),
    )
    assert_leaves_are(splats)


def test_the_largest_float32_numbers_are_lifted():
    rng = np.random.default_rng(2)
    n = 300
    sign = rng.choice([-3e38, 3e38], (n, 3))
    splats = with_channels(
        surface(n, 0),
        means=sign,
        log_scales=sign[::-1],
        opacity_logits=sign[:, 0],
        sh=sign[:, None],
    )
    tree = lift(splats)
    assert len(tree.leaves()) == n


def test_a_splat_far_away_does_not_spoil_the_others():
    means = surface(2000).means.copy()
    means[7] = 1e6
    tree = lift(with_channels(surface(2000), means=means), 2)
    # In a spoilt search everything looks coincident, and pairs are far apart.
    assert np.median(np.linalg.norm(tree.steps[1].psi[:3], axis=0)) < 0.05


def test_numbers_that_are_not_finite_are_refused_with_their_count():
    sh = surface(50).sh.copy()
    sh[[3, 9], 0, 0] = np.nan, np.inf
    with pytest.raises(ValueError, match="2 of 50 splats"):
        lift(with_channels(surface(50), sh=sh))


def test_no_levels_are_refused():
    with pytest.raises(ValueError, match="n_levels is 0"):
        lift(surface(5), 0)


# --- turns ----------------------------------------------------------------------------------------


def test_turns_leave_the_covariance_as_it_is():
    rng = np.random.default_rng(3)
    quats = rng.normal(size=(4, N_TURNS))
    quats /= np.linalg.norm(quats, axis=0)
    log_scales = rng.normal(size=(3, N_TURNS))
    _, g, scales = turned(quats, log_scales, np.arange(N_TURNS, dtype=np.uint8))

    def covariance(g, s):
        root = matrices(g) * np.exp(s)
        return np.einsum("ikn,jkn->ijn", root, root)

    np.testing.assert_allclose(
        covariance(g, scales), covariance(quats[1:] / quats[0], log_scales), atol=1e-9
    )


def test_composed_turns_are_one_turn_after_the_other():
    for j in range(N_TURNS):
        both = multiply(TURNS[j][:, None], TURNS.T)
        agreement = np.abs((TURNS[COMPOSE[j]].T * both).sum(axis=0))
        np.testing.assert_allclose(agreement, 1)


def test_the_largest_w_is_at_least_085():
    quats = np.random.default_rng(4).normal(size=(4, 20_000))
    quats /= np.linalg.norm(quats, axis=0)
    w, _, _ = turned(quats, np.zeros((3, 20_000)), largest_w(quats))
    assert np.abs(w).min() > 0.85
