"""The committed fingerprints are those of the mutants as they are, and name most of them."""

import json
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from conformance.generator.builder import repaired
from conformance.generator.generate import stored_fingerprints
from conformance.harness.judging import diagnosis
from conformance.harness.runner import Options
from conformance.harness.trial import Choice, hold
from conformance.mutants import MUTANTS, fingerprints

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).resolve().parents[2]
VECTORS = ROOT / "conformance" / "vectors"
SAMPLE = MUTANTS[3 :: len(MUTANTS) // 8]
NAMED_SHARE = 0.8


@cache
def stored() -> dict[str, Any]:
    """The committed fingerprints."""
    return stored_fingerprints()


@cache
def vectors() -> list[dict[str, Any]]:
    return list(json.loads((VECTORS / "manifest.json").read_bytes())["vectors"])


def data_of(vector: dict[str, Any]) -> bytes:
    return (VECTORS / str(vector["file"])).read_bytes()


def test_the_fingerprints_are_those_of_the_mutants_as_they_are() -> None:
    files = {vector["file"]: data_of(vector) for vector in vectors()}
    found = fingerprints(vectors(), files, SAMPLE)
    assert found == {mutant.name: stored()[mutant.name] for mutant in SAMPLE}


def test_many_mutants_are_killed_only_by_vectors_whose_checksums_are_right() -> None:
    wrong = {vector["id"] for vector in vectors() if repaired(data := data_of(vector)) != data}
    assert wrong
    deep = [
        name
        for name, found in stored().items()
        if not {run.rpartition("#")[0] for run in (*found["outcomes"], *found["codes"])} & wrong
    ]
    assert len(deep) >= 30


@pytest.mark.parametrize("codes", [True, False])
def test_most_mutants_are_named_by_what_they_do(
    codes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those that a decoder without fault codes can show, if it has none."""
    prints = diagnosis.read_fingerprints(VECTORS)
    monkeypatch.setattr(diagnosis, "_symptom", lambda result: result.symptom)
    runs = {run for found in prints.values() for run in (*found.outcomes, *found.codes)}

    def result(run: str, symptom: str | None) -> SimpleNamespace:
        case = SimpleNamespace(id=run, run=SimpleNamespace(level=None))
        kind = "wrong dump" if symptom else "pass"
        judged = {"kind": kind, "says": "", "symptom": symptom, "judged": True}
        return SimpleNamespace(case=case, failed=bool(symptom), **judged)

    passed = {run: result(run, None) for run in runs}
    shown = {name: found for name, found in prints.items() if codes or found.outcomes}
    named = 0
    for name, found in shown.items():
        symptoms = {**found.outcomes, **(found.codes if codes else {})}
        results = {**passed, **{run: result(run, symptom) for run, symptom in symptoms.items()}}
        alike = diagnosis.diagnose(list(results.values()), prints, codes=codes).alike  # type: ignore[arg-type]
        named += bool(alike) and alike[0].name == name
    assert named >= NAMED_SHARE * len(shown) > 60


@pytest.mark.slow
def test_most_mutants_behind_the_command_are_named_by_the_harness() -> None:
    wrong: dict[str, list[str]] = {}
    for mutant in SAMPLE:
        command = [sys.executable, "-m", "conformance.mutants", "run", mutant.name]
        choice = Choice(VECTORS, n_fresh=0, is_quick=True)
        trial = hold(choice, Options(command, jobs=2, n_again=1))
        names = [likeness.name for likeness in trial.diagnosis.alike]
        wrong |= {mutant.name: names} if names[:1] != [mutant.name] else {}
    assert len(wrong) <= (1 - NAMED_SHARE) * len(SAMPLE), wrong
