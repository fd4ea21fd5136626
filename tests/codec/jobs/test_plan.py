"""The plan of tiles: which steps a tile has beside those of the stream."""

import numpy as np

from evogs_codec.encoding.settings import Settings
from evogs_codec.jobs.plan import Plan
from evogs_codec.model.scene_info import SceneInfo

STEP = 2.0**-10


def plan_on(exponents):
    steps = np.full((3, 5), STEP)
    plan = Plan(
        sh_degree=0,
        info=SceneInfo(),
        n_levels=2,
        exponents=exponents,
        steps=steps,
        quantisers=(),
        alpha={},
        settings=Settings.by_views(steps),
    )
    return plan._with_quantisers()


def test_a_tile_has_a_power_of_two_of_the_steps_of_the_stream():
    fine = plan_on((20,) * 5)
    assert fine.coarser(8 * fine.steps) == (3,) * 5
    assert fine.coarser(fine.steps / 8) == (0,) * 5


def test_steps_that_a_grid_made_coarser_are_not_made_so_once_more():
    coarse = plan_on((8, 20, 20, 20, 20))
    assert coarse.quantisers[-1][0].step * 2.0**-8 == 4 * STEP
    assert coarse.coarser(8 * coarse.steps) == (1, 3, 3, 3, 3)


def test_the_steps_of_leaves_are_no_coarser_than_the_tile_asks():
    fine = plan_on((20,) * 5)
    own = 8 * fine.steps
    own[-1] = 2 * STEP
    assert fine.coarser(own) == (1,) * 5
