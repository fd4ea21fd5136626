"""`python -m tools.bench --only small`: targets of small scenes."""

from itertools import islice

import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")

from evogs_codec import InputError
from tools.bench import small_targets as module
from tools.bench.falls import odd_scenes
from tools.bench.small_targets import small_targets


def test_times_are_those_of_the_plain_encode_and_missed_targets_have_none(monkeypatch):
    clock = iter(range(1000))
    seconds = {None: 2, 30: 3, 38: 1, 46: 6, 58: 2}
    scenes = [("as shipped", range(5)), ("black plane", range(6))]
    monkeypatch.setattr(module, "odd_scenes", lambda *_: scenes)
    monkeypatch.setattr("time.process_time", lambda: float(next(clock)))

    def encode(splats, target_psnr=None, target_bytes=None):
        if target_bytes == 50:
            raise InputError("cannot be met")
        for _ in range(seconds[target_psnr] - 1):
            next(clock)
        return bytes(target_psnr or target_bytes or 100)

    monkeypatch.setattr(module, "encode_scene", encode)
    falls = {100: "0.01", 46: "0.30"}
    monkeypatch.setattr(
        module, "fallen", lambda data, _: {"deepest fall, dB": falls.get(len(data), "0.00")}
    )
    (row,) = small_targets([(5, 1)])
    assert row == {
        "scene": "as shipped",
        "splats": 5,
        "bytes": 100,
        "encode, s": "2.0",
        "30 dB": "1.50",
        "38 dB": "0.50",
        "46 dB": "3.00",
        "58 dB": "1.00",
        "0.5 of bytes": "",
        "2 of bytes": "1.00",
        "fall, dB": "0.01",
        "with targets": "0.30",
    }


def test_a_small_scene_is_measured(monkeypatch):
    monkeypatch.setattr(module, "DECIBELS", (40,))
    monkeypatch.setattr(module, "SHARES", (0.5,))
    monkeypatch.setattr(module, "odd_scenes", lambda *of: islice(odd_scenes(*of), 3))
    rows = small_targets([(120, 4)])
    assert len(rows) == 3
    assert all(float(str(row["fall, dB"])) <= 0.05 for row in rows)
    assert any(row["40 dB"] for row in rows)
