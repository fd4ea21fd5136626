"""Parts of a level: which splats come in the same step."""

import numpy as np
import pytest

from evogs_codec import lift
from evogs_codec.encoding.arrange import MAX_BINS, arrange
from evogs_codec.model.tree import Kind
from evogs_codec.render.demo_scene import make_scene

N_LEVELS = 5


@pytest.fixture(scope="module")
def parts():
    """Splits of the steps of each level that have any."""
    (tile,) = arrange(lift(make_scene(6_000, 3), N_LEVELS), 1)
    found: list[list[int]] = [[] for _ in range(N_LEVELS)]
    for step in tile.steps:
        n_splits = int(np.count_nonzero(step.kinds == Kind.SPLIT))
        found[step.level] += [n_splits] if n_splits else []
    return found


def test_splits_that_change_least_come_with_those_before_them(parts):
    *first, last = parts[-1]
    share = sum(parts[-1]) / MAX_BINS
    assert len(first) == MAX_BINS - 2
    assert all(abs(n - share) <= 1 for n in first)
    assert abs(last - 2 * share) <= 1


def test_two_parts_stay_two(parts):
    first, last = parts[-2]
    assert 0 <= first - last <= 1
