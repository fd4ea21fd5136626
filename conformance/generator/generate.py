"""Write the vectors: `python -m conformance.generator [--check] [--no-mutants]`.

Files, goldens and expectations are made anew from the recipes of `cases`. A golden is written only
where the oracle and the reference decoder agree on verdict, fault code, offset and dump, and where
the recipe expected that verdict.

A case that tells nothing that another does not, by its requirements and the wrong decoders it
shows, is no vector: `cases/redundant.json` names it, and the vector that says the same.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from conformance.generator.cases import FAMILIES
from conformance.generator.cases.case import Case
from conformance.generator.families import generated
from conformance.generator.matrix import pages
from conformance.generator.suite import (
    ZSTD,
    DisagreementError,
    Entry,
    Vector,
    agreed,
    entry_of,
    goldens,
    json_table,
    manifest,
)
from conformance.generator.traceability import requirements_of
from conformance.harness.judging.grouping import grouped, ungrouped

__all__ = ["collect", "fingerprint_table", "main", "make_all", "stored_fingerprints"]

ROOT = Path(__file__).resolve().parents[2]
VECTORS = ROOT / "conformance" / "vectors"
DOCS = ROOT / "docs"
REDUNDANT = ROOT / "conformance" / "generator" / "cases" / "redundant.json"
OF_RUNS = ("outcomes", "codes")  # of a fingerprint
KEPT = ("LICENSE", "manifest.schema.json")  # in the folder, and not generated


def main(argv: Sequence[str] | None = None) -> None:
    """Write all files, or compare them with what is there."""
    parser = argparse.ArgumentParser(prog="python -m conformance.generator", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument(
        "--no-mutants", action="store_true", help="fingerprints stay as they are (quick)"
    )
    args = parser.parse_args(argv)
    try:
        vectors = make_all()
        if args.check and _stored("manifest.json")["zstd"] != ZSTD:
            problems = differing_outcomes(vectors)
        else:
            wanted = files_of(vectors, mutants=not args.no_mutants)
            problems = differing(wanted) if args.check else []
            if not args.check:
                write(wanted)
                size = sum(map(len, wanted.values()))
                print(f"{len(vectors)} vectors, {len(wanted)} files, {size:,} bytes")
    except DisagreementError as findings:
        sys.exit(f"No golden without agreement:\n{findings}")
    if problems:
        sys.exit("\n".join([*problems[:20], f"{len(problems)} differ: run {parser.prog}"]))


def make_all() -> list[Vector]:
    """All vectors.

    Raises:
        DisagreementError: with all findings.
    """
    vectors, findings = list[Vector](), list[str]()
    for family, provenance, case in collect():
        name = f"{family}-{case.name}"
        try:
            outcomes = tuple(agreed(case.data, run) for run in case.runs)
        except DisagreementError as finding:
            findings.append(f"{name} {finding}")
            continue
        if outcomes[0].code != case.expect:
            findings.append(f"{name}: {outcomes[0].code}, the recipe expected {case.expect}")
        vectors.append(Vector(name, family, provenance, case, outcomes, _twin(family, case)))
    ids = Counter(vector.id for vector in vectors)
    findings += [f"{name}: two vectors of this id" for name, n in ids.items() if n > 1]
    accepted = {None, *(v.id for v in vectors if v.outcomes[0].exit == 0)}
    findings += [f"{v.id}: no legal vector {v.twin}" for v in vectors if v.twin not in accepted]
    if findings:
        raise DisagreementError("\n".join(findings))
    return vectors


def collect() -> Iterator[tuple[str, str, Case]]:
    """(family, provenance, case) of all recipes."""
    for module in FAMILIES:
        for recipe in module.RECIPES:
            for case in recipe():
                yield module.FAMILY, f"{module.__name__}:{recipe.__name__}", case


def _twin(family: str, case: Case) -> str | None:
    """The full id of the twin, which a case names within its family or in full."""
    twin = case.twin
    if twin is None or twin.startswith(tuple(f"{module.FAMILY}-" for module in FAMILIES)):
        return twin
    return f"{family}-{twin}"


def files_of(vectors: Sequence[Vector], *, mutants: bool) -> dict[Path, bytes]:
    """All generated files: vectors, goldens, manifest, fingerprints, pages of docs/.

    Args:
        vectors: all of them.
        mutants: they are tried; if not, the fingerprints stay as they are.
    """
    entries = [entry_of(vector) for vector in vectors]
    files = {entry["file"]: v.case.data for entry, v in zip(entries, vectors, strict=True)}
    fingerprints = _tried(entries, files) if mutants else stored_fingerprints()
    killers(entries, fingerprints)
    left_out = redundant(entries) if mutants else _left_out()
    entries = [entry for entry in entries if entry["id"] not in left_out]
    vectors = [vector for vector in vectors if vector.id not in left_out]
    files = {entry["file"]: files[entry["file"]] for entry in entries}
    fingerprints = {name: _without(found, left_out) for name, found in fingerprints.items()}
    families, dumps = generated({vector.id: vector.case.data for vector in vectors})
    files |= goldens(dumps)
    files |= goldens(o.dump for v in vectors for o in v.outcomes if o.dump is not None)
    files["manifest.json"] = manifest(families, entries)
    files["fingerprints.json"] = fingerprint_table(fingerprints)
    found = {VECTORS / name: data for name, data in files.items()}
    texts = pages(entries, requirements_of(ROOT))
    found |= {DOCS / name: text.encode() for name, text in texts.items()}
    return found | {REDUNDANT: json_table(left_out)}


def fingerprint_table(fingerprints: Entry) -> bytes:
    """The file of fingerprints, which are given by run."""
    return json_table(
        {
            name: found | {key: grouped(found[key]) for key in OF_RUNS}
            for name, found in fingerprints.items()
        }
    )


def stored_fingerprints() -> Entry:
    """The committed fingerprints, by run."""
    stored = _stored("fingerprints.json")
    return {
        name: found | {key: ungrouped(found[key]) for key in OF_RUNS}
        for name, found in stored.items()
    }


def _tried(entries: Sequence[Entry], files: Mapping[str, bytes]) -> Entry:
    from conformance.mutants import fingerprints

    return dict(fingerprints(entries, files))


def killers(entries: Sequence[Entry], fingerprints: Entry) -> None:
    """Fill in `kills`: the mutants that a vector tells from a right decoder, by verdict or code."""
    killed_by: dict[str, list[str]] = {}
    for name, found in fingerprints.items():
        for run in found["outcomes"].keys() | found["codes"].keys():
            killed_by.setdefault(run, []).append(name)
    numbers = {name: number for number, name in enumerate(fingerprints)}
    for entry in entries:
        runs = [f"{entry['id']}#{number}" for number in range(len(entry["runs"]))]
        names = {name for run in runs for name in killed_by.get(run, ())}
        entry["kills"] = sorted(names, key=numbers.__getitem__)


def redundant(entries: Sequence[Entry]) -> dict[str, str]:
    """Vectors that tell nothing that another does not, and which that is.

    Of those alike the first is kept, or the one that others are held against.
    """
    twins = {entry["near_miss_of"] for entry in entries}
    kept, left_out = dict[tuple[str, ...], str](), dict[str, str]()
    for entry in sorted(entries, key=lambda entry: entry["id"] not in twins):
        key = (*sorted(entry["requirements"]), *sorted(entry["kills"]))
        if kept.setdefault(key, entry["id"]) != entry["id"] and entry["id"] not in twins:
            left_out[entry["id"]] = kept[key]
    return dict(sorted(left_out.items()))


def _without(fingerprint: Entry, left_out: Mapping[str, str]) -> Entry:
    """A fingerprint without the runs of vectors that are left out."""
    return {
        key: {run: found for run, found in value.items() if run.rpartition("#")[0] not in left_out}
        if isinstance(value, dict)
        else value
        for key, value in fingerprint.items()
    }


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
    stored, made = (
        {entry["id"]: [[run[key] for key in keys] for run in entry["runs"]] for entry in entries}
        for entries in (_stored("manifest.json")["vectors"], map(entry_of, vectors))
    )
    names = {*stored, *made} - _left_out().keys()
    return [f"{name} differs" for name in sorted(names) if stored.get(name) != made.get(name)]


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


def _left_out() -> Entry:
    found: Entry = json.loads(REDUNDANT.read_text(encoding="utf-8"))
    return found


def _stored(name: str) -> Entry:
    found: Entry = json.loads((VECTORS / name).read_text(encoding="utf-8"))
    return found
