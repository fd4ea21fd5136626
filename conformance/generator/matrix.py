"""`docs/conformance-matrix.md`: requirement by vector by mutant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["matrix"]

SHOWN = 6  # vectors named for a requirement

HEAD = """# Conformance matrix

Made by `python -m conformance.generator`; do not edit. For each requirement: how many vectors
exercise it (accepted + refused), the most precise of them, and the mutants that they kill.
Requirements without a vector stand in
[`conformance/LIMITATIONS.md`](../conformance/LIMITATIONS.md).

| Requirement | Binds | Vectors | Among them | Mutants killed |
|---|---|---|---|---|
"""


def matrix(
    entries: Sequence[Mapping[str, Any]], requirements: Mapping[str, tuple[str, str]]
) -> str:
    """The page, of the vectors of the manifest and of role and text of each requirement."""
    lines = []
    for name, (role, _) in requirements.items():
        vectors = [v for v in entries if name in v["requirements"]]
        accepted = sum(v["runs"][0]["exit"] == 0 for v in vectors)
        # The most precise first: those that exercise few other requirements.
        named = sorted(vectors, key=lambda v: (len(v["requirements"]), v["id"]))[:SHOWN]
        killed = sorted({mutant for v in vectors for mutant in v["kills"]})
        count = f"{accepted} + {len(vectors) - accepted}" if vectors else "none"
        ids = ", ".join(f"`{v['id']}`" for v in named)
        ids += f", {len(vectors) - SHOWN} more" if len(vectors) > SHOWN else ""
        mutants = ", ".join(f"`{mutant}`" for mutant in killed)
        lines.append(f"| {name} | {role} | {count} | {ids} | {mutants} |")
    return HEAD + "\n".join(lines) + "\n"
