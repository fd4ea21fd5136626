"""Gains as pictures show them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from evogs_codec import PRESETS, EvolutionTree, decode, encode, lift, read_directory
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.measured_gains import MeasuredGains
from evogs_codec.encoding.packet_order import leaf_shares
from evogs_codec.encoding.quantise import quantise
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views


@pytest.fixture(scope="module")
def tree():
    return lift(make_scene(1500), 4)


@pytest.fixture(scope="module")
def views(tree):
    leaves = tree.leaves()
    return Views(leaves, cameras_around(leaves, "z", 60, n=3))


def error(views, splats):
    return 10 ** (-views.psnr(splats) / 10)


def summed(coded):
    """(n_levels, degree + 1) gains of all steps."""
    out = np.zeros((coded.n_levels, coded.sh_degree + 1))
    for share, tile in zip(leaf_shares(coded), coded.tiles, strict=True):
        for step in tile.steps:
            out[step.level] += share * np.array(step.gain)
    return out


@pytest.mark.parametrize("n_tiles", [1, 3])
def test_gains_of_levels_and_bands_add_up_to_what_pictures_show(tree, views, n_tiles):
    coded = quantise(arrange(tree, n_tiles), tree.n_levels, PRESETS["scene"])
    found = summed(MeasuredGains.of(tree, views).rescale(coded))
    leaves = tree.leaves()
    left = [error(views, tree.leaves(level)) for level in range(tree.n_levels - 1)]
    assert_allclose(found[1:, 0], -np.diff([*left, 0]), rtol=1e-6)
    assert found[0, 0] == pytest.approx(error(views, leaves.take([])) - left[0])
    without = error(views, replace(leaves, sh=leaves.sh[:, :1]))
    assert found[:, 1:].sum() == pytest.approx(without)


def test_bands_gain_where_their_level_shows_more_than_its_ancestors(tree, views):
    measured = MeasuredGains.of(tree, views)
    leaves = tree.leaves()
    without = error(views, replace(leaves, sh=leaves.sh[:, :1]))
    assert measured.bands_of_levels.sum() == pytest.approx(without)
    # Of level 0 all leaves have the SH of the roots they come from.
    born_from, live = tree.lineage()
    n_roots = tree.steps[0].n_new
    roots = np.arange(len(born_from))
    while (roots >= n_roots).any():
        roots = np.where(roots >= n_roots, born_from[roots], roots)
    sh = leaves.sh.copy()
    sh[:, 1:] = tree.leaves(0).sh[roots[live], 1:]
    gain = without - error(views, replace(leaves, sh=sh))
    assert measured.bands_of_levels[0] == pytest.approx(gain)


@pytest.mark.parametrize("with_entries", [False, True])
def test_bands_that_all_splats_share_gain_at_level_0(with_entries):
    scene = make_scene(600)
    sh = scene.sh.copy()
    sh[:, 1:] = sh[0, 1:] + np.float32(0.2)
    scene = replace(scene, sh=sh)
    lifted = lift_with_order(scene, 3)
    tree = with_palette(lifted, scene) if with_entries else lifted.tree
    assert tree is not None
    views = Views(scene, cameras_around(scene, "z", 60, n=3))
    gains = MeasuredGains.of(tree, views).bands_of_levels
    assert len(gains) == tree.n_levels
    assert abs(gains[1:]).sum() < 0.01 * gains[0]


def test_what_pictures_have_told_already_is_not_drawn_again(tree, views):
    measured = MeasuredGains.of(tree, views)
    cuts = [tree.leaves().take([]), *(tree.leaves(level) for level in range(3))]
    told = [views.psnr(cut) for cut in cuts]
    assert_allclose(MeasuredGains.of(tree, views, told).levels, measured.levels)
    assert MeasuredGains.of(tree, views, [5.0, 10.0, 20.0, 30.0]).levels[-1] == pytest.approx(1e-3)


def test_within_a_level_the_shares_stay(tree, views):
    coded = quantise(arrange(tree, 2), tree.n_levels, PRESETS["scene"])
    right = MeasuredGains.of(tree, views).rescale(coded)
    for before, after in zip(coded.tiles, right.tiles, strict=True):
        for level in range(tree.n_levels):
            old, new = (
                np.array([step.gain[0] for step in tile.steps if step.level == level])
                for tile in (before, after)
            )
            assert_allclose(new * old.sum(), old * new.sum(), atol=1e-15)


class Judge:
    """Says that SH do nothing, or nearly everything."""

    def __init__(self, matters):
        self.matters = matters

    def psnr(self, splats):
        has_sh = splats.sh.shape[1] > 1 and splats.sh[:, 1:].any()
        return 60.0 - 50.0 * (has_sh != self.matters) if len(splats) else 5.0

    def sensitivity(self, splats):
        raise AssertionError("the order of packets does not need it")

    def loss_gradient(self, splats, iteration):
        raise AssertionError("the order of packets does not need them")


class Blank(Judge):
    """Shows nothing."""

    def psnr(self, splats):
        return float("inf")


def test_bands_that_matter_come_early(tree):
    def place_of_bands(pictures):
        rows = read_directory(encode(tree, PRESETS["trained"], views=pictures)).packets
        return np.flatnonzero(rows["component"] > 0).mean()

    assert place_of_bands(Judge(matters=True)) < place_of_bands(Judge(matters=False))


@pytest.mark.parametrize("n", [0, 1])
def test_a_scene_of_no_splats_or_one_has_an_order_too(views, n):
    tree = EvolutionTree.of_splats(make_scene(500).take(np.arange(n)))
    data = encode(tree, PRESETS["trained"], views=views)
    assert len(data) == len(encode(tree, PRESETS["trained"]))
    assert len(decode(data, verify=True).leaves()) == n


@pytest.mark.thorough
def test_where_pictures_show_nothing_estimates_decide(tree):
    assert encode(tree, PRESETS["trained"], views=Blank(matters=True)) == encode(
        tree, PRESETS["trained"]
    )


def test_splats_in_one_place_can_be_drawn(tree):
    leaves = tree.leaves()
    scene = replace(leaves, means=np.zeros_like(leaves.means))
    assert np.isfinite(error(Views(scene, cameras_around(scene, "z", 20, n=2)), leaves.take([])))
