"""The report for a terminal: families, requirements, the first failures, the conclusion."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable

from conformance.harness.judging.judging import KINDS, Result
from conformance.harness.running.plain import plain_lines, say
from conformance.harness.trial import FAILED, INCOMPLETE, PASSED, Trial

__all__ = ["print_report", "report", "requirements"]

MAX_FAILURES = 20
COLUMNS = ("pass", "skipped", "not asked", "wrong verdict", "wrong dump", "wrong code")


def print_report(trial: Trial) -> None:
    """Print the report."""
    say(report(trial))


def report(trial: Trial) -> str:
    """The report as plain text."""
    lines = list(_families(trial.results))
    lines += _failures(trial)
    lines += _requirements(trial.results)
    lines += [f"note: {note}" for note in trial.notes]
    lines += [trial_line(trial), *_conclusion(trial)]
    return plain_lines("\n".join(lines))


def requirements(results: Iterable[Result]) -> dict[str, str]:
    """pass, fail or untested (all skipped) for each requirement that a run concerns."""
    kinds: dict[str, set[str]] = {}
    for result in results:
        kind = "fail" if result.failed else result.kind
        for requirement in result.case.vector.requirements:
            kinds.setdefault(requirement, set()).add(kind)
    return {
        requirement: "fail" if "fail" in seen else "pass" if "pass" in seen else "untested"
        for requirement, seen in sorted(kinds.items(), key=lambda item: _by_number(item[0]))
    }


def trial_line(trial: Trial) -> str:
    """What was asked, in one line."""
    capabilities = trial.capabilities
    name = f"{capabilities.name} {capabilities.version}" if capabilities else "the decoder"
    peak = max((result.answer.peak for result in trial.results), default=0)
    n_asked = len(trial.results) - trial.n_not_asked
    return (
        f"{name}: {n_asked} of {trial.n_cases} runs in {trial.seconds:.1f} s,"
        f" seed {trial.options.seed}, peak memory {peak >> 20} MiB,"
        f" {trial.n_again} asked again"
    )


def _families(results: list[Result]) -> Iterable[str]:
    if not results:
        return
    by_family: dict[str, Counter[str]] = {}
    for result in results:
        by_family.setdefault(result.case.vector.family, Counter())[result.kind] += 1
    width = max(map(len, by_family))
    yield (
        f"{'family':{width}}  {'runs':>6}"
        + "".join(f"  {name:>13}" for name in COLUMNS)
        + "  other"
    )
    for family, counts in sorted(by_family.items()):
        others = [f"{n} {kind}" for kind, n in sorted(counts.items()) if kind not in COLUMNS]
        cells = "".join(f"  {counts[name] or '.':>13}" for name in COLUMNS)
        yield f"{family:{width}}  {counts.total():>6}{cells}  {', '.join(others)}".rstrip()
    yield ""


def _failures(trial: Trial) -> Iterable[str]:
    for result in trial.failed[:MAX_FAILURES]:
        vector, run = result.case.vector, result.case.run
        yield f"{result.kind.upper()} {result.case.id} ({run.options()})"
        yield f"    {result.says}"
        yield f"    tests: {vector.tests}"
        yield f"    requirements: {', '.join(vector.requirements)}"
        if vector.near_miss_of and result.kind == "wrong verdict":
            yield f"    legal but for the fault: {vector.near_miss_of}"
    left = len(trial.failed) - MAX_FAILURES
    if left > 0:
        yield f"... and {left} more wrong runs (--html or --json shows all)"
    if trial.failed:
        yield f"a vector byte by byte: evogs conformance explain {trial.failed[0].case.vector.id}"
        yield ""


def _requirements(results: list[Result]) -> Iterable[str]:
    states = requirements(results)
    counts = Counter(states.values())
    broken = [requirement for requirement, state in states.items() if state == "fail"]
    if states:
        kinds = ", ".join(f"{counts[kind]} {kind}" for kind in ("pass", "fail", "untested"))
        yield f"requirements: {kinds}"
    if broken:
        text = f"broken: {', '.join(broken)}"
        yield textwrap.fill(text, 100, initial_indent="    ", subsequent_indent="      ")


def _conclusion(trial: Trial) -> Iterable[str]:
    yield from trial.diagnosis.sentences()
    for text in trial.failures:
        yield f"FAIL: {text}"
    for text in trial.incomplete:
        yield f"INCOMPLETE: {text}"
    if trial.failed:
        kinds = Counter(result.kind for result in trial.failed)
        yield "FAIL: " + ", ".join(f"{n} {kind}" for kind, n in kinds.most_common())
    if trial.exit == PASSED:
        n_skipped = sum(result.kind == "skipped" for result in trial.results)
        yield (
            "PASS: the decoder is right in all runs"
            + ("" if trial.choice.is_all else " of this selection")
            + (f" but {n_skipped} that need what it does not have" if n_skipped else "")
            + (f"; not asked: {trial.n_not_asked}" if trial.n_not_asked else "")
        )
    assert trial.exit in (PASSED, FAILED, INCOMPLETE)
    assert set(KINDS) >= {result.kind for result in trial.failed}


def _by_number(requirement: str) -> list[tuple[int, str]]:
    """Sort R-5.10-1 after R-5.9-1."""
    parts = requirement.replace("R-", "").replace("-", ".").split(".")
    return [(int(part), "") if part.isdigit() else (0, part) for part in parts]
