"""What a failing decoder looks like: its outcomes against those of known wrong decoders.

`fingerprints.json` tells, for each mutant of the library, the runs in which it differs from the
golden outcome, and how. A mutant is ranked by the share of runs in which decoder and mutant agree,
among those where either differs from the golden outcome.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conformance.harness.judging import Result
from conformance.harness.manifest import SuiteError

__all__ = ["Likeness", "likenesses", "read_fingerprints"]

LEAST_SHARE = 0.5  # below it, to name a mutant would mislead


@dataclass(frozen=True)
class Likeness:
    """A mutant that a decoder looks like.

    Attributes:
        name, says: the mutant, and what is wrong with it.
        share: of the runs where either is not right, those with the same outcome, 0..1.
        n_same, n_runs: the two counts behind it.
        first: the first of the shared wrong runs, and what was wrong.
    """

    name: str
    says: str
    share: float
    n_same: int
    n_runs: int
    first: str

    def sentence(self) -> str:
        """For people."""
        how = "all" if self.share == 1 else f"{self.n_same} of {self.n_runs}"
        return (
            f"this looks like {self.name}: {self.says} (explains {how} wrong runs);"
            f" first seen: {self.first}"
        )


def read_fingerprints(folder: Path) -> dict[str, Any]:
    """{mutant: {"says", "outcomes"}}; empty if the suite has none.

    Raises:
        SuiteError: the file is of another form.
    """
    path = folder / "fingerprints.json"
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_bytes())
        if all({"says", "outcomes"} <= set(entry) for entry in found.values()):
            return dict(found)
    except (ValueError, AttributeError, TypeError) as error:
        raise SuiteError(f"fingerprints.json: {error}") from None
    raise SuiteError("fingerprints.json: an entry lacks says or outcomes")


def likenesses(
    results: Sequence[Result], fingerprints: Mapping[str, Any], *, most: int = 3
) -> list[Likeness]:
    """The mutants most like the decoder, best first; none if it is right or like no mutant."""
    runs = {result.case.id: result for result in results if result.kind != "skipped"}
    wrong = {case for case, result in runs.items() if result.failed}
    found = []
    for name, entry in fingerprints.items():
        outcomes = {case: text for case, text in entry["outcomes"].items() if case in runs}
        either = wrong | set(outcomes)
        same = [case for case in outcomes if runs[case].outcome() == outcomes[case]]
        if same and len(same) >= LEAST_SHARE * len(either):
            first = min(same, key=lambda case: _clearness(runs[case]))
            result = runs[first]
            says = f"{first}, {result.says}"
            share = len(same) / len(either)
            found.append(Likeness(name, entry["says"], share, len(same), len(either), says))
    return sorted(found, key=lambda likeness: (-likeness.share, likeness.name))[:most]


def _clearness(result: Result) -> tuple[bool, int, str]:
    """Wrong integers of the lowest level say the most."""
    level = result.case.run.level
    return result.kind != "wrong dump", 99 if level is None else level, result.case.id
