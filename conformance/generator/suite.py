"""Vectors with their goldens, and the files that hold them: manifest, streams, dumps."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard

from conformance.decoders.outcomes import Outcome, Run, by_oracle
from conformance.generator.cases.case import Case

__all__ = [
    "ZSTD",
    "DisagreementError",
    "Entry",
    "Vector",
    "agreed",
    "entry_of",
    "goldens",
    "json_table",
    "manifest",
    "write_suite",
]

ZSTD = ".".join(map(str, zstandard.ZSTD_VERSION))
Entry = dict[str, Any]


class DisagreementError(Exception):
    """The two producers of goldens, or the recipe, do not agree."""


@dataclass(frozen=True)
class Vector:
    """A case of a family, and the outcomes that its producers agree on."""

    id: str
    family: str
    provenance: str
    case: Case
    outcomes: tuple[Outcome, ...]
    twin: str | None = None


def agreed(data: bytes, run: Run, *, has_codec: bool = True) -> Outcome:
    """The outcome of both producers, or of the oracle where there is no codec.

    Raises:
        DisagreementError: they differ.
    """
    outcome = by_oracle(data, run)
    if not has_codec:
        return outcome
    from conformance.decoders.reference import by_codec

    if outcome != (other := by_codec(data, run)):
        raise DisagreementError(f"{run}: oracle {_said(outcome)}, codec {_said(other)}")
    return outcome


def write_suite(vectors: Sequence[Vector], folder: Path) -> None:
    """Write vectors, their goldens and a manifest without families."""
    entries = [entry_of(vector) for vector in vectors]
    files = {entry["file"]: v.case.data for entry, v in zip(entries, vectors, strict=True)}
    files |= goldens(o.dump for v in vectors for o in v.outcomes if o.dump is not None)
    files["manifest.json"] = manifest([], entries)
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def goldens(dumps: Iterable[bytes]) -> dict[str, bytes]:
    """The files of dumps, named by their SHA-256."""
    return {
        f"goldens/{hashlib.sha256(dump).hexdigest()[:16]}.z": zlib.compress(dump, 9)
        for dump in dumps
    }


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
        "near_miss_of": vector.twin,
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
    beside = {"dump_on_fault": True} if run.dump_on_fault else {}
    return beside | {
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


def manifest(families: Sequence[Entry], entries: Sequence[Entry]) -> bytes:
    """JSON with a line for each vector, so that a change of one shows as one."""
    top = {"suite": "evogs-conformance", "version": "1.0", "spec": "1.0-draft 5", "zstd": ZSTD}
    lines = [json.dumps(top, indent=1)[:-2]]
    for name, rows in (("families", families), ("vectors", entries)):
        inner = ",\n".join("  " + json.dumps(row) for row in rows)
        lines.append(f' "{name}": [\n{inner}\n ]' if rows else f' "{name}": []')
    return (",\n".join(lines) + "\n}\n").encode()


def json_table(rows: Mapping[str, Any]) -> bytes:
    """JSON of an object with a line for each of its values."""
    lines = [f" {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items()]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def _said(outcome: Outcome) -> str:
    dump = "-" if outcome.dump is None else hashlib.sha256(outcome.dump).hexdigest()[:12]
    return f"{outcome.exit} {outcome.code} {outcome.offset} {dump}"
