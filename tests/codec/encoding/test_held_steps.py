"""Steps that are held back: room is made in no picture, then one refine shows all."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import lift
from evogs_codec.encoding.arrange import arrange
from evogs_codec.encoding.corrections import corrections
from evogs_codec.encoding.held_steps import ROOTS, Run, held
from evogs_codec.encoding.sensitivity import Importance
from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.shared_sh import with_palette
from evogs_codec.model.splats import SplatParams
from evogs_codec.model.tree import EvolutionTree, Kind
from evogs_codec.render import cameras_around, psnr, render
from evogs_codec.render.demo_scene import make_scene

SPLATS = make_scene(300)
RUNS = {
    "a level": Run((1, 0), (1, 9)),
    "two levels": Run((2, 0), (3, 9)),
    "all levels but the first": Run((1, 0), (4, 9)),
    "steps of a level and of the next": Run((2, 0), (3, 0)),
}


def flat(splats):
    """The sensitivity of pictures that show all numbers alike."""
    return np.ones(splats.channels().shape, np.float32)


def tile_and_weights(tree):
    (tile,) = arrange(tree, 1)
    return tile, Importance.of([tile], tree.n_levels, flat).weights[0]


def state_after(tile, n_steps):
    """(D, n) values of the slots."""
    return next(islice(tile.states(), n_steps - 1, None)).values.copy()


def after(tile, n_steps):
    return next(islice(tile.states(), n_steps - 1, None)).splats()


def test_a_run_has_the_steps_of_each_tile_between_its_places():
    tile, _ = tile_and_weights(lift(SPLATS))
    of_two = [k for k, step in enumerate(tile.steps) if step.level == 2]
    np.testing.assert_array_equal(Run((2, 0), (2, 99)).rows(tile), of_two)
    np.testing.assert_array_equal(Run((2, 1), (2, 1)).rows(tile), of_two[1:2])
    assert not len(Run((7, 0), (7, 9)).rows(tile))


@pytest.mark.parametrize("shares_sh", [False, True])
def test_roots_come_in_one_step_and_all_that_follows_is_as_it_was(shares_sh):
    splats = make_scene(3000)
    tree: EvolutionTree | None = lift(splats, 2)
    if shares_sh:
        of_some = splats.sh[np.arange(3000) % 7, 1:]
        splats = replace(splats, sh=np.concatenate([splats.sh[:, :1], of_some], axis=1))
        tree = with_palette(lift_with_order(splats, 2), splats)
    assert tree is not None
    tile, weights = tile_and_weights(tree)
    n_first = sum(step.level == 0 for step in tile.steps)
    assert n_first > 1
    found, own = held(tile, weights, [ROOTS])
    assert [step.level for step in found.steps].count(0) == 1
    assert len(own) == len(found.steps) == len(tile.steps) - n_first + 1
    new = [one.new for one in (own[0], *weights[:n_first]) if one is not None]
    np.testing.assert_array_equal(new[0], np.hstack(new[1:]))
    assert own[1:] == weights[n_first:]
    for k in range(1, len(found.steps)):
        one, other = (
            next(islice(x.states(), n, None)) for x, n in ((found, k), (tile, k + n_first - 1))
        )
        np.testing.assert_array_equal(one.values, other.values)
        if shares_sh:
            np.testing.assert_array_equal(one.picks, other.picks)


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_the_leaves_and_all_that_follows_are_as_they_were(run):
    tile, weights = tile_and_weights(lift(SPLATS))
    found, own = held(tile, weights, [run])
    assert len(own) == len(found.steps)
    left = len(tile.steps) - run.rows(tile)[-1]
    for k in range(left):
        np.testing.assert_allclose(
            after(found, len(found.steps) - k).channels(),
            after(tile, len(tile.steps) - k).channels(),
            atol=1e-4,
        )


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_pictures_stay_as_they_were_until_the_last_step_of_a_run(run):
    tile, weights = tile_and_weights(lift(SPLATS))
    found, own = held(tile, weights, [run])
    begin = int(run.rows(tile)[0])
    camera = cameras_around(SPLATS, size=64, n=1)[0]
    before = render(after(tile, begin), camera, (1.0, 1.0, 1.0))
    rooms = [k for k, weights_of in enumerate(own) if weights_of is None]
    assert rooms == list(range(begin, begin + len(rooms)))
    for k in rooms:
        assert psnr(render(after(found, k + 1), camera, (1.0, 1.0, 1.0)), before) > 50
    last = found.steps[rooms[-1] + 1]
    assert (last.kinds == Kind.REFINE).all()
    weights_of_last = own[rooms[-1] + 1]
    assert weights_of_last is not None
    assert weights_of_last.targets.shape[1] == len(last.slots)


def test_of_a_run_that_begins_with_a_correction_only_what_it_corrects_waits_for_the_next_level():
    tile, weights = tile_and_weights(lift(SPLATS))
    begin = corrections(tile).index(True)
    level = tile.steps[begin].level
    place = level, sum(step.level == level for step in tile.steps[:begin])
    end = 1 + next(k for k, step in enumerate(tile.steps) if step.level > level)
    found, own = held(tile, weights, [Run(place, place)])
    assert len(found.steps) == len(tile.steps)  # without the correction, and with a refine
    assert all(weights_of is not None for weights_of in own)

    born_from, _ = tile.lineage()
    waits = np.isin(np.arange(len(born_from)), tile.steps[begin].slots)
    for slot, parent in enumerate(born_from):
        waits[slot] |= parent >= 0 and waits[parent]
    assert 0 < np.count_nonzero(waits) < len(waits) / 2

    before, right, split = (
        state_after(*of) for of in ((tile, begin), (tile, end), (found, end - 1))
    )
    waits = waits[: right.shape[1]]
    np.testing.assert_allclose(split[:, ~waits], right[:, ~waits], atol=1e-5)
    camera = cameras_around(SPLATS, size=64, n=1)[0]
    pictures = [
        render(SplatParams.from_channels(some), camera, (1.0, 1.0, 1.0))
        for some in (before[:, waits[: before.shape[1]]], split[:, waits])
    ]
    assert psnr(*pictures) > 50
    np.testing.assert_allclose(state_after(found, end), right, atol=1e-4)


def test_runs_are_places_of_the_tile_as_it_was():
    tile, weights = tile_and_weights(lift(SPLATS))
    first, second = Run((1, 0), (2, 0)), Run((2, 1), (3, 0))
    by_turns = held(*held(tile, weights, [second]), [first])
    for runs in ([first, second], [second, first]):
        together, _ = held(tile, weights, runs)
        assert [step.level for step in together.steps] == [s.level for s in by_turns[0].steps]
        np.testing.assert_array_equal(together.leaves().channels(), by_turns[0].leaves().channels())


def test_a_run_over_steps_that_are_held_back_already_holds_all_back():
    tile, weights = tile_and_weights(lift(SPLATS))
    once = held(tile, weights, [Run((2, 0), (2, 9))])
    twice, own = held(*once, [Run((1, 0), (2, 9))])
    rooms = [k for k, weights_of in enumerate(own) if weights_of is None]
    assert rooms == list(range(rooms[0], rooms[-1] + 1))
    np.testing.assert_allclose(twice.leaves().channels(), tile.leaves().channels(), atol=1e-4)


def test_picks_of_a_palette_are_those_of_the_tree_after_a_run():
    shared = make_scene(300)
    few = shared.sh[np.arange(len(shared)) % 7]
    shared = type(shared)(
        shared.means,
        shared.quats,
        shared.log_scales,
        shared.opacity_logits,
        np.concatenate([shared.sh[:, :1], few[:, 1:]], axis=1),
    )
    tree = with_palette(lift_with_order(shared), shared)
    assert tree is not None
    tile, _ = tile_and_weights(tree)
    weights = Importance.of([tile], tree.n_levels, flat).weights[0]
    found, _ = held(tile, weights, [Run((1, 0), (2, 9))])
    assert isinstance(found, EvolutionTree)
    np.testing.assert_allclose(found.leaves().channels(), tile.leaves().channels(), atol=1e-4)


def test_steps_that_add_or_drop_are_not_held_back():
    tile, weights = tile_and_weights(lift(SPLATS))
    found, own = held(tile, weights, [Run((0, 0), (1, 9))])
    assert found is tile
    assert own == tuple(weights)
