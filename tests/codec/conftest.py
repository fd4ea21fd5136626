"""Default views are small: what is tested is what is done with them, not how well they show."""

import pytest

from tests.support.view_sizes import FULL, SMALL, views_of

# Fixtures of modules encode here, and other processes: each module says how large its views are.
WITH_VIEWS_OF_THEIR_OWN = {"jobs", "tileset"}


@pytest.fixture(autouse=True)
def small_views(request, monkeypatch):
    """Of commands, and of the first ring; other thorough tests measure what views decide."""
    package = request.path.parent.name
    is_measured = package != "cli" and request.node.get_closest_marker("thorough")
    if package not in WITH_VIEWS_OF_THEIR_OWN and not is_measured:
        monkeypatch.setattr("evogs_codec.render.viewpoints.SIZE", 100)


@pytest.fixture
def full_views():
    """For what views decide, and for processes that jobs start, which have no others."""
    with views_of(FULL):
        yield


@pytest.fixture
def any_views():
    """For thorough tests of what does not depend on how large views are."""
    with views_of(SMALL):
        yield
