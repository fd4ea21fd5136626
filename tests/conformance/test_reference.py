"""The reference decoder, and the one written from the text alone, pass the committed suite."""

import json
import shlex
import sys

import pytest

from conformance.harness.cli import main
from conformance.harness.manifest import load
from conformance.harness.selftest import CLASSES, class_of, small_suite
from tests.conformance.tiny import ROOT

pytestmark = pytest.mark.thorough

VECTORS = ROOT / "conformance" / "vectors"


REFERENCE = ["-m", "conformance.decoders.reference"]
CLEANROOM = [str(ROOT / "conformance" / "decoders" / "cleanroom" / "decoder.py")]


def run(tmp_path, monkeypatch, *options, decoder=REFERENCE):
    """(exit code, report) of a trial of a decoder."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    report = tmp_path / "report.json"
    command = ["--decoder", shlex.join([sys.executable, *decoder])]
    code = main(["run", *command, "--env", "PYTHONPATH", "--json", str(report), *options])
    return code, json.loads(report.read_text())


@pytest.mark.parametrize("decoder", [REFERENCE, CLEANROOM], ids=["reference", "cleanroom"])
def test_it_passes_all_committed_vectors(tmp_path, monkeypatch, decoder):
    options = "--quick", "--fresh", "0", "--again", "2"
    code, report = run(tmp_path, monkeypatch, *options, decoder=decoder)
    assert code == 0, [entry for entry in report["results"] if entry["kind"] != "pass"][:5]
    assert "fail" not in report["requirements"].values()


def test_one_process_per_run_gives_the_same(tmp_path, monkeypatch):
    (tmp_path / "small").mkdir()
    small_suite(load(VECTORS), tmp_path / "small")
    options = ["--vectors", str(tmp_path / "small"), "--no-batch", "--fresh", "0", "--again", "1"]
    code, report = run(tmp_path, monkeypatch, *options)
    assert code == 0
    assert report["header"]["options"]["batch"] is False


@pytest.mark.slow
def test_it_passes_the_whole_suite(tmp_path, monkeypatch):
    code, report = run(tmp_path, monkeypatch)
    assert (code, report["footer"]["complete"]) == (0, True)
    assert report["claim"]


def test_the_suite_has_runs_of_every_class_that_the_self_test_needs():
    found = {class_of(case) for case in load(VECTORS).cases()}
    assert set(CLASSES) <= found
