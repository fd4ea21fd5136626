"""Each mutant is one change of the oracle that still applies; every run of it has an outcome."""

import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from conformance.decoders import oracle
from conformance.decoders.outcomes import Run, by_oracle
from conformance.mutants import MUTANTS, load, outcome, trial
from conformance.mutants.__main__ import alike, report
from conformance.mutants.fingerprint import fingerprints
from conformance.mutants.library import parse
from conformance.mutants.mutant import original
from conformance.mutants.trial import CRASH

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = (ROOT / "spec" / "example.evogs").read_bytes()
NAMED = {mutant.name: mutant for mutant in MUTANTS}


def entry(run: Run, data: bytes = EXAMPLE) -> dict[str, object]:
    """A vector of one run, as in the manifest."""
    came = by_oracle(data, run)
    fields: dict[str, object] = {"mode": run.mode, "level": run.level, "limits": run.limits}
    fields |= {
        "verify": run.verify,
        "arrival": run.arrival,
        "exit": came.exit,
        "code": came.code,
        "offset": came.offset,
    }
    return {"id": "x", "file": "x", "runs": [fields | {"dump": trial.sha256(came.dump)}]}


@pytest.mark.thorough
def test_every_mutant_changes_lines_that_are_in_the_oracle_once() -> None:
    problems = []
    for mutant in MUTANTS:
        try:
            text = mutant.text(original())
            compile(text, mutant.name, "exec")
            problems += [f"{mutant.name} changes nothing"] if text == original() else []
        except (ValueError, SyntaxError) as error:
            problems.append(str(error))
    assert problems == []


def test_names_are_unique_and_sections_exist() -> None:
    assert len(NAMED) == len(MUTANTS) >= 90
    spec = (ROOT / "spec" / "evogs.md").read_text(encoding="utf-8")
    known = set(re.findall(r"^- (R-[\d.]+-\d+)|^#+ (\d[\d.]*?)\.? |^(R-\d\S+)", spec, re.M))
    ids = {name for names in known for name in names if name}
    assert {mutant.section for mutant in MUTANTS} <= ids


def test_no_two_mutants_are_the_same_program() -> None:
    texts = {mutant.text(original()): mutant.name for mutant in MUTANTS}
    assert sorted(set(NAMED) - set(texts.values())) == []


def test_an_edit_that_does_not_apply_names_its_mutant() -> None:
    (mutant,) = parse("nowhere (4.2): nothing\n-no such line\n+another\n")
    with pytest.raises(ValueError, match="nowhere: not once in the oracle:\nno such line"):
        mutant.text(original())
    with pytest.raises(ValueError, match="not a mutant: 'no title'"):
        list(parse("# a comment\n\nno title\n-a\n+b\n"))


def test_context_and_several_places_of_a_mutant_are_kept_apart() -> None:
    (mutant,) = parse("two (4.2): two places\n a\n-b\n+c\n@@\n-d\n+e\n f\n")
    assert mutant.edits == (("a\nb\n", "a\nc\n"), ("d\nf\n", "e\nf\n"))
    assert mutant.text("a\nb\nd\nf\n") == "a\nc\ne\nf\n"


@pytest.mark.parametrize(
    "name", ["shift-truncates", "children-swapped", "dump-big-endian", "step-shift-ignored"]
)
def test_wrong_arithmetic_and_order_give_another_dump_of_the_example(name: str) -> None:
    came, right = outcome(load(NAMED[name]), EXAMPLE, Run()), by_oracle(EXAMPLE, Run())
    assert came.exit == right.exit == 0
    assert came.dump != right.dump


def test_a_mutant_without_a_check_accepts_what_the_check_refuses() -> None:
    data = EXAMPLE + b"x"
    assert by_oracle(data, Run()).code == "E_TRAILING"
    assert outcome(load(NAMED["trailing-bytes-ignored"]), data, Run()).exit == 0


def test_a_mutant_leaves_the_oracle_as_it_is() -> None:
    load(NAMED["shift-truncates"])
    assert oracle.round_shift(-3, 1) == -1
    assert by_oracle(EXAMPLE, Run(verify=True)).exit == 0


def test_exceptions_and_endless_loops_are_crashes(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(*_: object, **__: object) -> None:
        raise IndexError

    def endless(*_: object, **__: object) -> None:
        while True:
            pass

    monkeypatch.setattr(trial, "SECONDS", 0.05)
    for decode in (wrong, endless):
        module = SimpleNamespace(decode=decode, FaultError=oracle.FaultError)
        assert outcome(module, EXAMPLE, Run()) == CRASH  # type: ignore[arg-type]


def test_a_fingerprint_holds_what_differs_from_the_manifest() -> None:
    mutants = [NAMED[name] for name in ("shift-truncates", "signature-ignored")]
    refused = entry(Run(), b"\0" + EXAMPLE[1:])
    found = fingerprints([entry(Run())], {"x": EXAMPLE}, mutants, jobs=1)
    wrong = trial.sha256(outcome(load(mutants[0]), EXAMPLE, Run()).dump) or ""
    assert found["shift-truncates"]["outcomes"] == {"x#0": f"0:{wrong[:12]}"}
    assert found["signature-ignored"]["outcomes"] == found["signature-ignored"]["codes"] == {}
    found = fingerprints([refused], {"x": b"\0" + EXAMPLE[1:]}, mutants[1:], jobs=1)
    assert found["signature-ignored"]["codes"] == {"x#0": "E_CRC@0"}


def test_the_report_names_survivors_and_what_no_vector_tells_apart() -> None:
    found = {
        "a": {"says": "A", "outcomes": {"x#0": "1:-"}, "codes": {}},
        "b": {"says": "B", "outcomes": {"x#0": "1:-"}, "codes": {}},
        "c": {"says": "C", "outcomes": {}, "codes": {}},
        "d": {"says": "D", "outcomes": {}, "codes": {"x#0": "E_CRC@0"}},
    }
    assert alike(found) == [["a", "b"]]
    text = "\n".join(report(found))
    assert "1 survive: c" in text
    assert "1 killed by fault codes alone" in text


def run_mutant(*arguments: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "conformance.mutants", "run", *arguments]
    return subprocess.run(
        command, input=stdin, capture_output=True, text=True, cwd=ROOT, check=False, timeout=60
    )


def test_a_mutant_is_a_decoder_behind_the_command(tmp_path: Path) -> None:
    source, target = tmp_path / "a.evogs", tmp_path / "a.dump"
    source.write_bytes(EXAMPLE)
    files = ("--in", str(source), "--out", str(target))
    done = run_mutant("shift-truncates", *files)
    assert (done.returncode, done.stdout) == (0, "")
    assert target.read_bytes() == outcome(load(NAMED["shift-truncates"]), EXAMPLE, Run()).dump
    assert json.loads(run_mutant("oracle", "--capabilities").stdout)["batch"] is True
    source.write_bytes(EXAMPLE[:-1])
    done = run_mutant("oracle", *files)
    assert (done.returncode, json.loads(done.stdout)) == (1, {"code": "E_TRUNCATED", "offset": 457})


def test_a_mutant_answers_line_by_line_in_a_batch(tmp_path: Path) -> None:
    source, limits, arrival = (tmp_path / name for name in ("a", "l", "r"))
    source.write_bytes(EXAMPLE)
    limits.write_text('{"slots": 1}')
    arrival.write_text("[[0, 457]]")
    common = {"in": str(source), "out": str(tmp_path / "out"), "mode": "file"}
    requests = [
        {"id": 1} | common,
        {"id": 2, "level": 0, "verify": True} | common,
        {"id": 3, "limits": str(limits)} | common,
        {"id": 4, "arrival": str(arrival)} | common | {"mode": "progressive"},
    ]
    done = run_mutant("oracle", "--batch", stdin="".join(f"{json.dumps(r)}\n" for r in requests))
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert [answer["exit"] for answer in answers] == [0, 0, 4, 3]
    assert answers[2] == {"id": 3, "exit": 4, "code": "E_LIMIT", "offset": 207}


def test_a_mutant_that_crashes_takes_its_process_along(tmp_path: Path) -> None:
    source = tmp_path / "a"
    source.write_bytes(EXAMPLE[:20])
    done = run_mutant("header-length-unchecked", "--in", str(source), "--out", str(tmp_path / "o"))
    assert done.returncode < 0
