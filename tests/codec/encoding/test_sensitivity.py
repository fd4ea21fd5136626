"""What numbers of a tree are worth to pictures."""

import math
from functools import cache

import numpy as np
import pytest

from evogs_codec import lift
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.model.splats import SplatParams
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.views import Views


@cache
def scene():
    """A lifted tree of 500 splats and views of its leaves."""
    tree = lift(make_scene(500), 3)
    return tree, Views(tree.leaves(), cameras_around(tree.leaves(), "z", 96)[::3])


def test_weights_foretell_the_error_of_the_pictures():
    """The mean squared error of pictures of splats whose SH are shaken, within 1.5 dB."""
    _, views = scene()
    splats = views.scene
    rng = np.random.default_rng(5)
    shaken = splats.channels()
    errors = np.zeros_like(shaken)
    errors[11:] = rng.normal(0, 0.02, errors[11:].shape)
    foretold = float((views.sensitivity(splats) * errors**2).sum())
    found = views.psnr(SplatParams.from_channels(shaken + errors))
    assert -10 * math.log10(foretold) == pytest.approx(found, abs=1.5)


def test_a_parent_weighs_as_much_as_the_leaves_below_it():
    tree, _ = scene()

    def one(splats):
        return np.ones((len(splats.channels()), len(splats)), np.float32)

    tiles = arrange(tree, 2)
    importance = Importance.of(tiles, tree.n_levels, one)
    for tile, steps in zip(tiles, importance.weights, strict=True):
        assert len(steps) == len(tile.steps)
        for step, own in zip(tile.steps, steps, strict=True):
            assert own is not None
            assert own.targets.shape == (5 + tree.sh_degree, step.psi.shape[1])
            assert own.new.shape == (5 + tree.sh_degree, step.n_new)
            assert (own.targets > 0).all()
            assert (own.new > 0).all()
    table = importance.steps(1e-6, extent=1.0)
    assert table.shape == (1 + tree.n_levels, 5 + tree.sh_degree)
    # Roots have the more leaves below them, the finer.
    assert (table[0, 1:] < table[-1, 1:]).all()


def test_levels_that_are_not_drawn_have_the_weights_of_what_is_below_them():
    """As if their own pictures did not matter."""
    tree, views = scene()
    tiles = arrange(tree, 2)
    drawn = []

    def recorded(splats):
        drawn.append(len(splats))
        return views.sensitivity(splats)

    def of_leaves(splats):
        found = views.sensitivity(splats)
        return found if len(splats) == tree.n_leaves else np.zeros_like(found)

    found = Importance.of(tiles, tree.n_levels, recorded, first=tree.n_levels - 1)
    assert drawn == [tree.n_leaves]
    expected = Importance.of(tiles, tree.n_levels, of_leaves)
    np.testing.assert_array_equal(found.means, expected.means)
    for steps, others in zip(found.weights, expected.weights, strict=True):
        for own, other in zip(steps, others, strict=True):
            assert own is not None
            assert other is not None
            np.testing.assert_array_equal(own.targets, other.targets)
            np.testing.assert_array_equal(own.new, other.new)
