"""Views of a tile among others: which of them put packets in order."""

import numpy as np
import pytest

pytest.importorskip("numba")

from evogs_codec.jobs.surroundings import Neighbourhood, Standing
from evogs_codec.render.demo_scene import make_scene


@pytest.mark.parametrize(("all_round", "n_circle"), [(True, 8), (False, 12)])
def test_packets_are_put_in_order_by_views_on_the_circle(all_round, n_circle):
    splats = make_scene(60)
    standing = Standing.around(splats, up="z", n_views=12, all_round=all_round, pixels=None)
    views = Neighbourhood.of(splats, standing, 60, keep=1.0)
    heights = np.array([camera.position[2] for camera in views.views.cameras])
    assert len(heights) == 12
    assert np.ptp(heights[:n_circle]) < 1e-6
    ordering = views.fewer(3).views.cameras
    assert len(ordering) == 3
    assert [camera.position[2] for camera in ordering] == pytest.approx([heights[0]] * 3)
