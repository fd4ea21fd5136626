"""The mutants, read from `library/*.diff`.

A mutant is a line `name (requirement or section): what it does wrong`, and the lines of the oracle
that it changes as in a diff, without line numbers: ` ` before context, `-` before lines that go,
`+` before lines that come; `@@` stands between places. Blank lines stand between mutants, and `#`
before comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from conformance.mutants.mutant import Mutant

__all__ = ["MUTANTS", "parse"]

LIBRARY = Path(__file__).parent / "library"
# In the order of the spec.
FILES = (
    *("header", "chunks", "tables", "packet_table", "packets"),
    *("planes", "siblings", "records", "arithmetic", "states", "palette"),
)
TITLE = re.compile(r"([a-z0-9-]+) \((.+?)\): (.+)")


def parse(text: str) -> Iterator[Mutant]:
    """The mutants of a file.

    Raises:
        ValueError: a mutant begins with another line than its title, or changes nothing.
    """
    for block in re.split(r"\n{2,}", text.strip("\n")):
        title, *lines = block.split("\n")
        if title.startswith("#"):
            continue
        found = TITLE.fullmatch(title)
        if found is None or not lines:
            raise ValueError(f"not a mutant: {title!r}")
        places = [place.split("\n") for place in "\n".join(lines).split("\n@@\n")]
        edits = tuple((_side(place, "-"), _side(place, "+")) for place in places)
        yield Mutant(found[1], found[2], found[3], edits)


def _side(place: list[str], sign: str) -> str:
    """The lines of a place before ("-") or after ("+") the change."""
    return "".join(f"{line[1:]}\n" for line in place if line[:1] in (sign, " "))


MUTANTS: tuple[Mutant, ...] = tuple(
    mutant
    for name in FILES
    for mutant in parse((LIBRARY / f"{name}.diff").read_text(encoding="utf-8"))
)
