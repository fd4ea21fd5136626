"""The benchmark of an object in a landscape."""

import pytest

pytest.importorskip("numba", reason="the rasterizer is compiled")
from tools.bench import landscape as module

pytestmark = pytest.mark.thorough


def test_rows_say_what_the_default_shows_beside_views_around_the_whole(monkeypatch):
    monkeypatch.setattr(module, "N_SPLATS", 3000)
    monkeypatch.setattr(module, "SEEDS", (1,))
    default, whole = module.landscape()
    assert (default["views"], whole["views"]) == ("default", "whole")
    near, far = "from 3 units, dB", "from 40 units, dB"
    assert float(str(default[near])) > float(str(whole[near])) + 5
    assert float(str(default[far])) > 35
