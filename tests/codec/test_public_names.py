"""The names of the package: each where it says, and none imported before it is asked for."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import evogs_codec

SOURCE = Path(evogs_codec.__file__).read_text(encoding="utf-8")


def test_names_are_those_that_type_checkers_see():
    imports = [node for node in ast.walk(ast.parse(SOURCE)) if isinstance(node, ast.ImportFrom)]
    seen = {
        alias.name: node.module.removeprefix("evogs_codec.")
        for node in imports
        if node.module is not None and node.module.startswith("evogs_codec.")
        for alias in node.names
    }
    assert seen == evogs_codec._MODULE_OF
    assert set(seen) == set(evogs_codec.__all__) <= set(dir(evogs_codec))
    assert all(getattr(evogs_codec, name) is not None for name in seen)


def test_other_names_are_refused_as_those_of_any_module():
    with pytest.raises(AttributeError, match="module 'evogs_codec' has no attribute 'nothing'"):
        _ = evogs_codec.nothing


def test_who_decodes_loads_no_encoder():
    code = (
        "import sys\nfrom evogs_codec import decode\n"
        "print(*{name.split('.')[1] for name in sys.modules if name.startswith('evogs_codec.')})"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"encoding", "lifting", "scene", "jobs", "render"} & set(run.stdout.split())
