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

from conformance.harness.judging.grouping import ungrouped
from conformance.harness.judging.judging import Result
from conformance.harness.manifest import SuiteError

__all__ = [
    "Diagnosis",
    "Fingerprint",
    "Likeness",
    "accepts_any",
    "changed_by_faults",
    "diagnose",
    "read_fingerprints",
]

MIN_SHARE = 0.5  # below it, to name a mutant would mislead
MIN_OWN = 0.75  # of the wrong runs of one among several: some are hidden by another's
MAX_NAMED, MAX_TOGETHER = 3, 5


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
        return f"{self.name}: {self.says}; first seen: {self.first}"


@dataclass(frozen=True)
class Diagnosis:
    """What a decoder looks like.

    Attributes:
        alike: single mutants, best first.
        together: mutants that explain more between them, if none explains all alone.
        n_explained, n_wrong: wrong runs that these explain, of all.
        accepts: whether any legal stream was accepted.
        hint: what was seen when wrong runs were asked alone; "" if nothing.
        n_changed: wrong dumps beside a fault, if all other dumps are right.
    """

    alike: tuple[Likeness, ...] = ()
    together: tuple[Likeness, ...] = ()
    n_explained: int = 0
    n_wrong: int = 0
    accepts: bool = True
    hint: str = ""
    n_changed: int = 0

    def sentences(self) -> list[str]:
        """For people."""
        said = [self.hint] if self.hint else []
        best = [one for one in self.alike if one.share == self.alike[0].share]
        if not self.accepts and not self.hint:
            names = ", ".join(one.name for one in best)
            like = f", as of {names}, looks alike" if names else " looks alike"
            return [f"no legal stream was accepted: any check that always fails{like}"]
        if self.n_changed:
            said.append(
                f"a packet with a fault changed the state, or ended it: {self.n_changed} dumps"
                " beside a fault are wrong, and all others right (spec 6.4, R-6.4-5)"
            )
        for one in best:
            how = "all" if one.share == 1 else f"{one.n_same} of {one.n_runs}"
            said.append(f"this looks like {one.sentence()} (explains {how} wrong runs)")
        if len(self.together) > 1:
            how = f"{self.n_explained} of {self.n_wrong}"
            said.append(f"or like several at once, which explain {how} wrong runs:")
            said += [f"    {one.sentence()}" for one in self.together]
        return said


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
            name: Fingerprint(
                entry["says"], ungrouped(entry["outcomes"]), ungrouped(entry["codes"])
            )
            for name, entry in found.items()
        }
    except (ValueError, AttributeError, TypeError, KeyError) as error:
        raise SuiteError(f"fingerprints.json: {error!r}") from None


def diagnose(
    results: Sequence[Result], fingerprints: Mapping[str, Fingerprint], *, codes: bool
) -> Diagnosis:
    """What a decoder looks like.

    Args:
        results: of the runs that fingerprints cover.
        fingerprints: of the mutants.
        codes: the decoder reports fault codes, so these tell mutants apart too.
    """
    runs = {result.case.id: result for result in results if result.judged}
    symptoms = {case: _symptom(result) for case, result in runs.items() if result.failed}
    compared = []
    for name, fingerprint in fingerprints.items():
        outcomes, faults = fingerprint.outcomes, fingerprint.codes if codes else {}
        # Sets of pairs, which are quick: most fingerprints have few of the runs.
        of_faults, of_outcomes = (
            symptoms.items() & faults.items(),
            symptoms.items() & outcomes.items(),
        )
        same = {case for case, _ in of_faults}
        same |= {case for case, _ in of_outcomes if case not in faults}
        if same:
            expected = (outcomes.keys() | faults.keys()) & runs.keys()
            compared.append(_Compared(name, fingerprint.says, same, expected))
    alike = [
        one.likeness(runs, one.expected | set(symptoms))
        for one in compared
        if len(one.same) >= MIN_SHARE * len(one.expected | set(symptoms))
    ]
    alike = sorted(alike, key=lambda likeness: (-likeness.share, likeness.name))[:MAX_NAMED]
    if alike and alike[0].share == 1:
        return Diagnosis(tuple(alike))
    together, explained = _together(compared)
    return Diagnosis(
        tuple(alike),
        tuple(one.likeness(runs, one.expected) for one in together),
        len(explained),
        len(symptoms),
    )


def accepts_any(results: Sequence[Result]) -> bool:
    """Whether some legal stream was accepted, or none was asked for."""
    legal = [one for one in results if one.case.run.exit in (0, 3) and one.judged]
    return not legal or any(one.answer.exit in (0, 3) for one in legal)


def changed_by_faults(results: Sequence[Result]) -> int:
    """How many dumps beside a fault are wrong; 0 if other dumps are wrong too."""
    wrong = [one for one in results if one.kind == "wrong dump"]
    return len(wrong) if all(one.case.run.exit == 1 for one in wrong) else 0


@dataclass(frozen=True)
class _Compared:
    """A mutant: wrong runs with the same outcome, and all runs that it fails."""

    name: str
    says: str
    same: set[str]
    expected: set[str]

    def likeness(self, runs: Mapping[str, Result], among: set[str]) -> Likeness:
        first = runs[min(self.same, key=lambda case: _clearness(runs[case]))]
        share = len(self.same) / len(among)
        says = f"{first.case.id}, {first.says}"
        return Likeness(self.name, self.says, share, len(self.same), len(among), says)


def _together(compared: Sequence[_Compared]) -> tuple[list[_Compared], set[str]]:
    """Mutants that explain many wrong runs between them, most first; and the runs explained.

    Only mutants most of whose own wrong runs came: the others are not at work here.
    """
    left = [one for one in compared if len(one.same) >= MIN_OWN * len(one.expected)]
    chosen, explained = list[_Compared](), set[str]()
    while left and len(chosen) < MAX_TOGETHER:
        best = max(left, key=lambda one: (len(one.same - explained), -len(one.expected), one.name))
        if not best.same - explained:
            break
        chosen.append(best)
        explained |= best.same
        left.remove(best)
    return chosen, explained


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
