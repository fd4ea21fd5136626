"""Findings: made smaller, as long as the same is wrong, and kept as files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path

from conformance.decoders.outcomes import Outcome, Run
from conformance.decoders.reference import by_codec
from conformance.fuzzing.fuzz import Finding, check
from conformance.generator.tampering import Parts

__all__ = ["keep", "smaller"]


def smaller(finding: Finding, *, decode: Callable[[bytes, Run], Outcome] = by_codec) -> Finding:
    """The finding with as much left out as leaves something of the kind wrong."""
    kind = _kind(finding.says)

    def is_wrong(candidate: Finding) -> bool:
        try:
            _, says = check(candidate.data, candidate.run, decode=decode)
        except Exception:  # too damaged for the oracle
            return False
        return bool(says) and _kind(says) == kind

    changed = True
    while changed:
        changed = False
        for candidate in _less(finding):
            if is_wrong(candidate):
                _, says = check(candidate.data, candidate.run, decode=decode)
                finding, changed = replace(candidate, says=says), True
                break
    return finding


def _kind(says: str) -> str:
    """Findings of one kind have the same cause, most likely."""
    return says.split(":")[0]


def _less(finding: Finding) -> Iterator[Finding]:
    """The finding without one thing: an option, a piece, a packet, a chunk, the end."""
    data, run = finding.data, finding.run
    plainer = (
        *(replace(run, verify=False), replace(run, limits=None), replace(run, level=None)),
        replace(run, dump_on_fault=False),
    )
    for plain in plainer:
        if plain != run:
            yield replace(finding, run=plain)
    if run.arrival is not None:
        yield replace(finding, run=replace(run, arrival=None))
        for k in range(len(run.arrival)):
            kept = run.arrival[:k] + run.arrival[k + 1 :]
            yield replace(finding, run=replace(run, arrival=kept))
        return  # offsets of pieces would not fit another stream
    for cut in (2, 4, 16):
        yield replace(finding, data=data[: len(data) - len(data) // cut])
    try:
        n_packets, n_chunks = len(Parts.of(data).packets), len(Parts.of(data).chunks)
    except (IndexError, ValueError):
        return
    for k in reversed(range(n_packets)):
        parts = Parts.of(data)
        rows = parts.table()
        del parts.packets[k], rows[36 * k : 36 * k + 36]
        parts.header[24 + 4 : 24 + 8] = len(parts.packets).to_bytes(4, "little")
        parts.fit()
        yield replace(finding, data=parts.join())
    for k in range(n_chunks):
        parts = Parts.of(data)
        del parts.chunks[k]
        yield replace(finding, data=parts.join())


def keep(finding: Finding, folder: Path) -> Path:
    """Write a finding: the stream, and beside it the run and what is wrong."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{abs(hash((finding.data, finding.says))) % (1 << 40):010x}"
    path = folder / f"{name}.evogs"
    path.write_bytes(finding.data)
    about = {"says": finding.says, "run": asdict(finding.run)}
    path.with_suffix(".json").write_text(json.dumps(about, indent=1))
    return path
