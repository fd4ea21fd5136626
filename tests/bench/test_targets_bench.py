"""`python -m tools.bench --only targets`: encodes with a target, beside a plain one."""

import pytest

from evogs_codec import PRESETS, encode_scene, lift

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from tests.support.view_sizes import SMALL
from tools.bench import targets as module
from tools.bench.subjects import Subject
from tools.bench.targets import targets

pytestmark = pytest.mark.thorough


def test_a_target_is_measured_beside_a_plain_encode(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "TURNS", 1)
    monkeypatch.setattr(module, "DECIBELS", (40,))
    monkeypatch.setattr(module, "SHARES", (2.0,))
    scene = make_scene(60)
    views = Views(scene, cameras_around(scene, "z", SMALL, n=24))
    subject = Subject.of_tree("small", lift(scene, 3), PRESETS["scene"], views)
    plain, of_psnr, of_bytes = targets([subject], tmp_path)
    size = len(encode_scene(scene, up="z"))
    assert (plain["target"], plain["bytes"], plain["to plain"]) == ("", size, "1.00")
    assert of_psnr["target"] == "40 dB"
    assert float(str(of_psnr["PSNR, dB"])) == pytest.approx(40, abs=1.0)
    assert of_bytes["target"] == f"{2 * size:,} bytes"
    assert 1.96 * size <= int(str(of_bytes["bytes"])) <= 2 * size
