"""Views of the commands are small: what is tested is what they do, not how well."""

import pytest


@pytest.fixture(autouse=True)
def small_views(monkeypatch):
    monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 100)
