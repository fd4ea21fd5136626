"""What a palette saves, by an estimate."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec import TargetEncoder, lift_with_order, with_palette
from evogs_codec.encoding.palette_worth import bits_of_palette, bits_of_psi
from evogs_codec.encoding.settings import PRESETS
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import choose

N = 3000
PRICE = 4e-6 / N


def random(n_entries, loudness):
    """Splats of which each has one of a few SH, whichever its neighbours have."""
    splats = make_scene(N)
    rng = np.random.default_rng(5)
    return with_sh(
        splats, rng.normal(size=(n_entries, 45)), rng.integers(0, n_entries, N), loudness
    )


def smooth(n_entries, loudness):
    """Splats with about the SH of their neighbours: psi have little to say."""
    splats = make_scene(N)
    places = np.argsort(np.argsort(splats.means[:, 0])) * n_entries // N
    turns = np.linspace(0, 3, n_entries)[:, None] + np.arange(45)
    return with_sh(splats, np.sin(turns), places, loudness)


def with_sh(splats, entries, picks, loudness):
    rest = (loudness * entries[picks]).reshape(N, 15, 3)
    sh = np.concatenate([splats.sh[:, :1], rest], axis=1)
    return replace(splats, sh=sh.astype(np.float32))


def encoders(splats):
    """One of a tree with a palette, one of a tree without."""
    lifted = lift_with_order(splats, 4)
    shared = with_palette(lifted, splats)
    assert shared is not None
    views = Views(lifted.tree.leaves(), cameras_around(splats, "z", 60, n=4))
    plain = TargetEncoder(lifted.tree, PRESETS["scene"], views)
    return [replace(plain, tree=shared), plain]


# Coarse splats of a palette pick by bits: only SH that are as quiet as this surely need none.
PAYS, DOES_NOT = random(12, 0.5), smooth(700, 0.05)


def estimate(shared, plain):
    bits = bits_of_palette(shared.tree, shared.importance, PRICE)
    return bits, bits_of_psi(plain.tree, shared.importance, PRICE)


def cost(one):
    data = one.at_price(PRICE)
    return 8 * len(data) + 10 ** (-one.psnr(data) / 10) / PRICE


def test_what_a_palette_saves_is_told_without_encoding():
    shared, plain = encoders(PAYS)
    bits, instead = estimate(shared, plain)
    assert instead - bits == pytest.approx(cost(plain) - cost(shared), rel=0.3)


@pytest.mark.thorough
def test_a_palette_of_what_neighbours_share_anyway_saves_nothing():
    shared, plain = encoders(DOES_NOT)
    bits, instead = estimate(shared, plain)
    assert bits > choose.SURE_OF_PICKS * instead
    assert cost(shared) > cost(plain)


@pytest.mark.parametrize(("splats", "right"), [(PAYS, 0), (DOES_NOT, 1)], ids=["random", "smooth"])
def test_only_one_tree_is_encoded_where_the_estimate_is_sure(splats, right, monkeypatch):
    both = encoders(splats)
    (found,) = choose._that_pay(both, PRICE)
    assert found.tree is both[right].tree
    monkeypatch.setattr(choose, "SURE_OF_PSI", 1e9)
    monkeypatch.setattr(choose, "SURE_OF_PICKS", 1e9)
    found, other = choose._that_pay(both, PRICE)
    assert (found.tree, other.tree) == tuple(one.tree for one in both)


def test_of_one_tree_there_is_nothing_to_choose():
    both = encoders(PAYS)
    assert choose._that_pay(both[1:], 1e-9) == both[1:]
