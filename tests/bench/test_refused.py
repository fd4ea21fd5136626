"""`python -m tools.bench --only refused`: impossible targets, how they are answered."""

import pytest

from evogs_codec import PRESETS, lift

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.render import Views, cameras_around
from evogs_codec.render.demo_scene import make_scene
from tests.support.view_sizes import SMALL, views_of
from tools.bench import refused as module
from tools.bench.refused import TARGETS, refused
from tools.bench.subjects import Subject

pytestmark = pytest.mark.thorough


def test_what_an_answer_names_is_what_streams_measure(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "TARGETS", TARGETS[1::2])  # beyond the coarsest streams
    scene = make_scene(60)  # of few splats the answer is measured, too
    with views_of(SMALL):
        views = Views(scene, cameras_around(scene, "z", SMALL, n=24))
        subject = Subject.of_tree("small", lift(scene, 5), PRESETS["scene"], views)
        rows = refused([subject], tmp_path)
    coarsest, smallest = rows
    assert coarsest["target"] == "5 dB"
    named, measured = (float(str(coarsest[key])) for key in ("end that is named", "measured"))
    assert named == pytest.approx(measured, abs=3)  # the command has larger views
    assert float(str(coarsest["seconds"])) > 0
    named, measured = (
        int(str(smallest[key]).replace(",", "")) for key in ("end that is named", "measured")
    )
    assert named == pytest.approx(measured, rel=0.2)
