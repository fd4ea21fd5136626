"""A trial: everything that is asked of a decoder, and what may be said about it afterwards."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

from conformance.harness.alone import ask_alone
from conformance.harness.judging.canary import canaries
from conformance.harness.judging.diagnosis import (
    Diagnosis,
    Fingerprint,
    accepts_any,
    changed_by_faults,
    diagnose,
    read_fingerprints,
)
from conformance.harness.judging.families import expand
from conformance.harness.judging.fresh import LackingError, make_fresh
from conformance.harness.judging.judging import Result
from conformance.harness.manifest import Case, Suite, SuiteError, load
from conformance.harness.runner import Options, ask_again, own_fault, run_cases
from conformance.harness.running.capabilities import Capabilities, CapabilityError, ask_capabilities
from conformance.harness.running.process import clean_environment
from conformance.harness.running.scratch import scratch

__all__ = [
    "FAILED",
    "INCOMPLETE",
    "PASSED",
    "Choice",
    "Trial",
    "draw_seed",
    "families",
    "harness_sha256",
    "hold",
]

PASSED, FAILED, INCOMPLETE = 0, 1, 3  # exit codes; 2 is a wrong command line
N_FRESH = 25
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Choice:
    """What is asked: a folder of vectors, parts of it, and how many fresh vectors.

    Attributes:
        vectors: the folder with manifest.json.
        families, ids: only these; everything if both are empty. `ids` are patterns.
        n_fresh: vectors made anew from the seed; None: some, if they can be made.
        is_quick: no families that the harness makes itself: no prefixes, no flipped bits.
    """

    vectors: Path
    families: Sequence[str] = ()
    ids: Sequence[str] = ()
    n_fresh: int | None = None
    is_quick: bool = False

    def takes(self, case: Case) -> bool:
        """Whether a case is asked."""
        vector = case.vector
        in_families = not self.families or vector.family in self.families
        return in_families and (
            not self.ids or any(fnmatchcase(vector.id, pattern) for pattern in self.ids)
        )

    @property
    def is_all(self) -> bool:
        """Whether the suite is asked as a whole."""
        return not (self.families or self.ids or self.is_quick)


@dataclass
class Trial:
    """What came of it.

    Attributes:
        options, choice: how and what was asked.
        suite_sha256: hash of the manifest; `version` and `spec` are what it says.
        capabilities: what the decoder declares; None: it does not say.
        results: one per case, those of canaries among them.
        again: runs that gave another answer when asked again.
        vector_runs: ids of the cases that are runs of committed vectors.
        n_cases: how many cases there were.
        n_again: how many were asked again.
        n_fresh: how many vectors were made anew.
        diagnosis: wrong decoders that this one looks like.
        notes: what a reader must know.
        failures: what is wrong with the decoder beside its answers.
        incomplete: why nothing may be concluded; empty if something may.
        seconds: of the whole trial.
    """

    options: Options
    choice: Choice
    suite_sha256: str = ""
    version: str = ""
    spec: str = ""
    capabilities: Capabilities | None = None
    results: list[Result] = field(default_factory=list)
    again: list[Result] = field(default_factory=list)
    vector_runs: set[str] = field(default_factory=set)
    n_cases: int = 0
    n_again: int = 0
    n_fresh: int = 0
    diagnosis: Diagnosis = field(default_factory=Diagnosis)
    notes: list[str] = field(default_factory=list)
    incomplete: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def failed(self) -> list[Result]:
        """All that is wrong with the decoder, run by run."""
        return [result for result in self.results if result.failed] + self.again

    @property
    def n_not_asked(self) -> int:
        """Runs that were not put to the decoder."""
        return sum(result.kind == "not asked" for result in self.results)

    @property
    def exit(self) -> int:
        """Exit code: a failure is sure, a pass needs a complete trial."""
        if self.failed or self.failures:
            return FAILED
        return INCOMPLETE if self.incomplete else PASSED


def hold(choice: Choice, options: Options, progress: Progress = lambda done, all_: None) -> Trial:
    """Ask a decoder all that was chosen.

    Nothing is passed in silence: a suite that cannot be read, a missing golden, nothing asked or
    all of it skipped leave the trial incomplete.
    """
    trial, started = Trial(options, choice), time.monotonic()
    try:
        with scratch(prefix="fresh-") as folder:
            _hold(trial, folder, progress)
    except SuiteError as error:
        trial.incomplete.append(str(error))
    except CapabilityError as error:
        trial.failures.append(str(error))
    except Exception as error:  # so that there is a report
        trial.incomplete.append(own_fault(error))
    trial.seconds = time.monotonic() - started
    return trial


def _hold(trial: Trial, folder: Path, progress: Progress) -> None:
    options, choice = trial.options, trial.choice
    suite = load(choice.vectors)
    trial.suite_sha256, trial.version, trial.spec = suite.sha256, suite.version, suite.spec
    cases = [case for case in suite.cases() if choice.takes(case)]
    trial.vector_runs = {case.id for case in cases}
    if not choice.is_quick:
        cases += [case for case in expand(suite) if choice.takes(case)]
    if not cases:
        raise SuiteError("nothing was asked: no vector is in this selection")
    cases += canaries(suite, options.seed)
    fresh = _fresh(trial, folder)
    trial.n_fresh = 0 if fresh is None else len(fresh.vectors)
    goldens = {}
    if fresh is not None:
        cases += fresh.cases()
        goldens = {run.dump: fresh for case in fresh.cases() if (run := case.run).dump}
    trial.n_cases = len(cases)
    with scratch() as home:
        environment = clean_environment(home, options.passed)
        trial.capabilities = ask_capabilities(options.command, environment, options.bounds)
    if options.batch and not trial.capabilities.batch:
        trial.notes.append("the decoder has no batch mode: one process per run")
        trial.options = options = replace(options, batch=False)

    def golden(sha256: str) -> bytes:
        return goldens.get(sha256, suite).golden(sha256)

    asked = run_cases(cases, trial.capabilities, golden, options, progress)
    trial.results = asked.results
    if asked.ended:
        n_left = trial.n_cases - len(trial.results)
        trial.incomplete.append(f"{n_left} runs left: {asked.ended}")
    _conclude(trial, read_fingerprints(choice.vectors), golden)


def _fresh(trial: Trial, folder: Path) -> Suite | None:
    """Vectors that nobody has seen, if they can be made here; they must, if they were asked for."""
    n, seed = trial.choice.n_fresh, trial.options.seed
    if n == 0 or (n is None and not trial.choice.is_all):
        return None
    try:
        return make_fresh(seed, N_FRESH if n is None else n, folder)
    except LackingError as error:
        if n is not None:
            raise SuiteError(str(error)) from None
        trial.notes.append(f"{error}: answers learned by heart are found by the canaries alone")
        return None


def _conclude(
    trial: Trial, fingerprints: Mapping[str, Fingerprint], golden: Callable[[str], bytes]
) -> None:
    options = trial.options
    assert trial.capabilities is not None
    trial.n_again, trial.again = ask_again(trial.results, options)
    covered = [result for result in trial.results if result.case.id in trial.vector_runs]
    hint, explains = ask_alone(trial.results, trial.capabilities, golden, options)
    if explains or all(result.answer.trouble for result in covered):
        # The answers do not say how the decoder decodes.
        trial.diagnosis = Diagnosis(hint=hint)
    else:
        found = diagnose(covered, fingerprints, codes=trial.capabilities.codes)
        trial.diagnosis = replace(
            found,
            accepts=accepts_any(covered),
            hint=hint,
            n_changed=changed_by_faults(covered),
        )
    asked = [result for result in trial.results if result.case.vector.family != "canary"]
    if asked and not any(result.judged for result in asked):
        trial.incomplete.append("all runs were skipped: the decoder declares that it does nothing")
    if trial.n_not_asked:
        trial.notes.append(
            f"not asked: {trial.n_not_asked} with --dump-on-fault, which the decoder does not"
            " declare; whether a packet with a fault changes its state is not known"
        )
    if not trial.n_again:
        trial.incomplete.append("no run was asked again: determinism is not known")
    if not trial.choice.is_all:
        trial.notes.append("only a part of the suite was asked: no claim may be made of it")


def draw_seed() -> int:
    """A seed that nobody can have known."""
    return secrets.randbelow(1 << 31)


def families(folder: Path) -> set[str]:
    """Of the vectors in a folder, and of those that the harness makes of them.

    Raises:
        SuiteError: the suite cannot be read.
    """
    suite = load(folder)
    return {vector.family for vector in suite.vectors} | {
        str(entry.get("rule")) for entry in suite.families
    }


def harness_sha256() -> str:
    """Hash of the harness itself, over names and contents of its modules."""
    digest = hashlib.sha256()
    folder = Path(__file__).parent
    for path in sorted(folder.rglob("*.py")):
        name = path.relative_to(folder).as_posix()
        digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
