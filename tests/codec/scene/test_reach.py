"""Targets of many splats: a sketch guesses a price, and what is far out of reach is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import TargetMissedError, decode, encode_scene, encode_tree, lift
from evogs_codec.encoding import arrange as arranging
from evogs_codec.encoding import prepared
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene import choose, encode, reach
from evogs_codec.scene.reach import FewSplats

N = 1200


@pytest.fixture(autouse=True)
def _many(monkeypatch):
    monkeypatch.setattr(choose, "CHECKED_FROM", 1000)
    monkeypatch.setattr(encode, "CHECKED_FROM", 1000)
    monkeypatch.setattr(reach, "N_SAMPLED", 400)
    monkeypatch.setattr(reach, "CHUNK", 64)


def _with_far_splats(scene):
    means = scene.means.copy()
    means[:2] = [[-3e4] * 3, [3e4] * 3]  # no grid has 119 dB of the others
    return replace(scene, means=means)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ({"target_psnr": 119.0}, "119 dB cannot be met: about"),
        ({"target_psnr": 5.0}, "5 dB cannot be met: about"),
        ({"target_bytes": 100}, "100 bytes cannot be met: about"),
        ({"target_bytes": 10**8}, "100,000,000 bytes cannot be met: about"),
    ],
)
def test_a_target_far_out_of_reach_is_refused_by_a_few_splats(monkeypatch, target, said):
    sizes = _sizes_arranged(monkeypatch)
    _no_lift(monkeypatch)
    scene = _with_far_splats(make_scene(N))
    with pytest.raises(TargetMissedError, match=f"{said} [\\d,]+ to [\\d,]+ (dB|bytes) can be"):
        encode_scene(scene, up="z", effort=1, **target)
    assert max(sizes) < N / 2
    with pytest.raises(TargetMissedError, match=f"{said} [\\d,]+ to [\\d,]+ (dB|bytes) can be"):
        encode_tree(lift(scene, 2), up="z", effort=1, **target)
    assert max(sizes) < N / 2


def test_an_error_far_out_of_reach_is_refused_by_a_few_splats(monkeypatch):
    _no_lift(monkeypatch)
    with pytest.raises(TargetMissedError, match="of 1e-12 cannot be kept: it is at least"):
        encode_scene(make_scene(N), max_error=1e-12)


@pytest.mark.parametrize(("target", "end"), [(119.0, 1), (5.0, 0)])
def test_ends_of_a_few_splats_are_near_those_of_all(monkeypatch, target, end):
    scene = _with_far_splats(make_scene(N))
    said = []
    for many in (1000, 10_000):
        monkeypatch.setattr(choose, "CHECKED_FROM", many)
        monkeypatch.setattr(encode, "CHECKED_FROM", many)
        with pytest.raises(TargetMissedError) as refused:
            encode_scene(scene, up="z", effort=1, levels=2, target_psnr=target)
        found = re.search(r"([\d.]+) to ([\d.]+) dB can be", str(refused.value))
        assert found
        said.append(float(found.groups()[end]))
    assert said[0] != said[1]
    assert abs(said[0] - said[1]) < reach.ROOM_DB


@pytest.mark.parametrize(
    "target", [{"target_psnr": 119.0}, {"target_psnr": 5.0}, {"target_bytes": 100}]
)
def test_a_target_just_out_of_reach_costs_both_ends_alone(monkeypatch, target):
    monkeypatch.setattr(FewSplats, "expect_in_reach", lambda *_: None)
    prices = []

    def coded(self, price):
        prices.append(price)
        return code(self, price)

    code = Prepared.coded
    monkeypatch.setattr(Prepared, "coded", coded)
    with pytest.raises(TargetMissedError, match=r"cannot be met: [\d.,]+ to "):
        encode_scene(_with_far_splats(make_scene(N)), up="z", effort=1, levels=2, **target)
    assert sorted(prices) == sorted(PRICES)


def test_a_target_that_few_splats_find_in_reach_has_no_end_of_all_tried(monkeypatch):
    prices = _prices_of_all(monkeypatch)
    scene = _with_far_splats(make_scene(N))
    encode_scene(scene, up="z", effort=1, levels=2, target_psnr=66.0)
    assert prices
    assert PRICES[0] not in prices


@pytest.mark.parametrize("is_in_reach", [False, True])
def test_above_the_usual_the_finest_end_is_tried(monkeypatch, is_in_reach):
    monkeypatch.setattr(FewSplats, "expect_in_reach", lambda *_: is_in_reach)
    prices = _prices_of_all(monkeypatch)
    scene = _with_far_splats(make_scene(N))
    encode_scene(scene, up="z", effort=1, levels=2, target_psnr=66.0)
    assert (prices[0] == PRICES[0]) == (not is_in_reach)


@pytest.mark.parametrize(("is_far", "decibels"), [(False, 66.0), (True, 66.0), (False, 84.0)])
def test_few_splats_are_looked_at_where_positions_limit_a_psnr(monkeypatch, is_far, decibels):
    looks = []

    def look(*_):
        looks.append(1)
        return True

    monkeypatch.setattr(FewSplats, "expect_in_reach", look)
    scene = make_scene(N)
    scene = _with_far_splats(scene) if is_far else scene
    encode_scene(scene, up="z", effort=1, levels=2, target_psnr=decibels)
    assert len(looks) == (is_far or decibels > 80)


def test_sizes_that_no_float_has_are_compared():
    scene = make_scene(N)
    sizes = scene.log_scales.copy()
    sizes[: N // 2 + 1] = 2000.0
    assert reach._is_exact(replace(scene, log_scales=sizes))
    assert not reach._is_exact(replace(scene, log_scales=-sizes))


def _prices_of_all(monkeypatch):
    """Those at which all splats are coded from now on."""
    prices = []

    def coded(self, price):
        if sum(tile.n_leaves for tile in self.tiles) == N:
            prices.append(price)
        return code(self, price)

    code = Prepared.coded
    monkeypatch.setattr(Prepared, "coded", coded)
    return prices


def _sizes_arranged(monkeypatch):
    """Of the trees that are prepared for encoding from now on."""
    sizes = []

    def arrange(tree, n_tiles):
        sizes.append(tree.n_leaves)
        return arranging.arrange(tree, n_tiles)

    monkeypatch.setattr(prepared, "arrange", arrange)
    return sizes


def _no_lift(monkeypatch):
    def lifting(*args, **options):
        raise AssertionError("all splats are lifted")

    monkeypatch.setattr(encode, "lift_with_order", lifting)


@pytest.mark.thorough
@pytest.mark.usefixtures("any_views")
def test_targets_are_met_from_a_guess():
    splats = make_scene(N)
    views = Views.of(splats, cameras_around(splats, "z"))
    data = encode_scene(splats, up="z", effort=1, target_psnr=40.0)
    assert views.psnr(decode(data).leaves(sh_degree=3)) == pytest.approx(40.0, abs=0.2)
    data = encode_scene(splats, up="z", effort=1, target_psnr=85.0)
    assert views.psnr(decode(data).leaves(sh_degree=3)) == pytest.approx(85.0, abs=0.5)
    data = encode_scene(splats, up="z", effort=1, target_bytes=25_000)
    assert 24_500 <= len(data) <= 25_000


@pytest.mark.thorough
@pytest.mark.usefixtures("any_views")
def test_a_tree_is_met_from_a_guess():
    tree = lift(make_scene(N), 3)
    views = Views.of(tree.leaves(), cameras_around(tree.leaves(), "z"))
    data = encode_tree(tree, up="z", effort=1)
    assert views.psnr(decode(data).leaves(sh_degree=3)) == pytest.approx(52.0, abs=0.2)
