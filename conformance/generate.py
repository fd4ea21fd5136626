"""Write the vectors: `python -m conformance.generate [--check]`.

Files, goldens and expectations are made anew from the recipes of `cases`. A golden is written only
where the oracle and the reference decoder agree on verdict, fault code, offset and dump, and where
the recipe expected that verdict.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard

from conformance.cases import FAMILIES
from conformance.cases.case import Case
from conformance.families import generated
from conformance.matrix import matrix
from conformance.outcomes import Outcome, Run, by_codec, by_oracle
from conformance.traceability import requirements_of

__all__ = ["Disagreement", "Vector", "collect", "entry_of", "main", "make_all"]

ROOT = Path(__file__).resolve().parents[1]
VECTORS = ROOT / "conformance" / "vectors"
MATRIX = ROOT / "docs" / "conformance-matrix.md"
KEPT = ("LICENSE", "manifest.schema.json")  # in the folder, and not generated
ZSTD = ".".join(map(str, zstandard.ZSTD_VERSION))

Entry = dict[str, Any]


class Disagreement(Exception):  # noqa: N818 - it is a finding, not a mistake of the caller
    """The two producers of goldens, or the recipe, do not agree."""


@dataclass(frozen=True)
class Vector:
    """A case of a family, and the outcomes that its producers agree on."""

    id: str
    family: str
    provenance: str
    case: Case
    outcomes: tuple[Outcome, ...]


def collect() -> Iterator[tuple[str, str, Case]]:
    """(family, provenance, case) of all recipes."""
    for module in FAMILIES:
        for recipe in module.RECIPES:
            for case in recipe():
                yield module.FAMILY, f"{module.__name__}:{recipe.__name__}", case


def make_all() -> list[Vector]:
    """All vectors.

    Raises:
        Disagreement: with all findings.
    """
    vectors, findings = list[Vector](), list[str]()
    for family, provenance, case in collect():
        name = f"{family}-{case.name}"
        outcomes = []
        for run in case.runs:
            outcome, other = by_oracle(case.data, run), by_codec(case.data, run)
            if outcome != other:
                findings.append(f"{name} {run}: oracle {_said(outcome)}, codec {_said(other)}")
            outcomes.append(outcome)
        if outcomes[0].code != case.expect:
            findings.append(f"{name}: {_said(outcomes[0])}, the recipe expected {case.expect}")
        vectors.append(Vector(name, family, provenance, case, tuple(outcomes)))
    ids = [vector.id for vector in vectors]
    findings += [f"{name}: two vectors of this id" for name in set(ids) if ids.count(name) > 1]
    accepted = {v.id for v in vectors if v.outcomes[0].exit == 0}
    findings += [
        f"{v.id}: its twin {twin} is not a legal vector"
        for v in vectors
        if (twin := _twin(v)) is not None and twin not in accepted
    ]
    if findings:
        raise Disagreement("\n".join(findings))
    return vectors


def _said(outcome: Outcome) -> str:
    dump = "-" if outcome.dump is None else hashlib.sha256(outcome.dump).hexdigest()[:12]
    return f"{outcome.exit} {outcome.code} {outcome.offset} {dump}"


def _twin(vector: Vector) -> str | None:
    """The full id of the twin, which a case names within its family or in full."""
    twin = vector.case.twin
    if twin is None or twin.startswith(tuple(f"{module.FAMILY}-" for module in FAMILIES)):
        return twin
    return f"{vector.family}-{twin}"


def entry_of(vector: Vector) -> Entry:
    """The vector in the manifest, but for `kills`."""
    case = vector.case
    return {
        "id": vector.id,
        "file": f"{vector.family}/{vector.id}.evogs",
        "sha256": hashlib.sha256(case.data).hexdigest(),
        "size": len(case.data),
        "family": vector.family,
        "tests": case.tests,
        "faulty": case.faulty,
        "requirements": [rule for rule in case.rules if rule.startswith("R-")],
        "sections": [rule for rule in case.rules if not rule.startswith("R-")],
        **_needs(case.data),
        "near_miss_of": _twin(vector),
        "runs": [_run(*pair) for pair in zip(case.runs, vector.outcomes, strict=True)],
        "provenance": vector.provenance,
        "kills": [],
    }


def _needs(data: bytes) -> dict[str, int]:
    """What a decoder must support to be asked; of a damaged header, the least."""
    tier, degree = (*data[10:12], 0, 0)[:2]
    return {
        "tier": tier if 1 <= tier <= 3 else 1,
        "sh_degree": degree if degree <= 3 else 0,
    }


def _run(run: Run, outcome: Outcome) -> Entry:
    dump = None if outcome.dump is None else hashlib.sha256(outcome.dump).hexdigest()
    return {
        "mode": run.mode,
        "level": run.level,
        "limits": None if run.limits is None else dict(run.limits),
        "verify": run.verify,
        "arrival": None if run.arrival is None else [list(piece) for piece in run.arrival],
        "exit": outcome.exit,
        "code": outcome.code,
        "offset": outcome.offset,
        "dump": dump,
    }


def golden_name(digest: str) -> str:
    """The file of a dump, by its SHA-256."""
    return f"goldens/{digest[:16]}.z"


def files_of(vectors: Sequence[Vector], *, mutants: bool = True) -> dict[str, bytes]:
    """All generated files of the folder by path: vectors, goldens, manifest, fingerprints.

    Args:
        vectors: all of them.
        mutants: they are tried; if not, the fingerprints stay as they are.
    """
    files = dict[str, bytes]()
    entries = [entry_of(vector) for vector in vectors]
    for vector, entry in zip(vectors, entries, strict=True):
        files[entry["file"]] = vector.case.data
        for run, outcome in zip(entry["runs"], vector.outcomes, strict=True):
            if outcome.dump is not None:
                files[golden_name(run["dump"])] = zlib.compress(outcome.dump, 9)
    families, dumps = generated({vector.id: vector.case.data for vector in vectors})
    for dump in dumps:
        files[golden_name(hashlib.sha256(dump).hexdigest())] = zlib.compress(dump, 9)
    fingerprints = tried(entries, files) if mutants else _stored("fingerprints.json")
    killers(entries, fingerprints)
    manifest = {"suite": "evogs-conformance", "version": "1.0", "spec": "1.0-draft", "zstd": ZSTD}
    files["manifest.json"] = _lines(manifest, families, entries)
    files["fingerprints.json"] = _table(fingerprints)
    return files


def killers(entries: Sequence[Entry], fingerprints: Entry) -> None:
    """Fill in `kills`: the mutants that a vector tells from a right decoder, by verdict or code."""
    for entry in entries:
        runs = {f"{entry['id']}#{number}" for number in range(len(entry["runs"]))}
        entry["kills"] = [
            name
            for name, found in fingerprints.items()
            if runs & (found["outcomes"].keys() | found["codes"].keys())
        ]


def tried(entries: Sequence[Entry], files: Mapping[str, bytes]) -> Entry:
    """The fingerprints of all mutants."""
    from conformance.mutants import fingerprints

    return dict(fingerprints(entries, files))


def _lines(manifest: Entry, families: Sequence[Entry], entries: Sequence[Entry]) -> bytes:
    """JSON with a line for each vector, so that a change of one shows as one."""
    head = json.dumps(manifest, indent=1)[:-2]
    parts = [
        f' "{name}": [\n' + ",\n".join("  " + json.dumps(row) for row in rows) + "\n ]"
        for name, rows in (("families", families), ("vectors", entries))
    ]
    return (head + ",\n" + ",\n".join(parts) + "\n}\n").encode()


def _table(rows: Mapping[str, Any]) -> bytes:
    lines = [f" {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items()]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def main(argv: Sequence[str] | None = None) -> None:
    """Write all files, or compare them with what is there."""
    parser = argparse.ArgumentParser(prog="python -m conformance.generate", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument(
        "--no-mutants", action="store_true", help="fingerprints stay as they are (quick)"
    )
    args = parser.parse_args(argv)
    try:
        vectors = make_all()
    except Disagreement as findings:
        sys.exit(f"No golden without agreement:\n{findings}")
    if args.check and _stored("manifest.json")["zstd"] != ZSTD:
        problems = differing_outcomes(vectors)
    else:
        files = files_of(vectors, mutants=not args.no_mutants)
        text = matrix(json.loads(files["manifest.json"]), requirements_of(ROOT))
        wanted = {VECTORS / name: data for name, data in files.items()} | {MATRIX: text.encode()}
        problems = differing(wanted) if args.check else []
        if not args.check:
            write(wanted)
            size = sum(map(len, files.values()))
            print(f"{len(vectors)} vectors, {len(files)} files, {size:,} bytes")
    if problems:
        sys.exit("\n".join([*problems[:20], f"{len(problems)} files differ: regenerate them"]))


def differing(wanted: Mapping[Path, bytes]) -> list[str]:
    """Files that are missing, differ, or should not be there."""
    problems = [
        f"{path.relative_to(ROOT)} differs"
        for path, data in wanted.items()
        if not path.is_file() or path.read_bytes() != data
    ]
    return problems + [f"{path.relative_to(ROOT)} is not generated" for path in strays(wanted)]


def differing_outcomes(vectors: Sequence[Vector]) -> list[str]:
    """Under another libzstd: vectors whose runs end otherwise than the manifest says."""
    keys = ("exit", "code", "dump")
    stored = {
        entry["id"]: [[run[key] for key in keys] for run in entry["runs"]]
        for entry in _stored("manifest.json")["vectors"]
    }
    made = {
        vector.id: [[run[key] for key in keys] for run in entry_of(vector)["runs"]]
        for vector in vectors
    }
    return [f"{name} differs" for name in {*stored, *made} if stored.get(name) != made.get(name)]


def write(wanted: Mapping[Path, bytes]) -> None:
    """Write the files, remove those that are not generated any more."""
    for path in strays(wanted):
        path.unlink()
    for path, data in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_bytes() != data:
            path.write_bytes(data)


def strays(wanted: Mapping[Path, bytes]) -> list[Path]:
    """Files in the folder that nothing generates."""
    there = (path for path in VECTORS.rglob("*") if path.is_file() and path.name not in KEPT)
    return sorted(path for path in there if path not in wanted)


def _stored(name: str) -> Entry:
    found: Entry = json.loads((VECTORS / name).read_text(encoding="utf-8"))
    return found


if __name__ == "__main__":
    main()
