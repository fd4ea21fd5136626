"""Who may import whom (ARCHITECTURE.md), read from the source."""

import ast
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
OURS = ("evogs_codec", "reference_trainer", "conformance", "tools", "tests")
MODULES = {path.stem: path for path in sorted((ROOT / "evogs_codec").glob("*.py"))}
# Each of these has few importers, which give the others typed values.
IMPORTERS = {
    "construct": {"layout"},
    "zstandard": {"frames"},
    "plyfile": {"ply"},
    "numba": {"kernels", "kernel_headers", "kernel_values"},
    "isal": {"crc"},
}
OPTIONAL = {"numba", "isal"}
# What a machine that only decodes never needs.
ENCODING = {
    *("encode", "settings", "arrange", "quantize", "grids", "alphas", "hints", "packing", "morton"),
    *("lifting", "merging", "pairing", "joining", "axes", "directory_writing"),
    *("aiming", "polish", "importance", "trading", "gains", "tiling", "progression", "drawn"),
    *("sharing", "entries"),
}


@cache
def imports(path):
    """Every module that the file imports, also inside functions: "a.b" for `from a import b`."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            found |= {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def packages(path):
    return {name.split(".")[0] for name in imports(path)}


def own_imports(name):
    """Modules of evogs_codec that a module of it imports."""
    parts = (found.split(".") for found in imports(MODULES[name]))
    return {p[1] for p in parts if p[0] == "evogs_codec" and len(p) > 1 and p[1] in MODULES}


def reached_from(name):
    reached, todo = set(), [name]
    while todo:
        reached.add(todo[-1])
        todo += own_imports(todo.pop()) - reached
    return reached


@pytest.mark.parametrize("name", MODULES)
def test_the_codec_imports_no_other_package_of_ours_and_no_torch(name):
    assert not packages(MODULES[name]) & {*OURS[1:], "torch"}


@pytest.mark.parametrize("library", IMPORTERS)
def test_a_library_of_raw_bytes_or_compiled_code_has_one_place(library):
    importers = {name for name, path in MODULES.items() if library in packages(path)}
    assert importers <= IMPORTERS[library]


def test_decoding_never_imports_encoding():
    assert not (reached_from("decode") | reached_from("feeding")) & ENCODING
    assert not reached_from("extract") & (ENCODING - {"directory_writing"})
    assert "state" in reached_from("decode")


def test_no_module_of_the_codec_imports_the_command_line():
    assert not [name for name in MODULES if "cli" in own_imports(name)]


def test_modules_do_not_import_each_other_in_a_circle():
    for name in MODULES:
        below = set().union(*(reached_from(other) for other in own_imports(name)), set())
        assert name not in below or name == "__init__", name


@pytest.mark.parametrize("name", ["oracle.py", "cleanroom/decoder.py"])
def test_decoders_written_from_the_text_import_nothing_of_the_codec(name):
    assert packages(ROOT / "conformance" / name) <= {*sys.stdlib_module_names, "zstandard"}


def test_the_base_install_has_every_library_that_the_codec_imports():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {entry.split(">")[0].split("[")[0].strip() for entry in project["dependencies"]}
    for name, path in MODULES.items():
        needed = packages(path) - sys.stdlib_module_names - {"evogs_codec", "__future__"}
        assert needed - OPTIONAL <= declared, name
        for library in needed & OPTIONAL:
            assert name in IMPORTERS[library]


def test_the_codec_works_without_the_optional_libraries():
    program = (
        "import sys\n"
        "sys.modules['numba'] = sys.modules['torch'] = sys.modules['isal'] = None\n"
        "import numpy as np\n"
        "import evogs_codec, evogs_codec.cli, evogs_codec.compiled\n"
        "evogs_codec.compiled.MIN_COMPILED = 0\n"
        "adds = np.ones((14, 5), np.float32)\n"
        "tree = evogs_codec.EvolutionTree(0, (evogs_codec.Step.of_adds(0, adds),))\n"
        "print(len(evogs_codec.decode(evogs_codec.encode(tree)).leaves()))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (done.stdout, done.stderr) == ("5\n", "")
