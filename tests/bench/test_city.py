"""The benchmark of an object in a city."""

import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from tools.bench import city as module

pytestmark = pytest.mark.thorough


def test_a_row_says_what_both_take_beside_each_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "N_SPLATS", (900,))
    monkeypatch.setattr(module, "SEEDS", (1,))
    rows = module.city(tmp_path)
    large, natural = (float(str(row["median splat, mm"])) for row in rows)
    assert large == 1.0
    assert 0.02 < natural < 0.2, "as an object of 900 splats has them, 5 cm wide"
    for row in rows:
        alone, together = map(float, str(row["city, dB"]).split(" and "))
        assert alone > 40
        assert together > alone - 3
        assert 0.7 < float(str(row["both, bytes to alone"])) < 1.6
    median, nearly_all = map(float, str(rows[0]["object moved, sizes"]).split(", "))
    assert median < 0.1
    assert nearly_all < 0.5
