"""Sketches: some families of a tree tell what a stream of the whole takes, about."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import PRESETS, TargetEncoder, lift
from evogs_codec.encoding import sketch
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.guess import Guess, goal_of_psnr, price_near
from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.layers import Layering
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.search import Found
from evogs_codec.encoding.sketch import Sketch, families, part_of
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene

N = 1500
PRICE = 4e-6 / N


def aim_of(width=60, n_views=4, **more):
    splats = make_scene(N)
    views = Views(splats, cameras_around(splats, "z", width, n=n_views))
    return TargetEncoder(lift(splats, 3), PRESETS["scene"], views, **more)


def test_a_part_has_whole_families_with_the_leaves_of_the_tree():
    tree = lift(make_scene(N), 3)
    (is_in,) = families([tree], 0.4)
    part, (_, live) = part_of(tree, is_in), tree.lineage()
    assert 0.3 * N < part.n_leaves < 0.5 * N
    expected = tree.leaves().channels()[:, is_in[live]]
    assert np.array_equal(part.leaves().channels(), expected)


@pytest.mark.parametrize(("n_tiles", "share"), [(1, 1e-4), (9, 0.1)])
def test_a_small_share_of_small_tiles_has_a_family(n_tiles, share):
    tiles = arrange(lift(make_scene(N), 4), n_tiles)
    chosen = families(tiles, share)
    assert [len(is_in) for is_in in chosen] == [len(tile.lineage()[0]) for tile in tiles]
    n_leaves = sum(part_of(t, is_in).n_leaves for t, is_in in zip(tiles, chosen, strict=True))
    assert 0 < n_leaves < 0.3 * N


@pytest.mark.parametrize("layers", [1, 2])
def test_a_sketch_guesses_bytes_and_psnr(monkeypatch, layers):
    monkeypatch.setattr(sketch, "MIN_LEAVES", N // 2)
    aim = aim_of(layers=layers)
    found = Sketch.of(aim.prepared)
    assert 0.4 < found.share < 0.6
    data = aim.at_price(PRICE)
    assert found.log_bytes(PRICE) == pytest.approx(math.log(len(data)), abs=0.4)
    assert found.psnr(PRICE) == pytest.approx(aim.psnr(data), abs=2.5)
    assert found.log_bytes(PRICE / 4) > found.log_bytes(PRICE)
    assert found.psnr(PRICE / 4) > found.psnr(PRICE)


def test_a_sketch_of_a_tree_with_steps_held_back_has_its_families(monkeypatch):
    monkeypatch.setattr(sketch, "MIN_LEAVES", N // 2)
    held = aim_of(layers=2).holding([Run((1, 0), (2, 0))], Layering(2))
    assert Sketch.of(held.prepared).log_bytes(PRICE) > 0


def test_what_meets_a_target_is_not_coded_again(monkeypatch):
    monkeypatch.setattr(sketch, "MIN_LEAVES", N // 2)
    aim = aim_of(layers=2)
    coded = aim.prepared.coded(PRICE)
    target = aim.psnr(aim.written(coded)) + 0.1
    guess = aim.nearer(Guess(PRICE, -3.0), target, coded)
    monkeypatch.setattr(Prepared, "coded", None)
    found = aim.guessing(guess).nearest_psnr(target)
    assert found.what == aim.written(coded)
    assert found.at == PRICE
    assert found.value == pytest.approx(target - 0.1)
    assert aim.nearer(Guess(PRICE, -3.0), target + 0.2, coded).met is None
    assert aim.guessing(guess).leaving_empty(frozenset()).guess.met is None


@pytest.mark.parametrize(("decibels", "slack"), [(60, 0.2), (65, 0.35), (70, 0.5), (90, 0.5)])
def test_the_higher_a_psnr_the_further_it_may_be_missed(decibels, slack):
    assert goal_of_psnr(decibels).slack == pytest.approx(slack)


def test_where_a_psnr_jumps_over_a_target_it_may_be_missed_by_as_much_again():
    guess = Guess(PRICE, -4.0)
    assert guess.jumping(Found(PRICE, 40.15, b""), 40).jump == 0
    found = guess.jumping(Found(PRICE, 40.6, b""), 40)
    assert 0.6 < found.jump < 0.75
    assert found.unmeasured.jump == found.jump


@pytest.mark.parametrize(
    ("decibels", "price"), [(45, 1e-10), (55, 1e-11), (300, 1e-18), (-100, 1e-5)]
)
def test_a_first_price_follows_from_the_target(decibels, price):
    assert price_near(decibels, 1e-10) == pytest.approx(price)


@pytest.mark.parametrize(("target", "n_sketches"), [(45.5, 1), (42.0, 2), (33.0, 3)])
def test_a_sketch_is_made_again_where_its_price_has_moved_far(monkeypatch, target, n_sketches):
    prices = []

    def psnr(_, price):
        prices.append(price)
        return 45.0 - 2.5 * math.log(price / PRICE)

    monkeypatch.setattr(Sketch, "psnr", psnr)
    guess = Guess.of_psnr(Sketch(None, 1.0, 0), target, PRICE)  # type: ignore[arg-type]
    assert len(prices) == n_sketches
    assert n_sketches == 1 or guess.price == pytest.approx(PRICE * math.exp((45.0 - target) / 2.5))
    assert not guess.is_at_end
    assert replace(guess, at=5e-6).is_at_end


@pytest.mark.thorough
def test_a_search_begins_near_its_target(monkeypatch):
    monkeypatch.setattr(sketch, "MIN_LEAVES", N // 2)
    # In fewer pixels the PSNR of the streams themselves is rough: 0.5 dB between prices 3 % apart.
    aim = aim_of(width=100, n_views=12, layers=2)
    for target in (38.0, 40.0, 42.0):
        rough = Guess.of_psnr(aim.sketch, target, PRICE)
        guess = aim.nearer(rough, target, aim.prepared.coded(rough.price))
        assert aim.psnr(aim.at_price(guess.price)) == pytest.approx(target, abs=0.5)
    tried, coded = [], aim.prepared.coded

    def counted(price):
        tried.append(price)
        return coded(price)

    monkeypatch.setattr(aim.prepared, "coded", counted)
    guess = Guess.of_bytes(aim.sketch, 20_000, PRICE)
    assert not tried  # but a sketch
    guess = aim.nearer_bytes(guess, 20_000, coded(guess.price))
    assert len(aim.at_price(guess.price)) == pytest.approx(20_000, rel=0.05)
    tried.clear()
    found = aim.guessing(guess).nearest_bytes(20_000, guess.price)
    assert 0.98 * 20_000 <= len(found.what) <= 20_000
    assert len(tried) <= 2
    assert Guess.of_psnr(aim.sketch, 1e6, PRICE).price == pytest.approx(
        1e-18
    )  # an end of the range
