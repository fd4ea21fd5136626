"""A mutant is run only where it may differ from the oracle, and nothing is missed by that."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from conformance.decoders.outcomes import Run
from conformance.mutants import MUTANTS, Mutant, fingerprints, load, outcome, progress, reached
from conformance.mutants.mutant import original
from conformance.mutants.reached import changed_lines, lines_reached
from conformance.mutants.trial import fault_text, run_of, sha256, verdict

ROOT = Path(__file__).resolve().parents[2]
VECTORS = ROOT / "conformance" / "vectors"
EXAMPLE = (ROOT / "spec" / "example.evogs").read_bytes()
PROGRAM = dedent(
    '''\
    LIMIT = 3
    class Box:
        size: int = 1
        def low(self):
            """Text."""
            return self.size
    def f(a, b=2):
        found = []
        for x in a:
            if x > LIMIT:
                found.append(
                    x,
                )
            elif x < 0:
                break
        try:
            n = g(found)
        except ValueError:
            n = 0
        with b:
            n += 1
            n += 2
        return n
    '''
)


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [
        ("LIMIT = 3", "LIMIT = 3  # a comment", set()),
        ("n = 0", "n = 1", {19}),
        ("            x,\n", "            -x,\n", {11}),  # the first line of its statement
        ("if x > LIMIT", "if x >= LIMIT", {10}),
        ("elif x < 0", "elif x <= 0", {14}),
        ("            break", "            continue", {15}),
        ("for x in a:", "for x in a[1:]:", {9}),
        ("with b:", "with b, b:", {20}),
        ("    found = []\n", "    LIMIT\n    found = []\n", {8}),  # before the one that follows
        ("        n += 1\n        n += 2\n", "        n += 1\n        n\n        n += 2\n", {22}),
        ("        n += 1\n", "", {21}),
        ("        n += 2\n", "        n += 2\n        n += 3\n", {22}),  # at the end of a block
        ("            break\n", "            break\n        else:\n            n = 1\n", {14}),
        ("except ValueError", "except KeyError", {16}),
        ("        n = 0\n", "        n = 0\n    else:\n        n = 1\n", {16}),
        ("        n = 0\n    with b:\n", "        n = 1\n    with b, b:\n", {19, 20}),
        ("return self.size", "return 2 * self.size", {6}),
        ('"""Text."""', "self.size = 0", {5}),
        ("n = g(found)", "n = later = g(found)", {8, 17}),  # later is a name of the whole function
        ("n = g(found)", "n = sum(m for m in g(found))", {17}),
    ],
)
def test_a_change_inside_functions_is_seen_where_statements_begin(
    old: str, new: str, lines: set[int]
) -> None:
    assert PROGRAM.count(old) == 1
    assert changed_lines(PROGRAM, PROGRAM.replace(old, new)) == frozenset(lines)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("LIMIT = 3", "LIMIT = 4"),
        ("LIMIT = 3", "LIMIT = 3\nMORE = 4"),
        ("size: int = 1", "size: int = 2"),
        ("class Box:", "class Box(list):"),
        ("def f(a, b=2):", "def f(a, b=3):"),
        ("    def low", "    @property\n    def low"),
        ("return n", "yield n"),
    ],
)
def test_a_change_outside_functions_may_be_seen_by_any_run(old: str, new: str) -> None:
    assert changed_lines(PROGRAM, PROGRAM.replace(old, new)) is None


def test_a_function_inside_a_function_is_one_statement() -> None:
    text = "def f():\n    def g(x):\n        return x\n    return g\n"
    assert changed_lines(text, text.replace("return x", "return 1")) == frozenset({2})


def line_of(text: str) -> int:
    """Where the oracle has a statement, from 1."""
    (found,) = (i for i, line in enumerate(original().split("\n"), 1) if line.strip() == text)
    return found


def test_a_run_comes_to_what_it_does_before_its_fault() -> None:
    accepted = line_of("h = Header(*[*fields[:6], fields[6:11], *fields[11:]])")
    applied = line_of("x.extend(seconds)")
    came, lines = lines_reached(EXAMPLE, Run())
    assert came.exit == 0
    assert lines >= {applied, accepted}
    came, lines = lines_reached(EXAMPLE[:-1], Run())
    assert came.code == "E_TRUNCATED"
    assert lines >= {applied, accepted}
    came, lines = lines_reached(b"\0" + EXAMPLE[1:], Run())
    assert came.code == "E_SIGNATURE"
    assert not lines & {applied, accepted}


def test_what_a_function_remembers_of_other_runs_hides_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    head = "def round_shift("
    remembering = original().replace(head, f"@__import__('functools').cache\n{head}")
    assert remembering != original()
    monkeypatch.setattr(reached, "original", lambda: remembering)
    assert lines_reached(EXAMPLE, Run()) == lines_reached(EXAMPLE, Run())
    (line,) = (
        i for i, text in enumerate(remembering.split("\n"), 1) if "return v if n == 0" in text
    )
    assert line in lines_reached(EXAMPLE, Run())[1]


def in_full(
    mutant: Mutant, vectors: Sequence[Mapping[str, Any]], files: Mapping[str, bytes]
) -> dict[str, Any]:
    """The fingerprint by every run of every vector."""
    found: dict[str, Any] = {"outcomes": {}, "codes": {}}
    for vector in vectors:
        for number, run in enumerate(vector["runs"]):
            came = outcome(load(mutant), files[vector["file"]], run_of(run))
            seen, fault = verdict(came.exit, sha256(came.dump)), fault_text(came.code, came.offset)
            if seen != verdict(run["exit"], run["dump"]):
                found["outcomes"][f"{vector['id']}#{number}"] = seen
            elif fault != fault_text(run["code"], run["offset"]):
                found["codes"][f"{vector['id']}#{number}"] = fault
    return {"says": mutant.says, "section": mutant.section} | found


@pytest.mark.thorough
def test_fingerprints_are_those_of_every_run() -> None:
    vectors = json.loads((VECTORS / "manifest.json").read_bytes())["vectors"][9::20]
    files = {vector["file"]: (VECTORS / vector["file"]).read_bytes() for vector in vectors}
    mutants = MUTANTS[3 :: len(MUTANTS) // 40]
    found = fingerprints(vectors, files, mutants, jobs=1)
    assert found == {mutant.name: in_full(mutant, vectors, files) for mutant in mutants}
    assert sum(bool(one["outcomes"] or one["codes"]) for one in found.values()) > 20


def test_a_run_that_the_oracle_ends_otherwise_than_expected_counts_for_every_mutant() -> None:
    run: dict[str, object] = {"mode": "file", "level": None, "limits": None, "verify": False}
    run |= {"arrival": None, "exit": 1, "dump": None, "code": "E_CRC", "offset": 0}
    vector, unreached = {"id": "x", "file": "x", "runs": [run]}, MUTANTS[-1]
    found = fingerprints([vector], {"x": EXAMPLE[:4]}, [unreached], jobs=1)[unreached.name]
    assert (found["outcomes"], found["codes"]) == ({}, {"x#0": "E_TRUNCATED@0"})


def test_long_work_says_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert list(progress.told("abc", 3, "letters")) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "SECONDS_OF_A_LINE", 0.0)
    assert list(progress.told("abc", 3, "letters")) == ["a", "b", "c"]
    assert capsys.readouterr().err.splitlines()[0] == "1 of 3 letters, 0:00 left"
