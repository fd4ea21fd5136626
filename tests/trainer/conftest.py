"""Tests of the trainer are not of the first ring; without torch only photographs are tested."""

from importlib.util import find_spec

import pytest

# The tests of these files read photographs and parse options, which needs no torch.
WITHOUT_TORCH = "test_views_*.py"
HERE = "tests/trainer/"


class _NeedsTorch(pytest.Module):
    def collect(self):
        pytest.skip("training needs torch: make test-all", allow_module_level=True)


def pytest_pycollect_makemodule(module_path, parent):
    if find_spec("torch") is None and not module_path.match(WITHOUT_TORCH):
        return _NeedsTorch.from_parent(parent, path=module_path)
    return None


def pytest_collection_modifyitems(items):
    for item in items:
        if item.nodeid.startswith(HERE) and not item.path.match(WITHOUT_TORCH):
            item.add_marker("thorough")
