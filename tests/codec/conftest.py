"""Default views are small: what is tested is what is done with them, not how well they show."""

import pytest

# What is encoded in fixtures of modules, or in other processes, has views as they are.
WITH_FULL_VIEWS = {"jobs", "tileset"}


@pytest.fixture(autouse=True)
def small_views(request, monkeypatch):
    """Of commands, and of the first ring; other thorough tests measure what views decide."""
    package = request.path.parent.name
    is_measured = package != "cli" and request.node.get_closest_marker("thorough")
    if package not in WITH_FULL_VIEWS and not is_measured:
        monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 100)
