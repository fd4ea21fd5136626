"""How each mutant differs from what the vectors expect, so that a decoder can be told its fault."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from conformance.decoders.outcomes import Outcome
from conformance.mutants.library import MUTANTS
from conformance.mutants.mutant import Mutant, load, original
from conformance.mutants.progress import told
from conformance.mutants.reached import changed_lines, lines_reached
from conformance.mutants.trial import fault_text, limit_memory, outcome, run_of, sha256, verdict

__all__ = ["Fingerprint", "fingerprints"]

Entry = Mapping[str, Any]
Fingerprint = dict[str, Any]  # says, section, outcomes and codes: {run: what came}


@dataclass(frozen=True)
class _VectorRun:
    """A run of a vector.

    Attributes:
        name: id#number.
        data: the stream.
        entry: the run in the manifest.
        reached: lines of the oracle where statements begin that the run comes to; None if the
            oracle does not end it as the manifest says.
    """

    name: str
    data: bytes
    entry: Entry
    reached: frozenset[int] | None

    def may_differ(self, changed: frozenset[int] | None) -> bool:
        """Whether a decoder that is changed there may end the run otherwise than expected."""
        return changed is None or self.reached is None or not changed.isdisjoint(self.reached)


_runs: tuple[_VectorRun, ...] = ()  # of a worker


def fingerprints(
    vectors: Sequence[Entry],
    files: Mapping[str, bytes],
    mutants: Sequence[Mutant] = MUTANTS,
    *,
    jobs: int = 2,
) -> dict[str, Fingerprint]:
    """{mutant: fingerprint}.

    Args:
        vectors: entries of the manifest.
        files: the streams, by the path in the manifest.
        mutants: the mutants.
        jobs: processes.

    Returns:
        Of each mutant `says`, `section`, `outcomes` with the verdict of each run ("id#number")
        that ends or decodes otherwise than the manifest says, and `codes` with the fault of each
        run that reports another code or offset, "E_CRC@371".
    """
    context = multiprocessing.get_context("spawn")  # workers limit their memory
    with context.Pool(jobs, _begin, (tuple(_runs_of(vectors, files)),)) as pool:
        tried = pool.imap_unordered(_fingerprint, mutants)
        found = dict(told(tried, len(mutants), "mutants"))
    return {mutant.name: found[mutant.name] for mutant in mutants}


def _runs_of(vectors: Sequence[Entry], files: Mapping[str, bytes]) -> Iterator[_VectorRun]:
    for vector in vectors:
        data = files[vector["file"]]
        for number, run in enumerate(vector["runs"]):
            came, reached = lines_reached(data, run_of(run))
            is_right = _difference(came, run) is None
            yield _VectorRun(f"{vector['id']}#{number}", data, run, reached if is_right else None)


def _begin(runs: tuple[_VectorRun, ...]) -> None:
    global _runs
    limit_memory()
    _runs = runs


def _fingerprint(mutant: Mutant) -> tuple[str, Fingerprint]:
    found: Fingerprint = {"says": mutant.says, "section": mutant.section}
    found |= {"outcomes": {}, "codes": {}}
    changed = changed_lines(original(), mutant.text(original()))
    for run in _runs:
        if not run.may_differ(changed):
            continue
        difference = _difference(outcome(load(mutant), run.data, run_of(run.entry)), run.entry)
        if difference is not None:
            key, came = difference
            found[key][run.name] = came
    return mutant.name, found


def _difference(came: Outcome, run: Entry) -> tuple[str, str] | None:
    """How an outcome differs from the manifest: "outcomes" or "codes", and what came."""
    seen, fault = verdict(came.exit, sha256(came.dump)), fault_text(came.code, came.offset)
    if seen != verdict(run["exit"], run["dump"]):
        return "outcomes", seen
    return None if fault == fault_text(run["code"], run["offset"]) else ("codes", fault)
