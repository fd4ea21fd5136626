"""Replayed connections, and files over them."""

from functools import partial

import numpy as np
import pytest

from tools.bench.traces import FIRST, MEGABIT, STEP, TRACES, ByteRange, Trace, replay

SIZE = 1_000_000


def constant(rate, round_trip=0.0):
    return Trace("", round_trip, np.full(1000, rate))


def test_bytes_come_at_the_rate_behind_two_round_trips():
    asked: list[ByteRange] = []
    arrival = replay(constant(1e6, 0.1), SIZE, asked.append)
    assert arrival.seconds(FIRST) == pytest.approx(0.2 + FIRST / 1e6)
    # The second request waits for the first; the third is on its way before the second ends.
    assert arrival.seconds(SIZE) == pytest.approx(0.2 + FIRST / 1e6 + 0.1 + (SIZE - FIRST) / 1e6)


def test_each_byte_is_asked_for_once_in_order():
    for trace in TRACES:
        asked: list[ByteRange] = []
        arrival = replay(trace, SIZE, asked.append)
        assert asked[0] == (0, FIRST)
        assert [start for start, _ in asked] == [0, *(end for _, end in asked[:-1])]
        assert asked[-1][1] == SIZE
        assert arrival.n_requests == len(asked)
        assert (np.diff(arrival.seconds(np.arange(1, SIZE, 1000))) > 0).all()


def test_a_file_in_one_request_pays_for_one():
    asked: list[ByteRange] = []
    arrival = replay(constant(1e6, 0.1), SIZE, asked.append, first=SIZE)
    assert asked == [(0, SIZE)]
    assert arrival.seconds(SIZE) == pytest.approx(1.2)


def test_a_client_may_say_what_each_request_asks_for():
    asked: list[ByteRange] = []
    arrival = replay(constant(1e6, 0.1), SIZE, asked.append, first=10, requests=[10, SIZE - 10])
    assert asked == [(0, 10), (10, SIZE)]
    assert arrival.seconds(SIZE) == pytest.approx(0.3 + SIZE / 1e6)
    with pytest.raises(ValueError, match="requests of 10 bytes"):
        replay(constant(1e6), SIZE, asked.append, requests=[10])


def test_nothing_comes_while_the_connection_is_gone():
    rates = np.full(1000, 1e6)
    rates[2:12] = 0
    arrival = replay(Trace("", 0.0, rates), SIZE, lambda _: None)
    assert arrival.seconds(200_000) == pytest.approx(2 * STEP)
    assert arrival.seconds(300_000) == pytest.approx(13 * STEP, abs=1e-3)
    assert arrival.stalls(1, 0.5) == pytest.approx(10 * STEP, abs=2e-3)
    assert arrival.stalls(250_000, 0.5) == 0


def test_a_connection_has_the_rate_that_it_is_named_for():
    for trace in TRACES[:3]:
        megabits = float(trace.name.split()[0])
        assert trace.capacity(10) == pytest.approx(10 * megabits * MEGABIT)
    lte = next(trace for trace in TRACES if "LTE" in trace.name)
    assert 6 < lte.capacity(60) / 60 / MEGABIT < 24
    assert lte.rates.max() > 5 * lte.rates.min()


@pytest.mark.thorough
def test_a_small_scene_over_all_connections(tmp_path, monkeypatch):
    pytest.importorskip("gsply")
    from evogs_codec import encode_scene
    from evogs_codec.render.demo_scene import make_scene
    from tools.bench.stream import Streams
    from tools.bench.subjects import Subject

    # When bytes come is looked at, whatever effort they were made with.
    fast = partial(encode_scene, effort="fast")
    monkeypatch.setattr("tools.bench.stream.encode_scene", fast)
    streams = Streams(lambda: [Subject.of_scene("small", make_scene(1500), "z")], tmp_path)
    rows = streams.table()
    assert len(rows) == 5 * len(TRACES)
    files = {row["file"] for row in rows}
    first, last = (
        {(row["connection"], row["file"]): float(str(row[key])) for row in rows}
        for key in ("first picture, s", "all, s")
    )
    assert all(first[run] <= last[run] for run in first)
    assert first["2 Mbit/s", "evogs"] < last["2 Mbit/s", "evogs"]
    assert first["2 Mbit/s", "evogs"] < first["2 Mbit/s", "SPZ 4"]
    assert all(f"streamed SOG, {way}" in files for way in ("every level", "coarsest, finest"))
    curves = streams.curves()
    final = {row["file"]: row["30 s"] for row in curves if row["connection"] == "50 Mbit/s"}
    assert final["evogs"] == final["evogs, by level"]
