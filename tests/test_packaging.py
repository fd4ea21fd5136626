"""What is installed, and what the commands say about what is not."""

import json
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from conformance.harness import cli as harness
from conformance.renders import cli as renders

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
INSTALLED = {"evogs", "evogs_codec", "conformance", "reference_trainer"}


def test_tools_are_not_installed():
    setuptools = PROJECT["tool"]["setuptools"]
    found = {name.removesuffix("*") for name in setuptools["packages"]["find"]["include"]}
    assert found | set(setuptools["py-modules"]) == INSTALLED


def test_vectors_and_goldens_are_not_installed():
    setuptools = pytest.importorskip("setuptools", reason="only builds need it")
    find = PROJECT["tool"]["setuptools"]["packages"]["find"]
    packages = setuptools.find_namespace_packages(str(ROOT), **find)
    assert "conformance.harness.judging" in packages
    assert not [p for p in packages if "vectors" in p or "goldens" in p or "renders." in p]
    data = PROJECT["tool"]["setuptools"]["package-data"]["conformance"]
    assert not [p for p in data if p.startswith(("*", "vectors", "renders"))]


def test_entry_points_are_of_installed_packages():
    project = PROJECT["project"]
    groups = [project["scripts"], *project["entry-points"].values()]
    assert {value.split(".")[0].split(":")[0] for g in groups for value in g.values()} <= INSTALLED


def test_the_bench_command_names_the_program_that_replaces_it(refused):
    refused("bench", words=["python -m tools.bench"])
    refused("bench", "paper", "--data", "x", words=["python -m tools.bench.paper"])


def test_a_command_that_cannot_be_loaded_leaves_the_others(monkeypatch, evogs):
    missing = "No module named 'tools.gone'"
    gone = EntryPoint("gone", "tools.gone:register", "evogs.commands")
    monkeypatch.setattr("evogs_codec.cli.commands.entry_points", lambda **_: [gone])
    code, out, err = evogs("--help")
    assert (code, "extract" in out) == (0, True)
    assert err == f"evogs: no command gone, install its package again: {missing}\n"


def test_a_command_of_the_codec_imports_no_other_package(monkeypatch, evogs):
    def entries(**_):
        raise AssertionError("looked for commands of other packages")

    monkeypatch.setattr("evogs_codec.cli.commands.entry_points", entries)
    code, out, err = evogs("info", ROOT / "spec" / "example.evogs", "--json")
    assert (code, json.loads(out)["tier"], err) == (0, 1, "")


def test_missing_vectors_are_said_to_be_in_a_checkout(tmp_path, capsys):
    command = ["run", "--decoder", "true", "--vectors", str(tmp_path)]
    assert harness.main(command) == 3
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "CHECKOUT" in line)
    assert str(tmp_path) in line
    assert "--vectors CHECKOUT/conformance/vectors" in line


def test_missing_goldens_are_said_to_be_in_a_checkout(tmp_path, capsys):
    assert renders.main(["run", "--renderer", "true", "--suite", str(tmp_path)]) == 3
    (line,) = capsys.readouterr().out.splitlines()
    assert "--suite CHECKOUT/conformance/renders" in line
