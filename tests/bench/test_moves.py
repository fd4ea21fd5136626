"""What comes while a camera moves, and in which order it is asked for."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from evogs_codec import Cut, decode, encode_scene, read_directory
from evogs_codec.render import Camera
from evogs_codec.render.demo_scene import make_scene
from tools.bench.traces import TRACES, Trace
from tools.bench.view_order import GRID, UNSEEN, Boxes, view_order


def looking(target) -> Camera:
    return Camera.look_at((0, 0, 0), target, (0, 0, 1), width=100, height=100, fov_x=1.0)


AHEAD, BACK = looking((1, 0, 0)), looking((-1, 0, 0))


def test_boxes_are_in_sight_where_the_camera_looks():
    low = np.array([[5.0, -1, -1], [-7, -1, -1], [5, 20, -1]])
    boxes = Boxes(low, low + 2)
    assert boxes.in_sight(AHEAD).tolist() == [True, False, False]
    assert boxes.in_sight(BACK).tolist() == [False, True, False]


def test_boxes_weigh_as_they_cover_the_picture():
    side = 2 * 5 * np.tan(0.5)  # of the picture, where the nearer ends of boxes are
    low, high = np.array([[5, -side / 2, -side / 2], [6, 0, side / 2]])
    boxes = Boxes(
        np.stack([low, low, [5, 0.01, 0.01], np.full(3, -1.0)]),
        np.stack([high, [6, -side / 6, -side / 6], [6, 0.02, 0.02], np.ones(3)]),
    )
    # Half of the picture, a ninth, hardly anything, and around the camera.
    assert boxes.covers(AHEAD) == pytest.approx([1 / 2, 1 / 9, 0.5 / GRID**2, 1], abs=0.03)
    assert boxes.weights(AHEAD) == pytest.approx([1, 4 / 9, UNSEEN, 1], abs=0.12)
    assert boxes.covers(BACK).tolist() == [0, 0, 0, 1]
    assert boxes.weights(BACK).tolist() == [UNSEEN, UNSEEN, UNSEEN, 1]


def test_of_many_boxes_that_cover_little_those_in_sight_come_first():
    low = np.stack(np.meshgrid([40.0, -40], np.arange(-5, 5), np.arange(-5, 5)), -1).reshape(-1, 3)
    boxes = Boxes(low, low + 1)
    weights, ahead = boxes.weights(AHEAD), low[:, 0] > 0
    assert boxes.covers(AHEAD).max() < 0.02
    assert weights[ahead].mean() > 2 * UNSEEN
    assert (weights[~ahead] == UNSEEN).all()


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


@pytest.mark.thorough
def test_what_no_picture_is_made_of_came_for_nothing():
    pytest.importorskip("gsply")
    from tools.bench.moves import trip

    in_file = source(lambda _: [0, 1, 2, 3])
    came = trip(in_file, constant(1e5, 0.0), [AHEAD], 3.5)
    assert came.n_bytes == pytest.approx(350_000, abs=2)
    # Piece 1 is out of sight, and half of piece 3 is there.
    assert came.unused == pytest.approx(149_000, abs=2)
    assert came.there(2.1) == (0, 1)


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_pieces_without_bytes_come_with_those_before_them():
    pytest.importorskip("gsply")
    from tools.bench.moves import trip

    some_empty = replace(source(lambda _: [0, 1, 2, 3]), sizes=[0, 100_000, 0, 100_000])
    came = trip(some_empty, constant(1e5, 0.0), [AHEAD, AHEAD], 0.9)
    assert came.pieces == [0, 1, 2]
    assert came.there(1.1) == (0, 1, 2)


@pytest.mark.thorough
def test_a_small_scene_while_the_camera_moves(tmp_path, monkeypatch):
    pytest.importorskip("gsply")
    from tools.bench.moves import moves
    from tools.bench.subjects import Subject

    # How the packets come is looked at, whatever effort they were made with.
    fast = partial(encode_scene, effort="fast")
    monkeypatch.setattr("tools.bench.moves.encode_scene", fast)
    rows = moves([Subject.of_scene("small", make_scene(1500), "z")], tmp_path)
    assert len(rows) == 5 * len(TRACES)
    for row in rows:
        assert 0 <= int(str(row["never used"])) <= int(str(row["bytes"]))
    end = {row["file"]: row["look 3, dB"] for row in rows if row["connection"] == "10 Mbit/s"}
    assert float(str(end["evogs, by view"])) > 20
