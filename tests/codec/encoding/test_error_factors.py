"""What estimates of errors miss, measured: overlaps in depth, and SH that become 0 together."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import PRESETS, TargetEncoder, decode, lift
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.error_factors import (
    LOG_PRICE_SPACING,
    MIN_FACTOR,
    USUAL_FACTORS,
    ErrorFactors,
)
from evogs_codec.encoding.layers import N_LAYERS, Layered, Layering
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.model.channels import N_GROUPS
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene

N = 1500
PRICE = 1e-6 / N
FINE = 1e-9 * PRICE  # at which no step is the largest


def views_of(splats, n=6):
    return Views(splats, cameras_around(splats, "z", 120, n=n))


def factors(splats, price):
    """Per class, of a scene, by all of its views."""
    views, tiles = views_of(splats), arrange(lift(splats, 2), 1)
    importance = Importance.of(tiles, 2, views.sensitivity)
    factors = importance.measured(tiles, views, 1.0).factors
    assert factors is not None
    return factors.at(price)


def shell():
    """Large opaque splats, all as far from the middle as the others."""
    splats, rng = make_scene(N), np.random.default_rng(0)
    means = rng.normal(size=(N, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    return replace(
        splats,
        means=means.astype(np.float32),
        opacity_logits=np.full_like(splats.opacity_logits, 8),
    )


def haze(band):
    """Large faint splats, many behind each pixel, with (N, 3, 3) as band 1."""
    splats = make_scene(N)
    logits = np.full_like(splats.opacity_logits, -3)
    sh = np.concatenate([splats.sh[:, :1], band], axis=1)
    return replace(splats, opacity_logits=logits, log_scales=splats.log_scales + 1, sh=sh)


def test_positions_weigh_more_where_opaque_splats_change_places_in_depth():
    assert factors(shell(), PRICE)[0] > 5 * factors(make_scene(N), PRICE)[0]


def test_bands_weigh_more_where_they_become_0_together():
    rng = np.random.default_rng(0)
    small = np.full((N, 3, 3), 0.02, np.float32)
    signs = rng.choice(np.array([-1, 1], np.float32), small.shape)
    alike, random = (factors(haze(x), 1e-5)[-1] for x in (small, small * signs))
    assert alike > 5 * random
    assert 0.5 <= random < 2


def test_what_is_not_measured_is_known():
    found = factors(make_scene(N), PRICE)
    np.testing.assert_allclose(found[1 : len(USUAL_FACTORS)], USUAL_FACTORS[1:], rtol=1e-6)
    assert found[len(USUAL_FACTORS)] == 1
    assert (found >= MIN_FACTOR * (1 - 1e-6)).all()


class Counted(Views):
    """Views that only count how often they are asked."""

    n_asked = 0

    def psnr(self, splats):
        Counted.n_asked += 1
        return 30.0 + Counted.n_asked

    def psnr_of_sh(self, splats, each):
        return (self.psnr(splats) for _ in each)


def counted(splats):
    Counted.n_asked = 0
    return Counted(splats, cameras_around(splats, "z", 60, n=2))


@pytest.mark.parametrize("has_palette", [False, True])
def test_prices_between_two_that_are_measured_are_not(has_palette):
    splats = make_scene(N)
    pictures = counted(splats)
    weights = np.full((8, N), 1e-6, np.float32)
    factors = ErrorFactors(splats, weights, lambda price: np.full(8, 0.1), pictures, has_palette)
    ends = [np.exp(LOG_PRICE_SPACING * place) for place in (-5, -4)]
    low, high = (factors.at(price * (1 + 1e-9)) for price in ends)
    asked = pictures.n_asked
    assert asked == (3 if has_palette else 6)
    middle = factors.at(np.sqrt(ends[0] * ends[1]))
    np.testing.assert_allclose(middle, np.sqrt(low * high), rtol=1e-5)
    assert pictures.n_asked == asked
    assert (middle[N_GROUPS:] == 1).all() == has_palette


def test_layers_weigh_by_factors_at_their_own_prices():
    splats = make_scene(N)
    tiles = arrange(lift(splats, 3), 1)
    importance = Importance.of(tiles, 3, views_of(splats).sensitivity)

    class Known(ErrorFactors):
        def at(self, price):
            return np.full(8, 4.0 if price > FINE else 9.0, np.float32)

    known = Known(splats, importance.leaves[0], lambda price: np.ones(8), counted(splats), False)
    plain, layered = (
        Layered.of(tiles, 3, one, Layering(N_LAYERS))
        for one in (importance, replace(importance, factors=known))
    )
    for step, own, other in zip(
        tiles[0].steps, plain.weights(FINE, 1.0)[0], layered.weights(FINE, 1.0)[0], strict=False
    ):
        assert own is not None
        assert other is not None
        assert step.level == own.level
        np.testing.assert_allclose(other.targets / own.targets, 4, rtol=1e-3)
    last, other = plain.weights(FINE, 1.0)[0][-1], layered.weights(FINE, 1.0)[0][-1]
    assert last is not None
    assert other is not None
    np.testing.assert_allclose(other.targets / last.targets, 9, rtol=1e-3)


@pytest.mark.thorough
def test_a_stream_of_opaque_splats_looks_better_at_as_many_bytes():
    splats = shell()
    views = views_of(splats)
    measuring = TargetEncoder(
        lift(splats, 2), PRESETS["scene"], views, layers=2, measuring=views.fewer(2)
    )
    plain = replace(measuring, measuring=None)
    assert isinstance(measuring.prepared, Prepared)
    n_bytes = len(plain.at_price(PRICE))
    judge = views_of(splats, n=10)
    before, after = (
        judge.psnr(decode(aim.at_bytes(n_bytes)).leaves()) for aim in (plain, measuring)
    )
    assert after > before + 1


def test_what_is_weighed_by_leaves_has_the_factors_of_other_scenes():
    splats = make_scene(300)
    views, tree = views_of(splats, 3), lift(splats, 2)
    aim = TargetEncoder(tree, PRESETS["scene"], views, by_leaves=True)
    plain = Importance.of(aim.prepared.tiles, 2, views.sensitivity, first=1)
    found = aim.prepared.importance
    assert found is not None
    ratio = found.means / plain.means
    assert ratio.shape[1] > len(USUAL_FACTORS)
    np.testing.assert_allclose(
        ratio[:, : len(USUAL_FACTORS)], np.tile(USUAL_FACTORS, (3, 1)), rtol=1e-5
    )
    assert (ratio[:, len(USUAL_FACTORS) :] == 1).all()
