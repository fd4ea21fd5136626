"""Polishing: integers of the last level that pictures like better, in a stream that is legal."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("numba", reason="the rasterizer is compiled")
from conformance.decoders import oracle
from evogs_codec import PRESETS, decode, lift
from evogs_codec.cli.commands import main
from evogs_codec.encoding import polish, prepared
from evogs_codec.encoding.polish import polished
from evogs_codec.encoding.prepared import Prepared
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.encoding.write import write
from evogs_codec.io.ply import write_ply
from evogs_codec.model.arithmetic import RangeError
from evogs_codec.model.channels import n_channels
from evogs_codec.model.siblings import Siblings
from evogs_codec.render import cameras_around, save_cameras
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.viewpoints import RINGS
from evogs_codec.render.views import Views, view_of
from tests.support.coded_strategies import coded_trees
from tests.support.examples import examples

quietly = partial(polished, progress=lambda _: None)


@cache
def scene():
    """A lifted tree of 1,500 splats and views of its leaves; descent goes by others."""
    tree = lift(make_scene(1500), 3)
    leaves = tree.leaves()
    others = [
        c
        for n, h, r in RINGS
        for c in cameras_around(leaves, "z", 96, n=n, elevation=h, distance=r)
    ]
    return tree, Views(leaves, cameras_around(leaves, "z", 96)[::3], others=others)


def psnr(data):
    tree, views = scene()
    return views.psnr(decode(data).leaves(sh_degree=tree.sh_degree))


def aim(**more):
    tree, views = scene()
    return TargetEncoder(tree, PRESETS["scene"], views, **more)


class Noise:
    """Slopes of nothing."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def loss_gradient(self, splats, iteration):
        d = n_channels(splats.sh_degree)
        return self.rng.normal(size=(d, len(splats))).astype(np.float32)

    def psnr(self, splats):
        raise AssertionError("descent does not need it")

    def sensitivity(self, splats):
        raise AssertionError("descent does not need it")


@pytest.mark.parametrize(
    ("price", "gain"), [pytest.param(3e-8, 0.3, marks=pytest.mark.thorough), (3e-9, 1.0)]
)
def test_pictures_err_less_for_no_more_bytes(price, gain):
    coded = Prepared(aim()).coded(price)
    before, after = write(coded), write(quietly(coded, scene()[1], price, 150))
    assert psnr(after) > psnr(before) + gain
    assert len(after) < 1.03 * len(before)


def test_only_integers_of_the_last_level_move_and_zeros_do_not():
    coded = Prepared(aim()).coded(1e-10)
    found = quietly(coded, scene()[1], 1e-10, 20)
    for old, new in zip(coded.tiles[0].steps, found.tiles[0].steps, strict=True):
        moved = old.psi != new.psi
        assert moved.any() == (old.level == coded.n_levels - 1 and len(old.slots) > 0)
        assert not new.psi[old.psi == 0].any()
        for name in ("slots", "kinds", "alpha", "adds"):
            assert np.array_equal(getattr(old, name), getattr(new, name))


@pytest.mark.thorough
@examples(40)
@given(coded_trees(), st.integers(0, 2**32))
def test_whatever_moves_the_stream_stays_legal(tree, seed):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(polish, "RATE", 20.0)
        found = quietly(tree, Noise(seed), 1e-3, 3)
    data = write(found)
    assert decode(data, verify=True).dump() == oracle.decode(data).dump()


def test_a_tile_whose_integers_leave_the_range_stays_as_it_was(monkeypatch):
    def too_large(*_):
        raise RangeError

    coded = Prepared(aim()).coded(1e-10)
    monkeypatch.setattr(polish, "apply_channel", too_large)
    assert quietly(coded, scene()[1], 1e-10, 2).tiles == coded.tiles


@pytest.mark.parametrize("iterations", [0, 3])
def test_a_tile_whose_sums_of_siblings_leave_the_range_stays_as_it_was(monkeypatch, iterations):
    coded = Prepared(aim(layers=2)).coded(1e-10)
    assert coded.tiles[0].steps[-1].siblings
    calls = []

    def beyond(siblings, differences):
        calls.append(siblings)
        if len(calls) > iterations:  # each draws once
            raise RangeError
        return sums(siblings, differences)

    sums = Siblings.sums
    monkeypatch.setattr(Siblings, "sums", beyond)
    assert quietly(coded, scene()[1], 1e-10, iterations).tiles == coded.tiles
    assert len(calls) > iterations


def test_a_tile_whose_sums_leave_the_range_while_it_descends_is_put_back(monkeypatch):
    coded = Prepared(aim(layers=2)).coded(1e-10)
    sums, calls = Siblings.sums, []

    def beyond(siblings, differences):
        calls.append(differences)
        if len(calls) == 3:
            raise RangeError
        return sums(siblings, differences)

    monkeypatch.setattr(Siblings, "sums", beyond)
    monkeypatch.setattr(polish, "RATE", 20.0)
    assert quietly(coded, scene()[1], 1e-10, 5).tiles == coded.tiles
    assert not np.array_equal(calls[2], calls[0])
    assert all(np.array_equal(later, calls[0]) for later in calls[3:])
    assert len(calls) == 6


def test_a_tile_whose_integers_need_too_many_bits_stays_as_it_was(monkeypatch):
    coded = Prepared(aim()).coded(1e-10)
    monkeypatch.setattr(polish, "MAX_STORED", 4)
    assert quietly(coded, scene()[1], 1e-10, 2).tiles == coded.tiles


@pytest.mark.thorough
def test_where_polishing_misses_a_target_the_plain_stream_meets_it(monkeypatch):
    def nothing(tree, *_):
        return replace(tree, tiles=())

    monkeypatch.setattr(prepared, "polished", nothing)
    assert aim(polish=2).at_psnr(38) == aim().at_psnr(38)
    assert aim(polish=2).at_bytes(12_000) == aim().at_bytes(12_000)


def test_it_needs_pictures_and_other_views():
    tree, views = scene()
    with pytest.raises(ValueError, match="needs views"):
        TargetEncoder(tree, PRESETS["scene"], polish=2).at_bytes(12_000)
    with pytest.raises(ValueError, match="no other views"):
        Views(views.scene, views.cameras).loss_gradient(views.scene, 0)


def test_views_of_a_file_judge_or_are_descended_by(tmp_path, capsys):
    views = scene()[1]
    found = Views.of(views.scene, views.cameras[:6], descent=True)
    assert (len(found.cameras), len(found.others)) == (2, 4)
    with pytest.raises(ValueError, match="expected at least 2"):
        Views.of(views.scene, views.cameras[:1], descent=True)
    save_cameras(tmp_path / "one.json", views.cameras[:1])
    write_ply(tmp_path / "scene.ply", make_scene(50))
    paths = [str(tmp_path / name) for name in ("scene.ply", "x.evogs")]
    options = ["--target-psnr", "40", "--polish", "--camera", str(tmp_path / "one.json")]
    assert main(["encode", *paths, *options]) == 1
    assert "one.json: 1 camera, expected at least 2" in capsys.readouterr().err


@pytest.mark.thorough
def test_a_psnr_is_met_in_fewer_bytes():
    plain, polished_ = aim().at_psnr(38), aim(polish=200).at_psnr(38)  # as many as by default
    assert psnr(polished_) == pytest.approx(38, abs=0.2)
    assert len(polished_) < 0.93 * len(plain)


@pytest.mark.thorough
def test_a_number_of_bytes_is_met_with_better_pictures():
    plain, polished_ = aim().at_bytes(12_000), aim(polish=100).at_bytes(12_000)
    assert 0.98 * 12_000 <= len(polished_) <= 12_000
    assert psnr(polished_) > psnr(plain) + 0.5


@pytest.mark.thorough
def test_it_is_the_same_every_time():
    coded = Prepared(aim()).coded(1e-10)
    first, second = (write(quietly(coded, scene()[1], 1e-10, 20)) for _ in range(2))
    assert first == second


def test_every_view_has_its_turn():
    turns = [view_of(turn, 5) for turn in range(10)]
    assert sorted(turns[:5]) == sorted(turns[5:]) == [0, 1, 2, 3, 4]


def test_slopes_are_those_of_the_error():
    views = scene()[1]
    splats = views.scene
    changed = splats.channels().copy()
    changed[10] += 0.1  # opacities
    off = type(splats).from_channels(changed)
    one = Views(splats, views.cameras[:1], others=views.cameras[:1])
    slope = one.loss_gradient(off, 0)[10].sum()
    nudged = changed.copy()
    nudged[10] += 1e-3
    errors = [10 ** (-one.psnr(type(splats).from_channels(x)) / 10) for x in (changed, nudged)]
    assert slope == pytest.approx((errors[1] - errors[0]) / 1e-3, rel=0.05)


def test_without_a_target_it_is_refused(tmp_path, capsys):
    write_ply(tmp_path / "scene.ply", make_scene(50))
    paths = [str(tmp_path / name) for name in ("scene.ply", "scene.evogs")]
    assert main(["encode", *paths, "--polish"]) == 1
    assert "--polish needs --target-psnr or --target-bytes" in capsys.readouterr().err
    assert not (tmp_path / "scene.evogs").exists()
