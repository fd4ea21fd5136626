"""`python -m tools.bench --only before`: an encode beside that of an earlier checkout."""

from pathlib import Path

import pytest

from evogs_codec import PRESETS, encode_scene, lift

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from tests.support.view_sizes import SMALL
from tools.bench import before as module
from tools.bench.before import before
from tools.bench.subjects import Subject

pytestmark = pytest.mark.thorough
HERE = Path(__file__).parents[2]


def test_a_checkout_is_measured_beside_itself(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "TURNS", 1)
    scene = make_scene(12)
    views = Views(scene, cameras_around(scene, "z", SMALL, n=24))
    subject = Subject.of_tree("small", lift(scene, 5), PRESETS["scene"], views)
    (row,) = before([subject], HERE, tmp_path)
    assert row["before, bytes"] == row["bytes"] == len(encode_scene(scene, up="z"))
    assert float(str(row["s"])) > 0
