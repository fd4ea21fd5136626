"""How many levels pay for small scenes."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from evogs_codec.lifting.lift import N_LEVELS, default_levels
from evogs_codec.render.demo_scene import make_scene
from tools.bench import depth as module
from tools.bench.subjects import Subject

pytestmark = pytest.mark.thorough


def test_a_row_for_the_default_and_one_for_five_levels(monkeypatch):
    monkeypatch.setattr(module, "N_SPLATS", (40, 80, 10**6))
    monkeypatch.setattr(module, "SEEDS", (1,))
    rows = module.depth([Subject.of_scene("small", make_scene(200), "z")])
    levels = [default_levels(40), N_LEVELS]
    assert [(row["splats"], row["levels"]) for row in rows] == [
        (n, n_levels) for n in (40, 80) for n_levels in levels
    ]
    assert all(row["to five levels, at equal PSNR"] == "1.00" for row in rows[1::2])
    assert int(str(rows[0]["bytes"])) < int(str(rows[1]["bytes"]))


def test_a_part_is_what_is_nearest_to_a_splat():
    scene = make_scene(200)
    part = module._part(scene, 20, 1)
    assert len(part) == 20
    center = scene.means[np.random.default_rng(1).integers(200)]
    away = np.square(scene.means - center).sum(axis=1)
    assert np.square(part.means - center).sum(axis=1).max() == np.sort(away)[19]
