"""Metadata in the coordinates of a stream follows its splats; their place in the world stays."""

import numpy as np

from evogs_codec.model.placement import placed_text
from evogs_codec.model.viewpoint import Viewpoint, default_viewpoint, poses, poses_text

CAMERA = Viewpoint((1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 45.0, (0.0, 0.0, 1.0))
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # about z
OFFSET = np.array([10.0, 0, 0])


def matrix(value):
    return np.array([float(word) for word in value.split(" ")]).reshape(4, 4)


def test_cameras_move_with_the_splats():
    text = {"camera": str(CAMERA), "cameras": poses_text([CAMERA, CAMERA]), "title": "a"}
    found = placed_text(text, 2 * QUARTER, OFFSET)
    there = Viewpoint((6.0, 2.0, 6.0), (10.0, 0.0, 2.0), 45.0, (0.0, 0.0, 1.0))
    assert default_viewpoint(found) == there
    assert poses(found) == [there, there]
    assert found["title"] == "a"


def test_a_point_stays_where_it_was_in_the_world():
    world = np.eye(4)
    world[:3, 3] = 4027893.75, 307045.5, 4919474.25
    text = {"crs": "EPSG:4978", "transform": " ".join(f"{x:.17g}" for x in world.ravel())}
    found = placed_text(text, 2 * QUARTER, OFFSET)
    point = np.array([1.0, -2, 3])
    moved = [*(2 * QUARTER @ point + OFFSET), 1]
    np.testing.assert_allclose(matrix(found["transform"]) @ moved, world @ [*point, 1], rtol=1e-15)
    assert matrix(found["transform"])[3].tolist() == [0, 0, 0, 1]
    assert found["crs"] == "EPSG:4978"


def test_coordinates_of_a_system_get_a_transform_when_they_move():
    found = placed_text({"crs": "EPSG:4978"}, np.eye(3), OFFSET)
    assert (matrix(found["transform"]) @ [11.0, 0, 0, 1]).tolist() == [1, 0, 0, 1]


def test_what_does_not_move_is_left_alone_and_what_is_malformed_is_dropped():
    text = {"camera": "no camera", "transform": "1 2", "psnr": "x"}
    assert placed_text(text, np.eye(3), np.zeros(3)) == text
    assert placed_text(text, np.eye(3), OFFSET) == {"psnr": "x"}


def test_a_matrix_whose_numbers_would_be_infinite_is_left_out(recwarn):
    text = {"transform": "1e300 0 0 1e308 0 1e300 0 1e308 0 0 1e300 1e308 0 0 0 1", "title": "x"}
    assert placed_text(text, np.eye(3), np.array([1e9, 0, 0])) == {"title": "x"}
    assert placed_text(text, 1e-12 * np.eye(3), np.zeros(3)) == {"title": "x"}
    assert not recwarn.list
