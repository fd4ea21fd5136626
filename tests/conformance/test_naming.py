"""A wrong decoder, run as a process, is told which of the library it looks like."""

import json
import shlex
import sys

import pytest

from conformance.generator.generate import fingerprint_table
from conformance.harness.cli import main
from conformance.mutants import MUTANTS, fingerprints
from tests.conformance import tiny
from tests.conformance.tiny import ROOT

pytestmark = pytest.mark.thorough

N_MUTANTS = 24


def test_mutants_behind_the_contract_are_named(suite_folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    vectors = tiny.read_manifest(suite_folder)["vectors"]
    files = {entry["file"]: (suite_folder / entry["file"]).read_bytes() for entry in vectors}
    found = fingerprints(vectors, files, MUTANTS[:: len(MUTANTS) // N_MUTANTS], jobs=1)
    (suite_folder / "fingerprints.json").write_bytes(fingerprint_table(found))
    texts = [json.dumps([entry["outcomes"], entry["codes"]]) for entry in found.values()]
    named = [
        name
        for name, text in zip(found, texts, strict=True)
        if texts.count(text) == 1 and found[name]["outcomes"]
    ]
    assert len(named) >= 3
    for name in named[:3]:
        command = shlex.join([sys.executable, "-m", "conformance.mutants", "run", name])
        options = ["--vectors", str(suite_folder), "--quick", "--fresh", "0", "--again", "1"]
        report = tmp_path / "report.json"
        reports = ["--env", "PYTHONPATH", "--json", str(report)]
        assert main(["run", "--decoder", command, *options, *reports]) == 1
        first = json.loads(report.read_text())["diagnosis"]["alike"][0]
        assert (first["name"], first["share"]) == (name, 1.0)
        assert f"this looks like {name}: {found[name]['says']}" in capsys.readouterr().out


def test_a_decoder_that_uses_only_the_first_range_is_named(suite_folder, capsys, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    vectors = tiny.read_manifest(suite_folder)["vectors"]
    files = {entry["file"]: (suite_folder / entry["file"]).read_bytes() for entry in vectors}
    mutants = [mutant for mutant in MUTANTS if mutant.section == "R-6.4-2"]
    found = fingerprints(vectors, files, mutants, jobs=1)
    (suite_folder / "fingerprints.json").write_bytes(fingerprint_table(found))
    command = shlex.join([sys.executable, "-m", "conformance.mutants", "run", "first-range-only"])
    options = ["--vectors", str(suite_folder), "--quick", "--fresh", "0", "--again", "1"]
    assert main(["run", "--decoder", command, "--env", "PYTHONPATH", *options]) == 1
    said = capsys.readouterr().out
    assert "this looks like first-range-only: only the range that comes first is used" in said
