"""Who may import whom: every import of the source against the table that ARCHITECTURE.md prints."""

import ast
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TOPS = ("evogs_codec", "conformance", "reference_trainer", "tools")
CODEC = "evogs_codec"
TABLE = "<!-- layers -->\n"
# Libraries that may be missing: what needs them says so, and the rest works.
OPTIONAL = {"shtab", "numba", "llvmlite", "isal", "obstore", "PIL", "distributed"}


def rows():
    """{package: (what it may import, libraries)} in the order of the table, lowest first.

    A package is a folder or a module, with all below it that has no row of its own.
    """
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    lines = text.split(TABLE)[1].split("\n\n")[0].splitlines()[2:]
    found = {}
    for line in lines:
        package, _, ours, libraries = (cell.strip() for cell in line.strip("|").split("|"))
        names = [part.strip().strip("`") for part in ours.split(",") if part.strip()]
        found[package.strip("`")] = (
            names,
            {part.strip().strip("`") for part in libraries.split(",") if part.strip()},
        )
    return found


ROWS = rows()
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for top in TOPS
    for path in sorted((ROOT / top).rglob("*.py"))
}


def row_of(module):
    """The row that a module belongs to: the longest that begins its name."""
    parts = module.split(".")
    names = (".".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((name for name in names if name in ROWS), None)


@cache
def imports(path):
    """Every module that the file imports, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                found.add(name if name in MODULES else str(node.module))
    return found


def ours(module):
    return {name for name in imports(MODULES[module]) if name in MODULES}


def libraries(module):
    found = {name.split(".")[0] for name in imports(MODULES[module])}
    return found - set(sys.stdlib_module_names) - {*TOPS, "tests", "__future__"}


def allowed(row):
    """Rows that a row may import; a name that ends in `.*` is all rows that begin so."""
    found = {row}
    for name in ROWS[row][0]:
        if name == "all above":
            found |= set(list(ROWS)[: list(ROWS).index(row)])
        elif name.endswith(".*"):
            found |= {other for other in ROWS if f"{other}.".startswith(name[:-1])}
        else:
            assert name in ROWS, f"the row of {row} names {name}, which has none"
            found.add(name)
    return found


@pytest.mark.parametrize("row", ROWS)
def test_a_package_imports_what_its_row_says(row):
    members = [module for module in MODULES if row_of(module) == row]
    assert members, "the table has a package that is not there"
    for module in members:
        for other in ours(module):
            assert row_of(other) in allowed(row), f"{module} imports {other}"
        beyond = libraries(module) - ROWS[row][1]
        assert not beyond, f"{module} imports {beyond}"


def test_every_module_has_a_row():
    assert [module for module in MODULES if row_of(module) is None] == []


def test_no_row_may_import_a_later_one():
    order = list(ROWS)
    for row in ROWS:
        for other in allowed(row) - {row}:
            assert order.index(other) < order.index(row), f"{row} may import {other}"


def test_modules_do_not_import_each_other_in_a_circle():
    done: set[str] = set()
    path: list[str] = []

    def visit(module):
        if module in done:
            return
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        path.append(module)
        for other in sorted(ours(module)):
            visit(other)
        done.add(path.pop())

    for module in MODULES:
        visit(module)


@pytest.mark.parametrize(
    ("library", "importers"),
    [
        ("construct", {"format.layout"}),
        ("zstandard", {"format.frames", "io.interchange.bounded"}),
        ("plyfile", {"io.ply", "io.ply_header"}),
        ("isal", {"format.crc"}),
        ("obstore", {"stores.client"}),
        ("PIL", {"io.interchange.sog", "render.jpeg"}),
    ],
)
def test_a_library_of_raw_bytes_has_one_importer_in_the_codec(library, importers):
    found = {name for name in MODULES if name.startswith(CODEC) and library in libraries(name)}
    assert found == {f"{CODEC}.{name}" for name in importers}


def test_the_base_install_has_every_library_that_the_codec_imports():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {entry.split(">")[0].split("[")[0].strip() for entry in project["dependencies"]}
    for module in MODULES:
        if module.startswith(CODEC):
            assert libraries(module) - OPTIONAL <= declared, module


def test_the_codec_works_without_the_optional_libraries():
    program = (
        "import sys\n"
        "sys.modules['numba'] = sys.modules['torch'] = sys.modules['isal'] = None\n"
        "sys.modules['PIL'] = sys.modules['obstore'] = sys.modules['shtab'] = None\n"
        "import numpy as np\n"
        "import evogs_codec, evogs_codec.cli.commands\n"
        "from evogs_codec.decoding.compiled import dispatch\n"
        "dispatch.MIN_COMPILED = 0\n"
        "adds = np.ones((14, 5), np.float32)\n"
        "tree = evogs_codec.EvolutionTree(0, (evogs_codec.Step.of_adds(0, adds),))\n"
        "print(len(evogs_codec.decode(evogs_codec.encode_tree(tree, preset='scene')).leaves()))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (done.stdout, done.stderr) == ("5\n", "")
