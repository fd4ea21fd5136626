"""Records of splats and their order, whatever lane, block or depth they have."""

import numpy as np
import pytest

from evogs_codec.render import projection
from evogs_codec.render.activated import Activated
from evogs_codec.render.lanes import LANES
from evogs_codec.render.options import Options
from evogs_codec.render.tiles import depth_order
from tests.render import scenes


@pytest.mark.parametrize("antialiased", [False, True])
def test_a_splat_has_the_same_record_in_any_lane(antialiased):
    splats, camera = scenes.ball(3 * LANES + 5), scenes.camera()
    whole = projected(splats, camera, antialiased)
    for first in (1, 7, LANES + 1):
        part = projected(splats.take(np.arange(first, len(splats))), camera, antialiased)
        for name in ("status", "depths", "records", "rows"):
            drawn = part.status == projection.DRAWN
            expected, found = getattr(whole, name)[first:], getattr(part, name)
            assert np.array_equal(part.status, whole.status[first:])
            assert np.array_equal(expected[drawn].view(np.uint8), found[drawn].view(np.uint8))
    assert (whole.status == projection.DRAWN).any()


def projected(splats, camera, antialiased):
    ready, options = Activated.of(splats), Options(antialiased=antialiased)
    made = ready.buffers
    projection.project(
        ready.means, ready.active, ready.sh,
        camera.view(options), antialiased, camera.width, camera.height,
        made.records, made.rows, made.spans, made.depths, made.status, 1,
    )  # fmt: skip
    return made


RNG = np.random.default_rng(0)
DEPTHS = {
    "all different": RNG.uniform(1, 4, 5000),
    "all equal": np.ones(100),
    "few values": RNG.integers(1, 50, 3000) / 2,
    "one": np.array([3.0]),
    "from the least to the largest": np.array([5e-324, 3, 1e300, 3, 1e-300]),
    "differ in their last bits": 1 + RNG.integers(0, 40, 5000) * 2.0**-50,
    "many are alike beside a far one": np.append(1 + RNG.uniform(0, 1e-9, 5000), 1e9),
    "some are alike beside a far one": np.concatenate(
        [RNG.uniform(1, 2, 1000), 1.5 + RNG.integers(0, 9, 12) * 2.0**-52, [1e5]]
    ),
}


@pytest.mark.parametrize("name", DEPTHS)
def test_drawn_splats_are_in_the_order_of_their_depths_and_then_of_their_indexes(name):
    depths = DEPTHS[name]
    status = np.where(np.arange(len(depths)) % 7 == 6, projection.INVISIBLE, projection.DRAWN)
    drawn = np.flatnonzero(status == projection.DRAWN)
    expected = drawn[np.argsort(depths[drawn], kind="stable")]
    assert np.array_equal(depth_order(depths, status.astype(np.uint8)), expected)
