"""Scenes with infinite opacities by the command line: opaque splats stay, and pictures agree."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import decode, encode_scene, lift, read_ply, read_tree, write_ply
from evogs_codec.io.finite import OPAQUE, finite_opacities
from evogs_codec.render.demo_scene import make_scene

COUNTED = "evogs: warning: {}: 30 of 400 splats have an infinite opacity"


def with_opacities(opaque, hidden):
    """400 splats: 20 with one opacity, 10 with the other."""
    scene = make_scene(400)
    opacities = scene.opacity_logits.copy()
    opacities[:20], opacities[20:30] = opaque, hidden
    return replace(scene, opacity_logits=opacities)


@pytest.fixture
def infinite(tmp_path):
    path = tmp_path / "infinite.ply"
    write_ply(path, with_opacities(np.inf, -np.inf))
    return path


@pytest.mark.parametrize(
    "options",
    [
        ["--preset", "scene"],
        pytest.param([], marks=pytest.mark.thorough),
        pytest.param(["--drop-invalid"], marks=pytest.mark.thorough),
    ],
)
def test_opaque_splats_are_encoded_and_counted(options, evogs, infinite, tmp_path):
    code, out, err = evogs("encode", infinite, tmp_path / "x.evogs", *options)
    assert code == 0
    assert "400 splats" in out
    assert err.startswith(COUNTED.format(infinite))
    assert err.count("\n") == 1
    found = decode((tmp_path / "x.evogs").read_bytes()).leaves().opacity_logits
    assert np.count_nonzero(found > OPAQUE - 1) == 20
    assert np.count_nonzero(found < 1 - OPAQUE) == 10


@pytest.mark.parametrize(
    "preset",
    ["scene", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("trained", "paper"))],
)
def test_opaque_splats_stay_opaque_under_every_preset(preset, evogs, infinite, tmp_path):
    assert evogs("encode", infinite, tmp_path / "x.evogs", "--preset", preset)[0] == 0
    found = decode((tmp_path / "x.evogs").read_bytes()).leaves().opacity_logits
    opaque = found[found > OPAQUE - 3]
    assert (len(opaque), (1 / (1 + np.exp(-opaque)) == np.float32(1)).all()) == (20, True)


def test_opaque_splats_are_lifted_and_counted(evogs, infinite, tmp_path):
    code, _, err = evogs("lift", infinite, tmp_path / "x.tree.npz")
    assert code == 0
    assert err.startswith(COUNTED.format(infinite))
    assert read_tree(tmp_path / "x.tree.npz").n_leaves == 400


def test_the_library_lifts_opaque_splats_that_it_did_not_read():
    splats, n = finite_opacities(with_opacities(np.inf, -np.inf))
    assert (n, lift(splats, 3).n_leaves) == (30, 400)


def test_pictures_of_infinite_opacities_are_those_of_large_ones(evogs, infinite, tmp_path):
    finite = tmp_path / "finite.ply"
    write_ply(finite, with_opacities(60, -60))
    for source in (infinite, finite):
        code, _, err = evogs("render", source, source.with_suffix(".png"), "--size", 64)
        assert (code, bool(err)) == (0, source is infinite)
    assert infinite.with_suffix(".png").read_bytes() == finite.with_suffix(".png").read_bytes()


@pytest.mark.thorough
@pytest.mark.usefixtures("any_views")
def test_psnr_is_against_opaque_splats_too(evogs, infinite, tmp_path):
    dropped, stream = tmp_path / "dropped.ply", tmp_path / "x.evogs"
    write_ply(dropped, with_opacities(0, 0).take(np.arange(20, 400)))
    assert evogs("encode", infinite, stream)[0] == 0

    def psnr_of(source):
        code, out, err = evogs("psnr", source, infinite, "--size", 64)
        assert code == 0
        assert COUNTED.format(infinite) in err
        return float(out.split()[0])

    assert psnr_of(stream) > psnr_of(dropped) + 5


@pytest.mark.thorough
def test_a_scene_with_infinite_opacities_looks_as_well_as_one_with_clamped_logits(evogs, tmp_path):
    """Hundreds of opaque splats, encoded without an option, each against its own source."""
    scene = make_scene(3000)
    logits = scene.opacity_logits.copy()
    logits[np.argsort(logits)[-250:]], logits[np.argsort(logits)[:60]] = np.inf, -np.inf
    found = {}
    for clamp in (np.inf, 60, 20, 10):
        source, stream = tmp_path / f"{clamp}.ply", tmp_path / f"{clamp}.evogs"
        write_ply(source, replace(scene, opacity_logits=np.clip(logits, -clamp, clamp)))
        assert evogs("encode", source, stream)[0] == 0
        code, out, _ = evogs("psnr", stream, source)
        assert code == 0
        found[clamp] = float(out.split()[0]), stream.stat().st_size
    db, n_bytes = found.pop(np.inf)
    assert db > 35
    for other_db, other_bytes in found.values():
        assert db >= other_db - 0.1, found
        assert n_bytes <= 1.01 * other_bytes, found


@pytest.mark.thorough
@pytest.mark.usefixtures("any_views")
def test_logits_that_render_the_same_give_the_same_stream():
    large, bounded = with_opacities(60, -60), with_opacities(OPAQUE, -OPAQUE)
    assert encode_scene(large) == encode_scene(bounded)
    assert encode_scene(large, preset="scene") != encode_scene(bounded, preset="scene")
    found = decode(encode_scene(large, max_error=0.1)).leaves().opacity_logits
    assert np.count_nonzero(found > 59) == 20  # who asks for numbers gets them


@pytest.mark.parametrize("odd", [np.inf, -np.inf, np.nan])
def test_the_library_refuses_opacities_that_are_not_finite(odd):
    with pytest.raises(ValueError, match="20 of 400 splats have a number that is not finite"):
        encode_scene(with_opacities(odd, 0))


@pytest.mark.thorough
def test_other_numbers_that_are_not_finite_are_refused_as_before(evogs, refused, tmp_path):
    scene = with_opacities(np.inf, -np.inf)
    opacities, means = scene.opacity_logits.copy(), scene.means.copy()
    opacities[50], means[3, 0] = np.nan, np.inf  # of splat 3 the opacity is infinite too
    path = tmp_path / "bad.ply"
    write_ply(path, replace(scene, opacity_logits=opacities, means=means))
    code, _, err = evogs("encode", path, tmp_path / "x.evogs")
    assert code == 1
    assert err.splitlines()[1].startswith(f"evogs: {path}: 2 of 400 splats have a NaN")
    code, out, _ = evogs("encode", path, tmp_path / "x.evogs", "--drop-invalid")
    assert code == 0
    assert "398 splats" in out
    with pytest.warns(UserWarning, match="30 of 400"):
        assert np.count_nonzero(~read_ply(path).finite()) == 2
