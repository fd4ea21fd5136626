"""A vector explained: what it tests, what is expected, and every byte of it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path

from conformance.harness.judging.diagnosis import read_fingerprints
from conformance.harness.judging.families import expand
from conformance.harness.judging.judging import VERDICTS
from conformance.harness.manifest import Case, Suite, SuiteError, load
from conformance.harness.reporting.anatomy import anatomy
from conformance.harness.reporting.pieces import Piece

__all__ = ["explain"]

BYTES_PER_LINE = 12
MAX_BYTES = 48  # of a field: the rest is counted
SPEC = Path(__file__).resolve().parents[3] / "spec" / "evogs.md"


def explain(folder: Path, name: str) -> str:
    """The text for a vector, or for a case of a family ("every-prefix-of-core-two-tiles@371").

    Raises:
        SuiteError: there is no such vector.
    """
    suite = load(folder)
    cases = _cases(suite, name)
    return "\n".join(_lines(suite, cases))


def _cases(suite: Suite, name: str) -> list[Case]:
    name = name.partition("#")[0]
    own = [vector for vector in suite.vectors if vector.id == name]
    for vector in own:
        data = suite.read(vector)
        runs = enumerate(vector.runs)
        return [Case(f"{vector.id}#{number}", vector, run, data) for number, run in runs]
    if "@" in name:
        cases = [case for case in expand(suite) if case.id.partition("#")[0] == name]
        if cases:
            return cases
    near = get_close_matches(name, [vector.id for vector in suite.vectors], 3)
    hint = f"; near: {', '.join(near)}" if near else ""
    raise SuiteError(f"the suite has no vector {name!r}{hint}")


def _lines(suite: Suite, cases: Sequence[Case]) -> Iterator[str]:
    vector, data = cases[0].vector, cases[0].data
    yield f"{cases[0].id.partition('#')[0]} ({len(data)} bytes, family {vector.family})"
    yield f"  tests        {vector.tests}"
    yield f"  a faulty one {vector.faulty}"
    if vector.near_miss_of:
        yield f"  twin         {vector.near_miss_of}"
    yield f"  made by      {vector.provenance}"
    texts = _requirements()
    for requirement in vector.requirements:
        yield f"  {requirement:12} {texts.get(requirement, '')}".rstrip()
    says = read_fingerprints(suite.folder)
    for mutant in vector.kills:
        yield f"  kills        {mutant}: {says[mutant].says if mutant in says else '?'}"
    yield ""
    for case in cases:
        run = case.run
        verdict = VERDICTS[run.exit]
        if run.code is not None:
            verdict += f", {run.code} at {run.offset}"
        if run.dump is not None:
            verdict += f", dump {run.dump[:12]}"
        number = case.id.rpartition("#")[2]
        yield f"  run {number}: {run.options()}: exit {run.exit}, {verdict}"
        yield from (f"         {key} {value}" for key, value in (run.limits or {}).items())
        if run.arrival is not None:
            yield "         " + " ".join(f"{at}+{size}" for at, size in run.arrival)
    yield ""
    faults = {
        case.run.offset: case.run.code
        for case in cases
        if case.run.code and case.run.offset is not None
    }
    yield from _bytes(anatomy(data), faults)


def _bytes(pieces: Sequence[Piece], faults: dict[int, str]) -> Iterator[str]:
    shown = set[int]()
    for piece in pieces:
        if piece.starts:
            mark = f"   <-- {faults[piece.at]}" if piece.at in faults else ""
            shown.add(piece.at)
            yield f"--- {piece.at}: {piece.starts}{mark}"
        yield from _piece(piece)
    for offset, code in sorted(faults.items()):
        if offset not in shown:
            yield f"--- {offset}: nothing begins here   <-- {code}"


def _piece(piece: Piece) -> Iterator[str]:
    raw = piece.raw[:MAX_BYTES]
    rows = [raw[at : at + BYTES_PER_LINE] for at in range(0, len(raw), BYTES_PER_LINE)]
    text = f"{piece.name} {piece.value}".rstrip()
    text += f"   ! {piece.remark}" if piece.remark else ""
    width = 3 * BYTES_PER_LINE
    for number, row in enumerate(rows):
        line = f"{piece.at + number * BYTES_PER_LINE:6}  {row.hex(' '):{width}}"
        yield f"{line}  {text}" if number == 0 else line.rstrip()
    if len(piece.raw) > MAX_BYTES:
        yield f"        ... {len(piece.raw) - MAX_BYTES} more bytes"


def _requirements() -> dict[str, str]:
    """The text of each requirement, where the spec is at hand."""
    if not SPEC.is_file():
        return {}
    found = re.findall(r"^(?:- )?(R-[0-9.]+-[0-9]+) \[\w+\] (.*)$", SPEC.read_text("utf-8"), re.M)
    return dict(found)
