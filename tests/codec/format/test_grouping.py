"""Planes share frames where that is smaller."""

from __future__ import annotations

import numpy as np
import pytest

from evogs_codec.format.frames import MAX_BLOCK, compress
from evogs_codec.format.grouping import grouped

EFFORT = 19


def plane(n, spread, seed=0):
    """n bytes of a geometric distribution: the larger the spread, the more of them differ."""
    rng = np.random.default_rng(seed)
    return np.minimum(rng.geometric(1 / spread, n) - 1, 255).astype(np.uint8).tobytes()


def size(planes, runs):
    return sum(len(compress(b"".join(planes[a:b]), EFFORT)) for a, b in runs)


def test_every_plane_is_in_one_frame_in_order():
    planes = [plane(n, s, n) for n, s in ((10, 2), (2000, 9), (0, 1), (2000, 9), (7, 200))]
    runs = grouped(planes)
    assert [k for a, b in runs for k in range(a, b)] == list(range(len(planes)))
    assert grouped([]) == []
    assert grouped([b""]) == [(0, 1)]


def test_small_planes_and_those_that_are_alike_share_a_frame():
    assert grouped([plane(300, 5, k) for k in range(6)]) == [(0, 6)]


def test_unlike_planes_have_frames_of_their_own():
    planes = [plane(20_000, 2), plane(20_000, 100), plane(20_000, 2, 1)]
    assert grouped(planes) == [(0, 1), (1, 2), (2, 3)]


def test_no_frame_of_several_planes_is_longer_than_a_block():
    planes = [plane(MAX_BLOCK // 2, 5, k) for k in range(5)]
    assert all(sum(map(len, planes[a:b])) <= MAX_BLOCK for a, b in grouped(planes))
    assert grouped([plane(3 * MAX_BLOCK, 5)]) == [(0, 1)]


@pytest.mark.parametrize("n", [50, 500, 5000])
def test_frames_are_smaller_than_one_of_all_and_than_one_of_each(n):
    planes = [plane(n, s, k) for k, s in enumerate((2, 2, 3, 40, 30, 2, 1.1, 1.1, 80, 3))]
    found = size(planes, grouped(planes)) + 5 * len(grouped(planes))
    one, each = [(0, len(planes))], [(k, k + 1) for k in range(len(planes))]
    assert found <= 1.01 * (size(planes, one) + 5)
    assert found <= 1.01 * (size(planes, each) + 5 * len(planes))
