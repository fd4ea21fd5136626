"""Trees in two steps: the roots, then all leaves in their place."""

import numpy as np

from evogs_codec import lift
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.at_once import at_once
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.render.demo_scene import make_scene
from tests.support.shared_scenes import shared_scene

SPLATS = make_scene(6000)


def arranged(tree):
    """A tile, the weights of its steps and of its leaves; each weight is another number."""
    (tile,) = arrange(tree, 1)

    def rising(splats):
        return np.arange(splats.channels().size, dtype=np.float32).reshape(splats.channels().shape)

    importance = Importance.of([tile], tree.n_levels, rising)
    return tile, importance.weights[0], importance.leaves[0]


def test_there_are_the_roots_and_then_all_leaves():
    tree = lift(SPLATS, 3)
    tile, weights, leaves = arranged(tree)
    found, own, order = at_once(tile, weights, leaves)
    assert [step.level for step in found.steps] == [0, 2]
    assert found.n_levels == tree.n_levels
    np.testing.assert_array_equal(found.leaves(0).channels(), tile.leaves(0).channels())
    np.testing.assert_array_equal(found.leaves().channels(), tile.leaves().channels())
    (*_, last) = tile.states()
    assert order is not None
    np.testing.assert_array_equal(last.splats().channels(), tile.leaves().channels())
    np.testing.assert_array_equal(order, np.flatnonzero(last.live))
    roots = [one.new for one, step in zip(weights, tile.steps, strict=True) if step.level == 0]
    of_roots, of_leaves = own
    assert of_roots is not None
    assert of_leaves is not None
    np.testing.assert_array_equal(of_roots.new, np.concatenate(roots, axis=1))
    np.testing.assert_array_equal(of_leaves.new, leaves)
    assert not of_leaves.targets.size


def test_a_tree_of_roots_and_one_with_a_palette_stay_as_they_are():
    tile, weights, leaves = arranged(lift(SPLATS, 1))
    assert at_once(tile, weights, leaves) == (tile, tuple(weights), None)
    shared = shared_scene(300, n_vectors=10)
    tree = with_palette(lift_with_order(shared, 3), shared)
    assert tree is not None
    tile, weights, leaves = arranged(tree)
    assert at_once(tile, weights, leaves)[0] is tile
