"""What comes while a camera moves, and in which order it is asked for."""

from dataclasses import replace

import numpy as np
import pytest

from evogs_codec import Cut, decode, encode_scene, read_directory
from evogs_codec.render import Camera
from evogs_codec.render.demo_scene import make_scene
from tools.bench.traces import TRACES, Trace
from tools.bench.view_order import UNSEEN, Boxes, view_order


def looking(target) -> Camera:
    return Camera.look_at((0, 0, 0), target, (0, 0, 1), width=100, height=100, fov_x=1.0)


AHEAD, BACK = looking((1, 0, 0)), looking((-1, 0, 0))


def test_boxes_are_in_sight_where_the_camera_looks():
    low = np.array([[5.0, -1, -1], [-7, -1, -1], [5, 20, -1]])
    boxes = Boxes(low, low + 2)
    assert boxes.in_sight(AHEAD).tolist() == [True, False, False]
    assert boxes.in_sight(BACK).tolist() == [False, True, False]
    assert boxes.weights(AHEAD).tolist() == [1, UNSEEN, UNSEEN]
    # Half as far away, and half out of sight.
    nearer = Boxes(np.array([[10.0, -1, -1], [5, -1, -1]]), np.array([[12.0, 1, 1], [6, 5, 1]]))
    weights = nearer.weights(AHEAD)
    assert weights[1] == 1
    assert UNSEEN < weights[0] < 0.8
    around = Boxes(np.full((1, 3), -1.0), np.full((1, 3), 1.0))
    assert around.weights(AHEAD).tolist() == [1.0]


@pytest.mark.thorough
def test_packets_by_view_lack_none_that_they_need():
    data = encode_scene(make_scene(3000), preset="scene", n_tiles=6, levels=3)
    directory = read_directory(data)
    weights = np.array([0.1, 1, 0.5, 0.05, 0.9, 0.2])
    order = view_order(directory, weights)
    assert sorted(order) == list(range(len(directory.packets)))
    assert view_order(directory, np.ones(6)).tolist() == sorted(order)
    for n in range(0, len(order), 7):
        decode(data, Cut.of_rows(directory, np.sort(order[:n])))
    tiles = directory.packets["tile"][order]
    means = [float(np.flatnonzero(tiles == tile).mean()) for tile in range(6)]
    assert np.argsort(means).tolist() == np.argsort(-weights).tolist()
    last = [int(np.flatnonzero(tiles == tile)[-1]) for tile in range(6)]
    assert last[1] < last[4] < last[3]


def source(order, first=()):
    pytest.importorskip("gsply")
    from tools.bench.moves import Source

    return Source(
        "",
        head=1000,
        sizes=[100_000] * 4,
        first=first,
        order=order,
        drawn=lambda there, camera: {i for i in there if i % 2 == (camera is BACK)},
        scene=lambda _: None,
    )


def constant(rate, round_trip):
    return Trace("", round_trip, np.full(1000, rate))


def test_what_no_picture_is_made_of_came_for_nothing():
    pytest.importorskip("gsply")
    from tools.bench.moves import trip

    in_file = source(lambda _: [0, 1, 2, 3])
    came = trip(in_file, constant(1e5, 0.0), [AHEAD], 3.5)
    assert came.n_bytes == pytest.approx(350_000, abs=2)
    # Piece 1 is out of sight, and half of piece 3 is there.
    assert came.unused == pytest.approx(149_000, abs=2)
    assert came.there(2.1) == (0, 1)


def test_after_a_move_the_client_asks_anew():
    pytest.importorskip("gsply")
    from tools.bench.moves import trip

    by_view = source(lambda camera: [0, 2, 1, 3] if camera is AHEAD else [1, 3, 0, 2])
    trace = constant(1e5, 0.25)
    came = trip(by_view, trace, [AHEAD, BACK], 2.0)
    # 0.5 s until the head comes, 1.49 s of pieces, then 0.25 s until others come.
    assert came.pieces == [0, 1]
    assert came.seconds == pytest.approx([1.51, 3.25], abs=0.01)
    assert came.n_bytes == pytest.approx(1000 + 149_000 + 175_000, abs=5)
    assert came.unused == pytest.approx(49_000 + 75_000, abs=5)
    # Without a move nothing is asked for again.
    still = trip(by_view, trace, [AHEAD, AHEAD], 2.0)
    assert still.n_bytes == pytest.approx(350_000, abs=5)


def test_pieces_without_bytes_come_with_those_before_them():
    pytest.importorskip("gsply")
    from tools.bench.moves import trip

    some_empty = replace(source(lambda _: [0, 1, 2, 3]), sizes=[0, 100_000, 0, 100_000])
    came = trip(some_empty, constant(1e5, 0.0), [AHEAD, AHEAD], 0.9)
    assert came.pieces == [0, 1, 2]
    assert came.there(1.1) == (0, 1, 2)


@pytest.mark.thorough
def test_a_small_scene_while_the_camera_moves(tmp_path):
    pytest.importorskip("gsply")
    from tools.bench.moves import moves
    from tools.bench.subjects import Subject

    rows = moves([Subject.of_scene("small", make_scene(1500), "z")], tmp_path)
    assert len(rows) == 5 * len(TRACES)
    for row in rows:
        assert 0 <= int(str(row["never used"])) <= int(str(row["bytes"]))
    end = {row["file"]: row["look 3, dB"] for row in rows if row["connection"] == "10 Mbit/s"}
    assert float(str(end["evogs, by view"])) > 20
