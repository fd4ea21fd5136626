"""The harness on trial: deliberately bad decoders, each of which must get the verdict written down.

A harness that lets a wrong decoder pass is worse than none. `bad/expected.json` says for each
decoder the exit code of the trial and the kinds of outcome by class of run: exactly these, where
`?` marks one that may be missing. Classes that are not named pass. `told` are words of the report,
`system` is the only one where such a decoder can be run. Of none may a process be left, nor a
character in a report that moves a cursor or breaks a page.
"""

from __future__ import annotations

import fcntl
import json
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from conformance.harness.bad.escapes import ALIVE
from conformance.harness.judging.dumps import tiles_of
from conformance.harness.manifest import Case, Suite, SuiteError, load
from conformance.harness.reporting.junit import as_junit
from conformance.harness.reporting.page import as_html
from conformance.harness.reporting.report import as_json
from conformance.harness.reporting.table import report
from conformance.harness.runner import Options
from conformance.harness.running.process import Bounds
from conformance.harness.running.scratch import scratch
from conformance.harness.trial import FAILED, Choice, Trial, hold

__all__ = ["CLASSES", "Judged", "class_of", "self_test", "small_suite"]

BAD = Path(__file__).resolve().parent / "bad"
BOUNDS = Bounds(seconds=4.0, memory=256 << 20, written=8 << 20, files=500)
PATIENCE = 1
SYSTEM = sys.platform
CLASSES = {  # how many runs of each the small suite has
    "accepted": 4,
    "progressive": 2,
    "incomplete": 2,
    "rejected": 5,
    "beside fault": 2,
    "verify": 1,
    "limit": 1,
    "unsupported": 1,
}


@dataclass(frozen=True)
class Judged:
    """A bad decoder: what is wrong with it, and where it was not judged as written."""

    name: str
    says: str
    problems: tuple[str, ...]
    seconds: float


def self_test(vectors: Path, *, names: Sequence[str] = (), jobs: int = 2) -> Iterator[Judged]:
    """Hold a trial of each bad decoder, on a few vectors of a folder.

    Args:
        vectors: a suite with runs of every class.
        names: only these decoders.
        jobs: processes at a time.

    Raises:
        SuiteError: the suite cannot be used for this, or there is no decoder of a name.
    """
    table = json.loads((BAD / "expected.json").read_bytes())
    unknown = set(names) - set(table)
    if unknown:
        raise SuiteError(f"no bad decoder has the name {', '.join(sorted(unknown))}")
    with scratch(prefix="selftest-") as folder:
        small_suite(load(vectors), folder)
        usual = [name for name, entry in table.items() if entry.get("system") in (None, SYSTEM)]
        for name in names or usual:
            trial = _trial(name.partition(" ")[0], table[name], folder, jobs)
            problems = (*_problems(table[name], trial), *_left(folder))
            yield Judged(name, table[name]["says"], problems, trial.seconds)


def small_suite(suite: Suite, folder: Path) -> None:
    """A few runs of each class in a folder of their own; files and goldens are copied.

    Raises:
        SuiteError: the suite has too few of a class.
    """
    chosen = _choose(suite)
    entries: dict[str, dict[str, Any]] = {}
    told = {
        entry["id"]: entry
        for entry in json.loads((suite.folder / "manifest.json").read_bytes())["vectors"]
    }
    (folder / "goldens").mkdir()
    for case in chosen:
        vector = case.vector
        entry = entries.setdefault(vector.id, told[vector.id] | {"runs": []})
        entry["runs"].append(told[vector.id]["runs"][int(case.id.rpartition("#")[2])])
        (folder / vector.file).parent.mkdir(parents=True, exist_ok=True)
        (folder / vector.file).write_bytes(case.data)
        if case.run.dump is not None:
            name = f"{case.run.dump[:16]}.z"
            shutil.copy(suite.folder / "goldens" / name, folder / "goldens" / name)
    manifest = {"suite": "self-test", "version": "", "spec": "", "vectors": list(entries.values())}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")


def class_of(case: Case) -> str | None:
    """The class of a run; None for those that a bad decoder may take for two."""
    run = case.run
    if run.verify:
        return "verify" if run.code == "E_DIGEST" and run.mode == "file" else None
    if run.exit == 4:
        return "limit" if run.mode == "file" else None
    if run.limits:
        return None
    if run.exit == 127:
        return "unsupported" if run.mode == "file" else None
    if run.dump_on_fault:
        return "beside fault" if run.exit == 1 and run.dump is not None else None
    if run.exit == 1:
        return "rejected" if run.mode == "file" and run.level is None else None
    if run.exit == 3:
        return "incomplete"
    return "accepted" if run.mode == "file" else "progressive"


def _choose(suite: Suite) -> list[Case]:
    """Of each class the smallest that say something, with different dumps and codes."""
    cases = suite.cases()
    chosen: list[Case] = []
    for name, n in CLASSES.items():
        found = [case for case in cases if class_of(case) == name and _is_telling(suite, case)]
        if name == "accepted":  # half of them in pairs: a level that is not the last, and the whole
            wholes = {case.vector.id: case for case in found if case.run.level is None}
            below = [
                case
                for case in found
                if case.vector.id in wholes and case.run.dump != wholes[case.vector.id].run.dump
            ]
            for case in _smallest(below, n // 4):
                chosen += [case, wholes[case.vector.id]]
            found = list(wholes.values())
            n -= len(chosen)
        if name == "rejected":
            chosen += _smallest([case for case in found if case.run.code == "E_CRC"], 1)
            n -= 1
        if not found:
            raise SuiteError(f"the suite has no run of the class {name!r} to test the harness with")
        chosen += [case for case in _smallest(found, n) if case not in chosen]
    return chosen


def _smallest(cases: Sequence[Case], n: int) -> list[Case]:
    ordered = sorted(cases, key=lambda case: (case.vector.size, case.id))
    distinct = {(case.run.dump, case.run.code): case for case in reversed(ordered)}
    return sorted(distinct.values(), key=ordered.index)[:n]


def _is_telling(suite: Suite, case: Case) -> bool:
    """Whether its dump, if it has one, shows the order of slots."""
    if case.run.dump is None:
        return True
    tiles = tiles_of(suite.golden(case.run.dump))
    return any(len(set(channel)) > 1 for tile in tiles for channel in tile.channels)


def _trial(name: str, entry: Mapping[str, Any], folder: Path, jobs: int) -> Trial:
    command = [sys.executable, "-I", "-S", str(BAD / "__main__.py"), name, str(folder)]
    options = Options(
        command,
        bounds=BOUNDS,
        jobs=jobs,
        batch=bool(entry.get("batch")),
        seed=sum(name.encode()),
        patience=PATIENCE,
        n_again=3,
    )
    return hold(Choice(folder, n_fresh=0), options)


def _problems(entry: Mapping[str, Any], trial: Trial) -> Iterator[str]:
    """Where the judgement is another than the one written down."""
    if trial.exit != entry.get("exit", FAILED):
        yield f"exit {trial.exit}, should be {entry.get('exit', FAILED)}"
        yield from trial.incomplete
    for name, kinds in sorted(_kinds(entry, trial).items()):
        default = [] if name == "again" else entry.get("all", ["pass"])
        wanted = entry.get(name, default)
        must = {kind for kind in wanted if not kind.endswith("?")}
        may = {kind.rstrip("?") for kind in wanted}
        if not must <= kinds <= may:
            came = ", ".join(sorted(kinds)) or "nothing"
            yield f"{name}: {came}, should be {', '.join(wanted) or 'nothing'}"

    yield from _not_told(entry, trial)


def _not_told(entry: Mapping[str, Any], trial: Trial) -> Iterator[str]:
    """What the reports should say and do not, and what they must not hold."""
    text = report(trial)
    yield from (f"not told: {words}" for words in entry.get("told", []) if words not in text)
    ElementTree.fromstring(as_junit(trial))
    for name, made in (
        ("the table", text),
        ("JSON", as_json(trial)),
        ("JUnit", as_junit(trial)),
        ("the page", as_html(trial)),
    ):
        strange = {c for c in made if c != "\n" and not c.isprintable()}
        if strange:
            yield f"{name} has characters that are not printable: {sorted(map(ascii, strange))}"


def _left(folder: Path) -> Iterator[str]:
    """What a decoder has left running."""
    with (folder / ALIVE).open("wb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield "a process that it started is still there"


def _kinds(entry: Mapping[str, Any], trial: Trial) -> dict[str, set[str]]:
    """The kinds of outcome by class."""
    found: dict[str, set[str]] = {"again": {result.kind for result in trial.again}}
    for result in trial.results:
        name = class_of(result.case) or "?"
        if result.case.vector.family == "canary" and "canary" in entry:
            name = "canary"
        name = "any" if "any" in entry else name
        found.setdefault(name, set()).add(result.kind)
    return found
