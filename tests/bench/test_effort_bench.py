"""What efforts are compared by."""

import math

import pytest

from evogs_codec.render.demo_scene import make_scene
from tools.bench.subjects import Subject


@pytest.mark.thorough
def test_bytes_at_equal_psnr_are_those_of_the_curve_moved_to_the_default():
    pytest.importorskip("gsply", reason="the bench writes SPZ with it")
    from tools.bench.effort import to_default

    curve = [(100, 30.0), (200, 40.0), (400, 50.0)]
    assert to_default(curve, (200, 40.0), (200, 40.0)) == pytest.approx(1)
    assert to_default(curve, (110, 30.0), (200, 40.0)) == pytest.approx(1.1)
    # A default that takes more than the curve: others are compared with what it would take.
    assert to_default(curve, (110, 30.0), (220, 40.0)) == pytest.approx(1.0)
    assert math.isnan(to_default(curve, (90, 29.0), (200, 40.0)))


@pytest.mark.thorough
def test_a_row_for_each_effort_and_one_for_spz(tmp_path):
    pytest.importorskip("gsply", reason="the bench writes SPZ with it")
    from tools.bench.effort import effort

    rows = effort([Subject.of_scene("small", make_scene(800), "z")], tmp_path)
    assert [row["effort"] for row in rows][:3] == ["fast", "default", "best"]
    assert rows[1]["at equal PSNR"] == "1.000"
    assert all(float(str(row["processor, s"])) >= 0 for row in rows)
