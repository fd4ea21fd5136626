"""The plan of tiles: which steps a tile has beside those of the stream."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evogs_codec.encoding.grids import AccuracyWarning, TooFineError
from evogs_codec.encoding.settings import Settings
from evogs_codec.jobs.plan import Plan, _raised, surveyed
from evogs_codec.model.scene_info import SceneInfo

STEP = 2.0**-10


def plan_on(exponents, n_free=2):
    """Of two levels; rows of steps after the first ones are odd multiples of one another."""
    steps = np.full((3, 5), STEP)
    plan = Plan(
        sh_degree=0,
        info=SceneInfo(),
        n_levels=2,
        exponents=exponents,
        steps=steps,
        quantisers=(),
        raised=np.zeros(steps.shape, np.int64),
        alpha={},
        settings=Settings.by_views(steps),
        n_free=n_free,
    )
    return plan._with_quantisers()


def test_a_tile_has_a_power_of_two_of_the_steps_of_the_stream():
    fine = plan_on((20,) * 5)
    assert np.all(fine.coarser(8 * fine.steps) == 3)
    assert np.all(fine.coarser(fine.steps / 8) == 0)


def test_steps_that_a_grid_made_coarser_are_not_made_so_once_more():
    coarse = plan_on((8, 20, 20, 20, 20))
    assert coarse.quantisers[-1][0].step * 2.0**-8 == 4 * STEP
    assert np.all(coarse.coarser(8 * coarse.steps) == (1, 3, 3, 3, 3))


def test_steps_of_adds_and_of_each_level_are_as_coarse_as_the_tile_asks():
    fine = plan_on((20,) * 5)
    own = fine.steps * np.array([[32], [8], [2]])
    assert fine.coarser(own).tolist() == [[5] * 5, [3] * 5, [1] * 5]
    grid = fine.grid(fine.coarser(own))
    found = np.array([[q.step for q in row] for row in grid.quantisers]) * 2.0**-20
    np.testing.assert_array_equal(found, own)


def test_steps_that_are_odd_multiples_of_one_another_stay_so():
    fine = plan_on((20,) * 5, n_free=1)
    own = fine.steps * np.array([[32], [8], [2]])
    assert fine.coarser(own).tolist() == [[5] * 5, [1] * 5, [1] * 5]
    raised = fine.with_less_of(TooFineError(0, row=1, times={0: 2.0}))
    # What the row is raised by is in its steps already.
    assert raised.coarser(8 * fine.steps)[:, 0].tolist() == [3, 2, 3]


def test_a_row_whose_numbers_are_too_large_is_raised_and_no_grid_is_coarser():
    plain = plan_on((20,) * 5)
    error = TooFineError(0, row=1, times={0: 4.0})
    raised = plain.with_less_of(error)
    assert raised.exponents == plain.exponents
    assert [row[0].step for row in raised.quantisers] == [1 << 10, 1 << 12, 1 << 10]
    assert raised.name != plain.name
    # A tile that asks for coarser steps anyway has what it asks for, not four times that.
    assert raised.coarser(8 * plain.steps)[:, 0].tolist() == [3, 1, 3]
    assert raised.coarser(2 * plain.steps)[:, 0].tolist() == [1, 0, 1]


def test_a_row_that_a_grid_has_coarser_is_raised_from_there():
    plain = plan_on((8, 20, 20, 20, 20))  # one grid unit is four steps of the plan
    before = plain.quantisers[0][0].step
    raised = plain.with_less_of(TooFineError(0, row=0, times={0: 2.0}))
    assert raised.quantisers[0][0].step >= 2 * before


def test_names_of_plans_are_short_and_tell_them_apart():
    plans = [plan_on((20,) * 5)]
    for row in range(3):
        plans += [plans[0].with_less_of(TooFineError(0, row=row, times={0: 2.0, 1: 2.0}))]
        plans += [plans[-1].with_less_of(TooFineError(0, row=row, times={0: 2.0}))]
    assert len({plan.name for plan in plans}) == len(plans)
    assert max(len(plan.name) for plan in plans) < 40


@pytest.mark.parametrize(
    ("largest", "powers"),
    [(1.0, [0, 0, 0]), (0.98 * STEP * 2**23, [0, 0, 0]), (STEP * 2**25, [3, 0, 0])],
)
def test_roots_have_steps_as_coarse_as_the_positions_of_the_widest_tile_ask(largest, powers):
    assert _raised(np.full((3, 5), STEP), largest)[:, 0].tolist() == powers


def test_leaves_that_are_coarser_than_asked_for_are_told_of():
    plain = plan_on((20,) * 5)
    plain.warn_if_coarser()
    plain.with_less_of(TooFineError(0, row=0, times={0: 4.0})).warn_if_coarser()
    with pytest.warns(AccuracyWarning, match="position: .* step is 0.00391, not 0.000977"):
        plain.with_less_of(TooFineError(0, row=2, times={0: 4.0})).warn_if_coarser()


def test_where_the_grid_is_too_fine_it_has_fewer_units():
    plain = plan_on((20,) * 5)
    less = plain.with_less_of(TooFineError(2))
    assert less.exponents == (20, 20, 19, 20, 20)
    assert not less.raised.any()
    assert less.name != plain.name


@pytest.mark.parametrize(
    ("sizes", "right"),
    [
        ([1.3, 1.0, 1.1, 1.2], [3]),  # the third in order of size: one stands for all
        ([1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.9], [2, 6]),
        ([1.3, 0.1, 1.1, 1.2], [1]),  # the others can only have coarser steps
        ([0.1, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.9], [0, 3]),
        ([1.0], [0]),
    ],
)
def test_typical_tiles_are_surveyed_or_those_with_the_smallest_splats(sizes, right):
    found: Any = SimpleNamespace(counts=np.full(len(sizes), 1000), size=lambda tile: sizes[tile])
    assert surveyed(found).tolist() == right


def test_of_no_splats_no_tile_is_surveyed():
    found: Any = SimpleNamespace(counts=np.zeros(1, np.int64), size=lambda _: 1.0)
    assert surveyed(found).tolist() == []
