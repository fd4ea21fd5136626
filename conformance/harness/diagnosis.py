"""What a failing decoder looks like: its outcomes against those of known wrong decoders.

`fingerprints.json` tells, for each mutant of the library, the runs in which it does not what is
expected, and what instead: another verdict or dump, or only another fault code or place. A mutant
is ranked by the share of runs in which decoder and mutant agree, among those where either is wrong.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from conformance.harness.judging import Result
from conformance.harness.manifest import SuiteError

__all__ = ["Fingerprint", "Likeness", "likenesses", "read_fingerprints"]

LEAST_SHARE = 0.5  # below it, to name a mutant would mislead


@dataclass(frozen=True)
class Fingerprint:
    """A mutant: what is wrong with it, and what came instead of what was expected.

    Attributes:
        says: its one line of meaning.
        outcomes: {run: "0:" and the first 12 digits of the dump's hash, "1:-", "crash"}.
        codes: {run: "E_CRC@371"} where only the fault is another.
    """

    says: str
    outcomes: Mapping[str, str]
    codes: Mapping[str, str]


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


def read_fingerprints(folder: Path) -> dict[str, Fingerprint]:
    """{mutant: fingerprint}; empty if the suite has none.

    Raises:
        SuiteError: the file is of another form.
    """
    path = folder / "fingerprints.json"
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_bytes())
        return {
            name: Fingerprint(entry["says"], entry["outcomes"], entry["codes"])
            for name, entry in found.items()
        }
    except (ValueError, AttributeError, TypeError, KeyError) as error:
        raise SuiteError(f"fingerprints.json: {error!r}") from None


def likenesses(
    results: Sequence[Result],
    fingerprints: Mapping[str, Fingerprint],
    *,
    codes: bool,
    most: int = 3,
) -> list[Likeness]:
    """The mutants most like the decoder, best first; none if it is right or like no mutant.

    Args:
        results: of the runs that fingerprints cover.
        fingerprints: of the mutants.
        codes: the decoder reports fault codes, so these tell mutants apart too.
        most: how many are named.
    """
    runs = {result.case.id: result for result in results if result.kind != "skipped"}
    symptoms = {case: _symptom(result) for case, result in runs.items() if result.failed}
    found = []
    for name, fingerprint in fingerprints.items():
        mutant = {**fingerprint.outcomes, **(fingerprint.codes if codes else {})}
        expected = {case: symptom for case, symptom in mutant.items() if case in runs}
        either = set(symptoms) | set(expected)
        same = [case for case in symptoms if symptoms[case] == expected.get(case)]
        if same and len(same) >= LEAST_SHARE * len(either):
            first = runs[min(same, key=lambda case: _clearness(runs[case]))]
            says = f"{first.case.id}, {first.says}"
            share = len(same) / len(either)
            found.append(Likeness(name, fingerprint.says, share, len(same), len(either), says))
    return sorted(found, key=lambda likeness: (-likeness.share, likeness.name))[:most]


def _symptom(result: Result) -> str:
    """What came instead of what was expected, in the form of fingerprints."""
    answer = result.answer
    if answer.trouble:
        return "crash"
    if result.kind == "wrong code":
        return "-" if answer.code is None else f"{answer.code}@{answer.offset}"
    digest = hashlib.sha256(answer.output).hexdigest()[:12] if answer.output else "-"
    return f"{answer.exit}:{digest}"


def _clearness(result: Result) -> tuple[bool, int, str]:
    """Wrong integers of the lowest level say the most."""
    level = result.case.run.level
    return result.kind != "wrong dump", 99 if level is None else level, result.case.id
