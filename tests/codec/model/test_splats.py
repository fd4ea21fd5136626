"""Splats, one after another."""

import numpy as np
import pytest

from evogs_codec import SplatParams
from tests.support.odd_scenes import odd_scene


def test_joined_splats_follow_one_another_at_the_highest_sh_degree():
    first, second = odd_scene(5, 1), odd_scene(7, 3)
    found = SplatParams.joined([first, second])
    assert (len(found), found.sh_degree) == (12, 3)
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        expected = np.concatenate([getattr(first, name), getattr(second, name)])
        assert np.array_equal(getattr(found, name), expected)
    assert np.array_equal(found.sh[:5, :4], first.sh)
    assert not found.sh[:5, 4:].any()
    assert np.array_equal(found.sh[5:], second.sh)


def test_of_no_splats_the_degree_counts_as_well():
    found = SplatParams.joined([odd_scene(5, 0), odd_scene(7, 2).take(slice(0))])
    assert (len(found), found.sh_degree) == (5, 2)


def test_there_is_something_to_join():
    with pytest.raises(ValueError, match="empty"):
        SplatParams.joined([])
