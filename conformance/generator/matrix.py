"""Pages of `docs/` that say what the vectors cover: requirements, vectors, mutants.

- `conformance-matrix.md`: a row for each requirement, for people;
- `conformance-vectors.csv`: a row for each vector;
- `conformance-mutants.csv`: a row for each wrong decoder.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

__all__ = ["pages"]

SHOWN = 3  # vectors named for a requirement or a mutant

HEAD = """# What the vectors cover

Made by `python -m conformance.generator`; do not edit.

The suite has {n_vectors} vectors and {n_mutants} mutants. A mutant is the oracle with one change
that makes it wrong. A mutant is killed if a vector tells it from a right decoder.

- [conformance-vectors.csv](conformance-vectors.csv) lists every vector: its verdict, what it tests,
  and the requirements that it exercises.
- [conformance-mutants.csv](conformance-mutants.csv) lists every mutant: how many vectors kill it,
  and which of them exercise the fewest requirements.
- `evogs conformance explain ID` shows a vector byte by byte.
- [LIMITATIONS.md](../conformance/LIMITATIONS.md) gives a reason for each requirement without a
  vector.

"Accepted" and "refused" count the vectors that exercise a requirement by the verdict of a right
decoder. "Killed" counts the mutants that they kill, "only here" those that no other vector kills.
The vectors named are those that exercise the fewest other requirements.
"""

Entries = Sequence[Mapping[str, Any]]
Requirements = Mapping[str, tuple[str, str]]


def pages(entries: Entries, requirements: Requirements) -> dict[str, str]:
    """The text of each page by its name.

    Args:
        entries: the vectors of the manifest.
        requirements: role and text of each requirement, in the order of the spec.
    """
    killers = _killers(entries)
    return {
        "conformance-matrix.md": _matrix(entries, requirements, killers),
        "conformance-vectors.csv": _vectors(entries),
        "conformance-mutants.csv": _mutants(killers),
    }


def _killers(entries: Entries) -> dict[str, list[Mapping[str, Any]]]:
    """The vectors that kill each mutant, by the mutant's name."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for vector in entries:
        for mutant in vector["kills"]:
            found.setdefault(mutant, []).append(vector)
    return dict(sorted(found.items()))


def _matrix(
    entries: Entries,
    requirements: Requirements,
    killers: Mapping[str, Sequence[Mapping[str, Any]]],
) -> str:
    lines = [HEAD.format(n_vectors=len(entries), n_mutants=len(killers))]
    clause = ""
    for name, (role, _) in requirements.items():
        top = name.removeprefix("R-").replace("-", ".").partition(".")[0]
        if top != clause:
            clause = top
            lines.append(
                f"\n## Clause {clause}\n\n"
                "| Requirement | Binds | Accepted | Refused | Killed | Only here | Vectors |\n"
                "|---|---|---|---|---|---|---|"
            )
        vectors = [v for v in entries if name in v["requirements"]]
        accepted = sum(_is_accepted(v) for v in vectors)
        killed = {mutant for v in vectors for mutant in v["kills"]}
        ids = {v["id"] for v in vectors}
        only = sum(all(v["id"] in ids for v in killers[mutant]) for mutant in killed)
        named = ", ".join(f"`{v['id']}`" for v in _most_precise(vectors)) or "none"
        lines.append(
            f"| {name} | {role} | {accepted} | {len(vectors) - accepted} | {len(killed)} | {only} |"
            f" {named} |"
        )
    return "\n".join(lines).replace("\n\n\n", "\n\n") + "\n"


def _vectors(entries: Entries) -> str:
    header = ("vector", "verdict", "tests", "requirements", "mutants_killed")
    return _table(
        header,
        (
            (
                v["id"],
                "accepted" if _is_accepted(v) else v["runs"][0]["code"],
                v["tests"],
                " ".join(v["requirements"]),
                len(v["kills"]),
            )
            for v in entries
        ),
    )


def _mutants(killers: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    header = ("mutant", "vectors_that_kill_it", "most_precise")
    return _table(
        header,
        (
            (name, len(vectors), " ".join(v["id"] for v in _most_precise(vectors)))
            for name, vectors in killers.items()
        ),
    )


def _is_accepted(vector: Mapping[str, Any]) -> bool:
    return bool(vector["runs"][0]["exit"] == 0)


def _most_precise(vectors: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those that exercise the fewest requirements, at most `SHOWN`."""
    return sorted(vectors, key=lambda v: (len(v["requirements"]), v["id"]))[:SHOWN]


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
