"""Encoding of a scene from files of several programs."""

import pytest

from evogs_codec import read_scene
from evogs_codec.render.demo_scene import make_scene


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*infinite opacity")
def test_a_row_for_each_format_beside_the_ply(tmp_path):
    pytest.importorskip("scipy")
    from tools.bench.inputs import inputs

    rows = inputs("small", make_scene(300), tmp_path, efforts=("fast",), turns=1)
    sources = [".ply", ".spz", ".sog", ".ply of the .spz", ".ply of the .sog"]
    assert [row["from"] for row in rows] == sources
    same = [row["to .ply of the same splats"] for row in rows]
    assert same[0] == same[3] == same[4] == "1.00"
    assert rows[0]["to .ply"] == "1.00"
    assert all(float(str(row["processor, s"])) > 0 for row in rows)
    for ending in ("ply", "spz", "sog"):
        assert len(read_scene(tmp_path / f"small-input.{ending}").splats) == 300
