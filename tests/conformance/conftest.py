"""Fixtures of the conformance tests."""

import shutil

import pytest

from tests.conformance import tiny


@pytest.fixture(scope="session")
def made_suite(tmp_path_factory):
    """A small suite that tests only read."""
    return tiny.write_suite(tmp_path_factory.mktemp("tiny"))


@pytest.fixture
def suite_folder(made_suite, tmp_path):
    """A copy of it, to damage."""
    return shutil.copytree(made_suite, tmp_path / "suite")
