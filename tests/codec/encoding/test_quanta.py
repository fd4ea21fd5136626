"""Trees that were trained in integers: streams keep them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import decode, encode
from evogs_codec.cli.commands import main
from evogs_codec.encoding.settings import Settings
from evogs_codec.io.tree_npz import write_tree
from evogs_codec.model.channels import GROUPS
from tests.support.quanta import in_quanta


@pytest.mark.parametrize("n_tiles", [1, 3])
def test_a_tree_that_was_trained_in_integers_keeps_them(n_tiles, tmp_path, capsys):
    tree = in_quanta()
    write_tree(tmp_path / "in.tree.npz", tree)
    names = [str(tmp_path / name) for name in ("in.tree.npz", "out.evogs")]
    assert main(["encode", *names, "--tiles", str(n_tiles)]) == 0
    assert capsys.readouterr().err == ""
    found = decode((tmp_path / "out.evogs").read_bytes()).leaves(sh_degree=0).channels()
    right = tree.leaves().channels()
    off = np.abs(found[:, :, None] - right[:, None]).max(0)
    assert sorted(off.argmin(1)) == list(range(16))
    assert off.min(1).max() <= 2 * 0.25 / 32  # products of alpha are rounded to the grid, twice
    assert encode(tree) == encode(tree, Settings.of_quanta(tree.quanta))


def test_an_option_of_accuracy_comes_before_the_integers_of_a_tree(tmp_path):
    write_tree(tmp_path / "in.tree.npz", in_quanta())
    sizes = []
    for options in ([], ["--preset", "trained"], ["--near-lossless"]):
        name = str(tmp_path / "out.evogs")
        assert main(["encode", str(tmp_path / "in.tree.npz"), name, *options]) == 0
        sizes.append((tmp_path / "out.evogs").stat().st_size)
    assert sizes == sorted(sizes)
    assert len(set(sizes)) == 3


@pytest.mark.parametrize(
    "quantum",
    [
        1e-30,
        pytest.param(2.0**-60, marks=pytest.mark.thorough),
        pytest.param(2.0**60, marks=pytest.mark.thorough),
        1e30,
    ],
)
def test_quanta_that_no_grid_holds_are_warned_of(quantum, tmp_path, capsys):
    write_tree(tmp_path / "in.tree.npz", replace(in_quanta(), quanta=((quantum,) * 5,) * 4))
    assert main(["encode", str(tmp_path / "in.tree.npz"), str(tmp_path / "out.evogs")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(GROUPS)
    assert all("no grid holds the quanta of the tree" in line for line in lines)
    assert decode((tmp_path / "out.evogs").read_bytes(), verify=True).n_leaves == 16


@pytest.mark.parametrize(
    "quanta",
    [
        ((0.5,) * 5,) * 3,
        ((0.5,) * 5,) * 5,
        ((0.5,) * 6,) * 4,
        ((0.5,) * 5,) * 3 + ((0.5,) * 4,),
        ((0.5,) * 5,) * 3 + ((0.5,) * 4 + (0.0,),),
        ((0.5,) * 5,) * 3 + ((0.5,) * 4 + (math.nan,),),
    ],
)
def test_quanta_of_another_shape_or_sign_are_no_quanta(quanta):
    with pytest.raises(ValueError, match=r"quanta are not \(4, 5\) finite numbers above 0"):
        replace(in_quanta(), quanta=quanta)
