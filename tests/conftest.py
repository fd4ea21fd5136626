"""Fixtures of all tests, and the hypothesis profiles."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# The first call of a numpy function may take longer than hypothesis allows an example.
settings.register_profile("dev", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", settings.get_profile("dev"), derandomize=True, database=None)
settings.load_profile("ci" if os.environ.get("CI") else "dev")

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real scenes next to the project, which are not ours to commit."""
    if not (SHARED / "data").is_dir():
        pytest.skip("the real scenes (../shared/data) are not on this machine")
    return SHARED
