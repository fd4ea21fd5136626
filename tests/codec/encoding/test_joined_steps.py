"""Steps that come as one: the same leaves, fewer states, and numbers of slots that are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import PRESETS, TargetEncoder, decode, lift
from evogs_codec.encoding.arrange import arrange, leaf_order
from evogs_codec.encoding.corrections import corrections
from evogs_codec.encoding.held_steps import Run
from evogs_codec.encoding.joined_steps import Joined, composed, joined, joined_tiles
from evogs_codec.encoding.layers import Layering
from evogs_codec.encoding.search import Found
from evogs_codec.encoding.sensitivity import Importance, StepWeights
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.siblings import Siblings
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.scene.found_stream import FoundStream

LAST = Run((2, 0), (2, 9))


def lifted(shares_sh=False):
    splats = make_scene(6000)
    if not shares_sh:
        return lift(splats, 3)
    of_some = splats.sh[np.arange(6000) % 7, 1:]
    splats = replace(splats, sh=np.concatenate([splats.sh[:, :1], of_some], axis=1))
    return with_palette(lift_with_order(splats, 3), splats)


def tile_and_weights(tree):
    (tile,) = arrange(tree, 1)

    def of_each(splats):
        """Other weights for each number of each splat."""
        return np.abs(splats.channels()) + np.float32(0.1)

    importance = Importance.of([tile], tree.n_levels, of_each)
    return tile, importance.weights[0], importance.leaves[0]


def must_join(tile, weights, run) -> Joined:
    found = joined(tile, weights, run)
    assert found is not None
    return found


def state_after(tile, n_steps):
    return next(islice(tile.states(), n_steps - 1, None))


def levels_of(tile):
    return [step.level for step in tile.steps]


@pytest.mark.parametrize("shares_sh", [False, True])
@pytest.mark.parametrize("run", [LAST, Run((1, 0), (1, 9))])
def test_the_splits_of_a_level_come_as_one_step_and_its_corrections_as_another(shares_sh, run):
    tile, weights, of_leaves = tile_and_weights(lifted(shares_sh))
    level = run.first[0]
    n_splits = sum(step.level == level and step.n_new > 0 for step in tile.steps)
    assert n_splits > 1
    found = must_join(tile, weights, run)
    own = [step for step in found.tile.steps if step.level == level]
    assert [bool(np.all(step.kinds == Kind.SPLIT)) for step in own] == [True, False][: len(own)]
    assert len(own) == 1 or corrections(found.tile)[levels_of(found.tile).index(level) + 1]
    n_whole = len(tile.steps)
    before, after = state_after(tile, n_whole), state_after(found.tile, len(found.tile.steps))
    np.testing.assert_array_equal(after.values, before.values[:, found.order])
    np.testing.assert_array_equal(after.live, before.live[found.order])
    if shares_sh:
        np.testing.assert_array_equal(after.picks, before.picks[found.order])
    # Weights are those of the same records.
    assert len(found.weights) == len(found.tile.steps)
    again = Importance.of(
        [found.tile], tile.n_levels, lambda splats: np.abs(splats.channels()) + np.float32(0.1)
    )
    for one, other in zip(found.weights, again.weights[0], strict=True):
        assert one is not None
        assert other is not None
        np.testing.assert_allclose(one.targets, other.targets, rtol=1e-5)
        np.testing.assert_allclose(one.new, other.new, rtol=1e-5)
    np.testing.assert_array_equal(found.leaves(of_leaves), again.leaves[0])


def test_states_at_the_ends_of_other_levels_stay():
    tile, weights, _ = tile_and_weights(lifted())
    found = must_join(tile, weights, Run((1, 0), (1, 9)))
    for level in (0, 1, 2):
        one, other = (
            state_after(t, sum(own <= level for own in levels_of(t))).splats().means
            for t in (tile, found.tile)
        )
        order_of_one, order_of_other = (np.lexsort(means.T) for means in (one, other))
        np.testing.assert_array_equal(one[order_of_one], other[order_of_other])


def test_a_run_that_is_one_step_or_spans_levels_or_begins_with_a_correction_is_not_joined():
    tile, weights, _ = tile_and_weights(lifted())
    first_correction = corrections(tile).index(True)
    level = tile.steps[first_correction].level
    assert joined(tile, weights, Run((2, 0), (2, 0))) is None
    assert joined(tile, weights, Run((1, 0), (2, 9))) is None
    assert joined(tile, weights, Run((level, 1), (level, 9))) is None
    assert joined(tile, weights, Run((0, 0), (0, 9))) is None  # adds
    assert joined(tile, weights, Run((7, 0), (7, 9))) is None
    whole = must_join(tile, weights, LAST)
    assert joined(whole.tile, whole.weights, LAST) is None  # it is joined already


def test_steps_of_which_only_some_have_weights_or_picks_are_not_joined():
    tile, weights, _ = tile_and_weights(lifted())
    first = levels_of(tile).index(2)
    assert joined(tile, (*weights[:first], None, *weights[first + 1 :]), LAST) is None
    tile, weights, _ = tile_and_weights(lifted(shares_sh=True))
    first = levels_of(tile).index(2)
    assert len(tile.steps[first].picks)
    nothing = np.empty(0, np.int32)
    none = replace(tile.steps[first], picks=nothing, changed_picks=nothing)
    tile = replace(tile, steps=(*tile.steps[:first], none, *tile.steps[first + 1 :]))
    assert joined(tile, weights, LAST) is None


def test_siblings_of_later_refines_are_found_again():
    tile, weights, _ = tile_and_weights(lifted())
    born_from, live = tile.lineage()
    slots = np.flatnonzero(live)
    refine = Step.of_refines(3, slots, np.zeros((len(tile.steps[0].adds), len(slots))))
    whole = replace(tile, steps=(*tile.steps, refine))
    n_classes = len(weights[0].targets)
    targets = np.ones((n_classes, len(slots)), np.float32)
    siblings = Siblings.of(slots.astype(np.int32), born_from)
    own = StepWeights(3, targets, targets[:, :0], siblings)
    found = must_join(whole, (*weights, own), LAST)
    last = found.weights[-1]
    assert last is not None
    assert last.siblings is not None
    of_new = Siblings.of(found.tile.steps[-1].slots, found.tile.lineage()[0])
    np.testing.assert_array_equal(last.siblings.parents, of_new.parents)


def test_all_tiles_that_have_the_run_are_joined_or_none():
    tile, weights, _ = tile_and_weights(lifted())
    only_roots = replace(tile, steps=tile.steps[:1])
    found = joined_tiles([only_roots, tile], [weights[:1], weights], LAST)
    assert found is not None
    assert [one.order is None for one in found] == [True, False]
    assert found[0].tile is only_roots
    whole = must_join(tile, weights, LAST)
    both = [tile, whole.tile], [weights, whole.weights]
    assert joined_tiles(*both, LAST) is None
    assert joined_tiles([only_roots], [weights[:1]], LAST) is None


def test_numbers_of_slots_that_changed_twice():
    first, then = np.array([2, 0, 1]), np.array([1, 2, 0])
    (both,) = composed([first], [then])
    names = np.array(["a", "b", "c"])
    np.testing.assert_array_equal(names[both], names[first][then])
    assert composed([None], [None]) == [None]
    np.testing.assert_array_equal(composed([None], [then])[0], then)
    np.testing.assert_array_equal(composed([first], [None])[0], first)


@pytest.mark.parametrize("layering", [Layering(1), Layering(2), Layering(2, is_late=True)])
@pytest.mark.parametrize(("n_tiles", "level"), [(1, 1), (1, 2), (2, 2)])
def test_the_leaves_of_a_stream_are_known_by_their_numbers(layering, n_tiles, level):
    tree = lifted()
    splats = tree.leaves()
    views = Views(splats, cameras_around(splats, "z", 60, n=4))
    encoder = TargetEncoder(tree, PRESETS["scene"], views, layers=2, n_tiles=n_tiles)
    found = FoundStream.of(encoder, lambda one, _: Found(1e-11, np.nan, one.at_price(1e-11)), 1e-11)
    run = Run((level, 0), (level, 9))
    other = found.holding([run], layering).made()
    assert other.encoder is not None
    n_steps = [
        [len(run.rows(tile)) for tile in one.prepared.tiles] for one in (encoder, other.encoder)
    ]
    assert all(before > after for before, after in zip(*n_steps, strict=True))
    order = leaf_order(tree, n_tiles, other.orders)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(splats)))
    shown = decode(other.data).leaves()
    of_splats = np.abs(shown.means - splats.means[order]).max()
    assert of_splats < 0.05 * np.abs(shown.means - splats.means).max()
    # At once, the slots that were joined are numbered a third time.
    whole = other.at_once().made()
    assert whole.is_at_once
    assert not other.is_at_once
    order = leaf_order(tree, n_tiles, whole.orders)
    assert np.abs(decode(whole.data).leaves().means - splats.means[order]).max() <= 2 * of_splats
