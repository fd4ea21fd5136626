"""How each mutant differs from what the vectors expect, so that a decoder can be told its fault."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from conformance.mutants.library import MUTANTS
from conformance.mutants.mutant import Mutant, load
from conformance.mutants.trial import fault_text, limit_memory, outcome, run_of, sha256, verdict

__all__ = ["Fingerprint", "fingerprints", "runs_of"]

Entry = Mapping[str, Any]
Fingerprint = dict[str, Any]  # says, section, outcomes and codes: {run: what came}

_vectors: tuple[tuple[str, bytes, Entry], ...] = ()  # of a worker: run id, stream, run


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
    runs = tuple(runs_of(vectors, files))
    context = multiprocessing.get_context("spawn")  # workers limit their memory
    with context.Pool(jobs, _begin, (runs,)) as pool:
        return dict(pool.imap(_fingerprint, mutants))


def runs_of(
    vectors: Sequence[Entry], files: Mapping[str, bytes]
) -> Iterator[tuple[str, bytes, Entry]]:
    """(id#number, stream, run) of all vectors."""
    for vector in vectors:
        for number, run in enumerate(vector["runs"]):
            yield f"{vector['id']}#{number}", files[vector["file"]], run


def _begin(runs: tuple[tuple[str, bytes, Entry], ...]) -> None:
    global _vectors
    limit_memory()
    _vectors = runs


def _fingerprint(mutant: Mutant) -> tuple[str, Fingerprint]:
    module, outcomes, codes = load(mutant), dict[str, str](), dict[str, str]()
    for name, data, run in _vectors:
        came = outcome(module, data, run_of(run))
        seen, fault = verdict(came.exit, sha256(came.dump)), fault_text(came.code, came.offset)
        if seen != verdict(run["exit"], run["dump"]):
            outcomes[name] = seen
        elif fault != fault_text(run["code"], run["offset"]):
            codes[name] = fault
    says = {"says": mutant.says, "section": mutant.section}
    return mutant.name, says | {"outcomes": outcomes, "codes": codes}
