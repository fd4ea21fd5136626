"""`python -m tools.bench --only refine` on a small scene."""

import pytest

from evogs_codec import write_ply
from evogs_codec.render.demo_scene import make_scene

refine = pytest.importorskip("tools.bench.refine", reason="the rasterizer is compiled")


@pytest.mark.thorough
def test_levels_before_and_after_with_their_bytes(tmp_path, monkeypatch):
    ply = tmp_path / "other.ply"
    write_ply(ply, make_scene(150, seed=1))
    monkeypatch.setattr(refine, "make_scene", lambda: make_scene(200))
    for name, value in (
        ("N_CROP", 100),
        ("SIZE", 24),
        ("FAR_PIXELS", 12),
        ("DEFAULT_ITERATIONS", 2),
    ):
        monkeypatch.setattr(refine, name, value)
    monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 24)
    rows = refine.refined(ply, "z")
    assert [row["level"] for row in rows] == 2 * [0, 1, 2, 3, 4]
    assert {row["scene"] for row in rows} == {"shipped", "other, 100 splats"}
    assert [row["splats"] for row in rows][4::5] == [200, 100]
    for row in rows[4::5]:  # the last level, which has all bytes
        assert 0.8 < float(str(row["to lifted"])) < 1.2
        assert abs(float(str(row["refined, dB"])) - float(str(row["lifted, dB"]))) < 1
