"""Default views are small: what is tested is what is done with them, not how well they show."""

import pytest


@pytest.fixture(autouse=True)
def small_views(monkeypatch):
    monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 100)
