"""Palettes by the command line: taken where they pay, and what is said of them."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from evogs_codec import (
    PRESETS,
    AccuracyWarning,
    NotRepresentableError,
    decode,
    encode,
    read_directory,
)
from evogs_codec.cli.commands import main
from evogs_codec.io.ply import write_ply
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from tests.support.shared_scenes import shared_scene, shared_tree

OPTIONS = [
    [],
    ["--bits", "8"],
    ["--near-lossless"],
    ["--max-error", "0.01"],
    pytest.param(["--target-psnr", "43"], marks=pytest.mark.thorough),
    pytest.param(["--target-bytes", "30000"], marks=pytest.mark.thorough),
]


@pytest.mark.thorough
@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: " ".join(option))
def test_the_command_takes_a_palette_where_it_pays(tmp_path, capsys, option):
    assert encoded(tmp_path, capsys, shared_scene(), option) == [True, False]


@pytest.mark.thorough
@pytest.mark.parametrize("option", OPTIONS[:1], ids=lambda option: " ".join(option))
def test_the_command_takes_none_where_psi_are_smaller(tmp_path, capsys, option):
    splats = shared_scene(1600, 380, degree=1)
    faint = np.concatenate([splats.sh[:, :1], splats.sh[:, 1:] * np.float32(0.005)], axis=1)
    option = [*option, "--levels", "5"]
    assert encoded(tmp_path, capsys, replace(splats, sh=faint), option) == [False, False]


def encoded(tmp_path, capsys, splats, option):
    """Whether streams have a palette, of the command and with `--no-palette`, never smaller."""
    write_ply(tmp_path / "a.ply", splats)
    sizes, palettes = [], []
    for more in ([], ["--no-palette"]):
        out = tmp_path / "a.evogs"
        main(["encode", str(tmp_path / "a.ply"), str(out), "--json", "--effort=1", *option, *more])
        assert json.loads(capsys.readouterr().out)["bytes"] == out.stat().st_size
        data = out.read_bytes()
        palettes.append(read_directory(data).has_palette)
        sizes.append(len(data))
    assert sizes[0] <= sizes[1] or "--target-bytes" in option
    return palettes


def test_bytes_are_met_where_nothing_draws(tmp_path, monkeypatch):
    monkeypatch.setattr("evogs_codec.scene.request.find_spec", lambda _: None)
    write_ply(tmp_path / "a.ply", shared_scene(400, 50))
    out = tmp_path / "a.evogs"
    main(["encode", str(tmp_path / "a.ply"), str(out), "--target-bytes", "9000"])
    assert 0.98 * 9000 <= out.stat().st_size <= 9000


@pytest.mark.thorough
def test_a_target_that_is_missed_is_said_with_the_nearest(tmp_path, capsys):
    scene = shared_scene(300, 20)
    means = scene.means.copy()
    means[:2] = [[-3e4] * 3, [3e4] * 3]  # no grid has 119 dB of the others
    write_ply(tmp_path / "a.ply", replace(scene, means=means))
    said = []
    for more in ([], ["--no-palette"]):
        names = [str(tmp_path / "a.ply"), "x"]
        assert main(["encode", *names, "--target-psnr", "119", "--effort", "1", *more]) == 1
        said.append(float(capsys.readouterr().err.split("be reached, ")[1].split(" dB")[0]))
    assert said[0] >= said[1]


@pytest.mark.thorough
def test_one_vector_that_is_huge_makes_others_no_coarser_than_psi_would(tmp_path):
    splats = shared_scene(600, 40)
    sh = splats.sh.copy()
    sh[np.all(sh[:, 1:] == sh[5, 1:], axis=(1, 2)), 1:] = 1e5
    steps = []
    lifted = lift_with_order(replace(splats, sh=sh), 3)
    tree = with_palette(lifted, replace(splats, sh=sh))
    assert tree is not None
    for one in (tree, lifted.tree):
        directory = read_directory(encode(one, PRESETS["scene"]))
        steps.append(directory.quantisers[0][5].step * 2.0 ** -directory.grid_exponents[4])
    assert steps[0] <= steps[1]


def test_huge_colours_make_the_entries_of_a_palette_no_coarser():
    splats = shared_scene(600, 40)
    sh = splats.sh.copy()
    sh[:200, 0] = 1e6
    splats = replace(splats, sh=sh)
    tree = with_palette(lift_with_order(splats, 3), splats)
    assert tree is not None
    with pytest.warns(AccuracyWarning, match="sh: values span so much"):
        data = encode(tree, PRESETS["scene"])
    colour, above = (read_directory(data).quantisers[0][kind].step for kind in (4, 5))
    assert colour >= 2 * above
    found, right = decode(data).leaves().sh[:, 1:], tree.leaves().sh[:, 1:]
    off = cKDTree(right.reshape(len(right), -1)).query(found.reshape(len(found), -1), p=np.inf)[0]
    assert off.max() < 0.02  # with steps as coarse as those of colours 0.06


def test_huge_numbers_are_refused_without_warnings():
    splats = shared_scene(200, 10)
    lifted = lift_with_order(replace(splats, sh=splats.sh * np.float32(1e30)), 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tree = with_palette(lifted, replace(splats, sh=splats.sh * np.float32(1e30)))
    assert tree is not None
    with pytest.raises(NotRepresentableError):
        encode(tree, PRESETS["scene"])


def test_a_part_by_sh_degree_says_that_a_palette_stays_whole(tmp_path, capsys):
    _, tree = shared_tree(shared_scene(300, 20))
    (tmp_path / "a.evogs").write_bytes(encode(tree, PRESETS["scene"]))
    source, one, other = (str(tmp_path / f"{name}.evogs") for name in "abc")
    main(["extract", source, one, "--sh-degree", "1"])
    assert "only --sh-degree 0 leaves packets out" in capsys.readouterr().err
    main(["extract", source, other, "--sh-degree", "0"])
    assert not capsys.readouterr().err
