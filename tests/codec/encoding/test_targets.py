"""Encoding to a target, and what it goes by: importance, and integers that cost least."""

import json
import math
import re
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conformance.decoders import oracle
from evogs_codec import PRESETS, Cut, EvolutionTree, decode, encode, lift
from evogs_codec.cli.commands import main
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.guess import PRICES
from evogs_codec.encoding.out_of_reach import TargetMissedError
from evogs_codec.encoding.quantise import quantise
from evogs_codec.encoding.rate_distortion import cheapest
from evogs_codec.encoding.settings import TREE_PSNR
from evogs_codec.encoding.targets import TargetEncoder
from evogs_codec.io.ply import write_ply
from evogs_codec.io.tree_npz import write_tree
from evogs_codec.model.channels import GROUP_CHANNELS, GROUPS
from evogs_codec.model.splats import SplatParams
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views


@cache
def scene():
    """A lifted tree of 1,500 splats and views of its leaves."""
    tree = lift(make_scene(1500), 3)
    return tree, Views(tree.leaves(), cameras_around(tree.leaves(), "z", 96)[::3])


def aim(**more):
    tree, views = scene()
    return TargetEncoder(tree, PRESETS["scene"], views, **more)


def psnr(data):
    tree, views = scene()
    return views.psnr(decode(data).leaves(sh_degree=tree.sh_degree))


# --- targets --------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("decibels", [32, 44])
def test_a_psnr_is_met(decibels):
    assert psnr(aim().at_psnr(decibels)) == pytest.approx(decibels, abs=0.2)


@pytest.mark.thorough
def test_a_psnr_that_jumps_over_the_target_is_met_from_above(monkeypatch):
    real = Views.psnr_of_each

    def jumps(self, splats):
        return real(self, splats) + (real(scene()[1], splats).mean() > 40)

    with monkeypatch.context() as patch:
        patch.setattr(Views, "psnr_of_each", jumps)
        data = aim().at_psnr(40.5)
    assert 40 < psnr(data) < 40.2


@pytest.mark.parametrize(
    ("n_bytes", "has_pictures"),
    [
        (9000, True),
        pytest.param(9000, False, marks=pytest.mark.thorough),
        pytest.param(30_000, True, marks=pytest.mark.thorough),
        pytest.param(30_000, False, marks=pytest.mark.thorough),
    ],
)
def test_a_number_of_bytes_is_met(n_bytes, has_pictures):
    tree, _ = scene()
    data = (aim() if has_pictures else TargetEncoder(tree, PRESETS["scene"])).at_bytes(n_bytes)
    assert 0.98 * n_bytes <= len(data) <= n_bytes


@pytest.mark.thorough
def test_a_tree_is_encoded_as_near_to_it_as_pictures_tell(tmp_path):
    tree = scene()[0]
    write_tree(tmp_path / "in.tree.npz", tree)
    assert main(["encode", str(tmp_path / "in.tree.npz"), str(tmp_path / "out.evogs")]) == 0
    views = Views(tree.leaves(), cameras_around(tree.leaves(), "z", 400))
    found = decode((tmp_path / "out.evogs").read_bytes()).leaves(sh_degree=tree.sh_degree)
    assert views.psnr(found) == pytest.approx(TREE_PSNR, abs=0.2)


def test_a_tree_of_which_pictures_show_nothing_is_encoded_all_the_same(tmp_path, capsys):
    unseen = make_scene(200)
    unseen = replace(unseen, opacity_logits=np.full(200, -40, np.float32))
    write_tree(tmp_path / "in.tree.npz", EvolutionTree.of_splats(unseen))
    for options in ([], ["--preset", "trained"]):
        name = str(tmp_path / f"{len(options)}.evogs")
        assert main(["encode", str(tmp_path / "in.tree.npz"), name, *options]) == 0
        warned = "encoded with the preset trained instead" in capsys.readouterr().err
        assert warned == (not options)
    assert (tmp_path / "0.evogs").read_bytes() == (tmp_path / "2.evogs").read_bytes()


@pytest.mark.thorough
def test_a_tile_may_end_before_the_last_level():
    tree = lift(make_scene(5).take(np.arange(1)), 5)
    assert tree.n_levels > arrange(tree, 1)[0].n_levels
    views = Views(tree.leaves(), cameras_around(tree.leaves(), "z", 96))
    data = TargetEncoder(tree, PRESETS["trained"], views).at_psnr(52)
    assert views.psnr(decode(data).leaves(sh_degree=tree.sh_degree)) == pytest.approx(52, abs=0.2)


@pytest.mark.thorough
def test_what_is_aimed_at_pictures_has_better_pictures_for_its_bytes():
    plain = encode(scene()[0], PRESETS["scene"])
    assert psnr(aim().at_bytes(len(plain))) > psnr(plain) + 0.5


@pytest.mark.thorough
def test_every_level_gains_by_aiming_not_the_last_alone():
    tree, _ = scene()
    plain = encode(tree, PRESETS["scene"])
    aimed = aim().at_bytes(len(plain))
    for level in range(tree.n_levels):
        views = Views(tree.leaves(level), cameras_around(tree.leaves(), "z", 96)[::3])
        found = [
            views.psnr(decode(data, partial(Cut.of_level, level=level)).leaves())
            for data in (plain, aimed)
        ]
        assert found[1] > found[0] - 0.5


@pytest.mark.thorough
@pytest.mark.parametrize("errors", [dict.fromkeys(GROUPS, 0.02), {"position": 1e-3, "sh": 0.05}])
def test_no_error_is_larger_than_asked_by_another_decoder(errors):
    tree, _ = scene()
    data = TargetEncoder(tree, PRESETS["scene"]).within(errors)
    found = float_view(oracle.decode(data))
    tiles = arrange(tree, 1)
    right = np.concatenate([tile.leaves().channels() for tile in tiles], axis=1)
    off = np.abs(found - right)
    for name, part in zip(GROUPS, GROUP_CHANNELS, strict=True):
        assert off[part].max() <= errors.get(name, math.inf)


def float_view(decoded):
    """(D, N) of what the oracle decodes, in float64 (spec 7.6)."""
    parts = []
    for tile in decoded.tiles:
        x = np.array(tile.channels, np.float64)[:, np.array(tile.live, bool)]
        x[:3] += np.array(tile.origin)[:, None]
        for exponent, part in zip(decoded.header.grid_exponents, GROUP_CHANNELS, strict=True):
            x[part] *= 2.0**-exponent
        parts.append(x)
    return np.concatenate(parts, axis=1)


def counted(monkeypatch):
    """Trees that were quantised."""
    calls = []

    def counting(*args, **options):
        calls.append(args)
        return quantise(*args, **options)

    monkeypatch.setattr("evogs_codec.encoding.prepared.quantise", counting)
    return calls


@pytest.mark.thorough
@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize(("decibels", "end"), [(120, "largest"), (5, "smallest")])
def test_a_psnr_out_of_reach_is_refused_after_three_tries_with_what_can_be_reached(
    monkeypatch, decibels, end, layers
):
    calls = counted(monkeypatch)
    with pytest.raises(TargetMissedError) as refused:
        aim(layers=layers).at_psnr(decibels)
    assert len(calls) == 3
    said = rf"{decibels} dB cannot be met: ([\d.]+) to ([\d.]+) dB can be reached, ([\d.]+) dB"
    found = re.match(rf"{said} with about ([\d.]+) bytes a splat$", str(refused.value))
    assert found
    least, most, reached, each = map(float, found.groups())
    assert least < most
    assert reached == (least if end == "smallest" else most)
    assert refused.value.by == pytest.approx(abs(decibels - reached), abs=0.06)
    data = aim(layers=layers).at_price(PRICES[end == "smallest"])
    assert psnr(data) == pytest.approx(reached, abs=0.06)
    assert len(data) / 1500 == pytest.approx(each, rel=0.15)


@pytest.mark.thorough
@pytest.mark.parametrize("has_pictures", [True, False])
def test_bytes_out_of_reach_are_refused_after_three_tries_with_what_can_be_reached(
    monkeypatch, has_pictures
):
    calls = counted(monkeypatch)
    aims = aim() if has_pictures else TargetEncoder(scene()[0], PRESETS["scene"])
    with pytest.raises(TargetMissedError) as refused:
        aims.at_bytes(10)
    assert len(calls) == 3
    said = r"10 bytes cannot be met: ([\d,]+) to ([\d,]+) bytes can be reached$"
    found = re.match(said, str(refused.value))
    assert found
    least, most = (int(n.replace(",", "")) for n in found.groups())
    assert least < most
    assert least / 1.01 <= len(aims.at_bytes(round(1.01 * least))) <= 1.01 * least
    with pytest.raises(TargetMissedError, match=f"10,000,000 bytes .*{found[1]} to {found[2]} by"):
        aims.at_bytes(10**7)


@pytest.mark.thorough
def test_an_error_out_of_reach_is_refused_after_two_tries_with_the_least(monkeypatch):
    calls = counted(monkeypatch)
    tree = scene()[0]
    with pytest.raises(TargetMissedError) as refused:
        TargetEncoder(tree, PRESETS["scene"]).within({"position": 1e-12})
    assert len(calls) == 2
    found = re.match(
        r"position: an error of 1e-12 cannot be kept: it is at least ([\d.e-]+)$",
        str(refused.value),
    )
    assert found
    least = float(found[1])
    assert TargetEncoder(tree, PRESETS["scene"]).within({"position": 1.01 * least})


def test_an_error_below_that_of_the_tree_is_refused_before_anything_is_encoded(monkeypatch):
    calls = counted(monkeypatch)
    one = TargetEncoder(scene()[0], PRESETS["scene"], leaf_error=(0.1, 0, 0, 0, 0))
    with pytest.raises(TargetMissedError, match=r"it is at least 0\.1, as float32 rounds the tree"):
        one.within({"position": 0.01})
    assert not calls


@pytest.mark.parametrize(
    ("errors", "words"),
    [({}, "of nothing"), ({"colour": 0.1, "sh": 0.1}, "of colour"), ({"sh": 0}, "above 0")],
)
def test_errors_of_no_group_are_refused(errors, words):
    with pytest.raises(ValueError, match=words):
        TargetEncoder(scene()[0], PRESETS["scene"]).within(errors)


def test_a_target_of_pictures_needs_views():
    with pytest.raises(ValueError, match="needs views"):
        TargetEncoder(scene()[0], PRESETS["scene"]).at_psnr(40)


def test_a_scene_without_splats_is_within_any_error_and_has_no_other_target(tmp_path, capsys):
    empty = EvolutionTree.of_splats(make_scene(10).take(np.zeros(0, np.int64)))
    assert decode(TargetEncoder(empty, PRESETS["scene"]).within({"position": 1e-3})).n_leaves == 0
    write_tree(tmp_path / "in.tree.npz", empty)
    for target in ("--target-psnr=40", "--target-bytes=5000"):
        assert main(["encode", str(tmp_path / "in.tree.npz"), str(tmp_path / "x"), target]) == 1
        assert "without splats" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


# --- importance -----------------------------------------------------------------------------------


# --- integers -------------------------------------------------------------------------------------


@given(st.integers(0, 2**32), st.floats(0.01, 100), st.floats(0.1, 20))
def test_integers_cost_no_more_than_rounded_ones(seed, weight, spread):
    rng = np.random.default_rng(seed)
    u = rng.laplace(0, spread, (2, 300))
    weights = weight * rng.lognormal(0, 2, u.shape)
    found = cheapest(u, weights)
    assert (found == np.rint(found)).all()

    def cost(q):
        total = float((weights * (q - u) ** 2).sum())
        for row in q:
            _, counts = np.unique(row, return_counts=True)
            total -= float((counts * np.log2(counts / counts.sum())).sum())
        return total

    assert cost(found) <= cost(np.rint(u)) + 0.05 * u.size


def test_integers_are_rounded_ones_where_errors_are_dear_and_few_where_they_are_cheap():
    u = np.linspace(-40, 40, 501)[None]
    assert (cheapest(u, np.full_like(u, 1e6)) == np.rint(u)).all()
    assert len(np.unique(cheapest(u, np.full_like(u, 1e-9)))) < 4
    assert cheapest(np.empty((3, 0)), np.empty((3, 0))).shape == (3, 0)
    far = np.array([[1e7, -3e6, 0.2]])
    assert (cheapest(far, np.full_like(far, 1e-9))[0, :2] == far[0, :2]).all()


# --- the command line -----------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_command_aims(tmp_path, capsys):
    tree, _ = scene()
    write_ply(tmp_path / "in.ply", tree.leaves())
    out = tmp_path / "out.evogs"
    encoded = ["encode", str(tmp_path / "in.ply"), str(out), "--json", "--levels", "3"]
    assert main([*encoded, "--target-bytes", "20000"]) == 0
    assert 19_600 <= json.loads(capsys.readouterr().out)["bytes"] <= 20_000
    assert main([*encoded, "--max-error", "position=0.01", "0.5"]) == 0
    assert main([*encoded, "--target-bytes", "20"]) == 1
    assert "cannot be met" in capsys.readouterr().err
    assert main([*encoded, "--target-psnr", "40", "--finer", "2"]) == 1
    assert "--finer does not go with a target" in capsys.readouterr().err
    for options in (["--bits", "8"], ["--preset", "paper"], ["--near-lossless"]):
        assert main([*encoded, *options, "--finer", "2"]) == 1
        assert "--finer divides steps" in capsys.readouterr().err
    for text, says in (
        ('{"cameras": []}', "no camera in it"),
        ("[]", "no camera in it"),
        ("", "is not JSON"),
    ):
        camera = tmp_path / "views.json"
        camera.write_text(text)
        assert main([*encoded, "--camera", str(camera)]) == 1
        said = capsys.readouterr().err
        assert said.startswith(f"evogs: {camera}")
        assert says in said


@pytest.mark.parametrize("text", ["shape=1", "0", "-1", "nan", "position=x"])
def test_errors_that_are_none_are_refused(tmp_path, text, capsys):
    write_tree(tmp_path / "in.tree.npz", EvolutionTree.of_splats(make_scene(10)))
    arguments = [
        "encode",
        str(tmp_path / "in.tree.npz"),
        str(tmp_path / "x"),
        f"--max-error={text}",
    ]
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "max-error" in capsys.readouterr().err


# --- scenes that pictures hardly show -------------------------------------------------------------


def scattered(n, *, log_scale=-4.0, centre=0.0, extent=1.0, seed=8):
    rng = np.random.default_rng(seed)
    channels = rng.normal(size=(14, n))
    channels[0:3] = rng.uniform(-0.5, 0.5, (3, n)) * extent + centre
    channels[7:10] = log_scale + 0.6 * channels[7:10]
    return SplatParams.from_channels(channels.astype(np.float32))


@pytest.mark.thorough
def test_splats_too_small_to_show_keep_their_scales_at_a_target():
    splats = scattered(600, log_scale=-11.0)
    views = Views(splats, cameras_around(splats, up="z", size=64)[::8])
    data = TargetEncoder(lift(splats, 5), PRESETS["scene"], views).at_psnr(40)
    scales = decode(data).leaves().log_scales
    assert scales.max() < splats.log_scales.max() + 3
    assert abs(views.psnr(decode(data).leaves()) - 40) < 0.2


def test_errors_are_kept_against_the_file_and_not_against_its_rounded_tree(tmp_path, capsys):
    splats = scattered(300, centre=1e5)
    scene, out = tmp_path / "far.ply", tmp_path / "far.evogs"
    write_ply(scene, splats)
    encoded = ["encode", str(scene), str(out), "--max-error", "1"]
    assert main([*encoded, "position=0.001", "--levels", "5"]) == 1
    assert "position: an error of 0.001 cannot be kept" in capsys.readouterr().err
    assert not out.exists()
    for options, largest in ((["position=0.05"], 0.05), (["position=1e-9", "--levels", "1"], 0)):
        assert main([*encoded, *options]) == 0
        found = float_view(oracle.decode(out.read_bytes()))[0:3].T
        nearest = np.abs(found[:, None] - splats.means[None]).max(2).min(0)
        assert nearest.max() <= largest


def test_a_view_that_shows_no_splat_does_not_count():
    _, views = scene()
    splats = views.scene
    away = replace(views.cameras[0], translation=views.cameras[0].translation - [0, 0, 1e6])
    with_blind = Views(splats, [*views.cameras, away])
    coarse = lift(splats, 3).leaves(1)
    assert with_blind.psnr(coarse) == views.psnr(coarse)
    assert Views(splats, [away]).psnr(coarse) == 150
