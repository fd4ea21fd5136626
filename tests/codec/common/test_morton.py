"""Points along a Z curve."""

import numpy as np

from evogs_codec.common.morton import morton_order


def test_the_first_axis_has_the_lowest_bits():
    corners = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], np.float64).T
    assert morton_order(corners[:, ::-1]).tolist() == list(range(8))[::-1]


def test_a_quarter_of_the_cube_comes_before_the_next():
    points = np.random.default_rng(1).uniform(-3, 5, (3, 500)).astype(np.float32)
    points[:, :2] = [[-3, 5]] * 3  # so that the cube is known
    octants = np.array([1, 2, 4]) @ (points[:, morton_order(points)] >= 1)
    assert (np.diff(octants) >= 0).all()


def test_points_of_no_extent_keep_their_order_and_none_are_none():
    assert morton_order(np.full((3, 4), 7.5)).tolist() == [0, 1, 2, 3]
    assert morton_order(np.empty((3, 0))).shape == (0,)


def test_the_places_of_far_and_tiny_clouds_count_alike():
    points = np.random.default_rng(2).uniform(0, 1, (3, 200))
    order = morton_order(points)
    for scale in (2.0**-1000, 2.0**900):
        np.testing.assert_array_equal(morton_order(points * scale), order)
