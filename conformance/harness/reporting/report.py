"""The report as JSON (`report.schema.json`): everything that was asked and what came of it."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
import time
from collections import Counter
from dataclasses import asdict
from typing import Any

from conformance.harness.judging.judging import Result
from conformance.harness.reporting.table import requirements
from conformance.harness.running.plain import plain_all
from conformance.harness.trial import PASSED, Trial, harness_sha256

__all__ = ["as_dict", "as_json"]

Entry = dict[str, Any]


def as_json(trial: Trial) -> str:
    """The report as text, a line for each run."""
    parts = []
    for key, value in as_dict(trial).items():
        text = json.dumps(value)
        if key in ("results", "again"):
            text = "[" + ",".join(f"\n  {json.dumps(entry)}" for entry in value) + "\n ]"
        parts.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def as_dict(trial: Trial) -> Entry:
    """The report; all text in it is plain."""
    results = plain_all([_result(result) for result in trial.results])
    again = [_result(result) for result in trial.again]
    report = {
        "header": _header(trial),
        "results": results,
        "again": again,
        "summary": _summary(trial),
        "requirements": requirements(trial.results),
        "diagnosis": {
            "alike": [asdict(likeness) for likeness in trial.diagnosis.alike],
            "together": [asdict(likeness) for likeness in trial.diagnosis.together],
            "n_explained": trial.diagnosis.n_explained,
            "n_wrong": trial.diagnosis.n_wrong,
            "hint": trial.diagnosis.hint,
        },
        "notes": trial.notes,
        "failures": trial.failures,
        "incomplete": trial.incomplete,
        "claim": claim(trial),
        "footer": {
            "exit": trial.exit,
            "complete": not trial.incomplete and trial.choice.is_all,
            "results_sha256": hashlib.sha256(json.dumps(results).encode()).hexdigest(),
        },
    }
    return {key: plain_all(value) for key, value in report.items()}


def claim(trial: Trial) -> str | None:
    """What may be said of the decoder; None: nothing."""
    capabilities = trial.capabilities
    if trial.exit != PASSED or not trial.choice.is_all or capabilities is None:
        return None
    modes = list(capabilities.modes)
    if trial.n_not_asked and "progressive" in modes:
        modes[modes.index("progressive")] += " but for its state beside a fault"
    return (
        f"{capabilities.name} {capabilities.version} decodes EvoGS {trial.spec}"
        f" ({', '.join(modes)}) to tier {capabilities.max_tier}"
        f" and SH degree {capabilities.max_sh_degree}: suite {trial.version}"
        f" {trial.suite_sha256[:12]}, {trial.n_fresh} fresh vectors of seed {trial.options.seed}"
    )


def _header(trial: Trial) -> Entry:
    options, capabilities = trial.options, trial.capabilities
    return {
        "suite": {"version": trial.version, "spec": trial.spec, "sha256": trial.suite_sha256},
        "harness_sha256": harness_sha256(),
        "date": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "host": {
            "system": platform.platform(),
            "machine": platform.machine(),
            "processors": os.cpu_count() or 1,
            "python": sys.version.split()[0],
        },
        "decoder": list(options.command),
        "capabilities": None if capabilities is None else capabilities.as_json(),
        "options": {
            "batch": options.batch,
            "jobs": options.jobs,
            "seed": options.seed,
            "seconds": options.bounds.seconds,
            "memory": options.bounds.memory,
            "families": list(trial.choice.families),
            "ids": list(trial.choice.ids),
            "quick": trial.choice.is_quick,
            "again": trial.n_again,
            "fresh": trial.n_fresh,
        },
    }


def _result(result: Result) -> Entry:
    case, answer = result.case, result.answer
    return {
        "id": case.id,
        "family": case.vector.family,
        "asked": case.run.options(),
        "kind": result.kind,
        "says": result.says,
        "expected": {key: getattr(case.run, key) for key in ("exit", "code", "offset", "dump")},
        "observed": {
            "exit": answer.exit,
            "code": answer.code,
            "offset": answer.offset,
            "dump": None if not answer.output else hashlib.sha256(answer.output).hexdigest(),
        },
        "seconds": round(answer.seconds, 4),
        "peak": answer.peak,
    }


def _summary(trial: Trial) -> Entry:
    families: dict[str, Counter[str]] = {}
    for result in trial.results:
        families.setdefault(result.case.vector.family, Counter())[result.kind] += 1
    return {
        "runs": len(trial.results),
        "cases": trial.n_cases,
        "seconds": round(trial.seconds, 3),
        "peak": max((result.answer.peak for result in trial.results), default=0),
        "kinds": dict(Counter(result.kind for result in trial.results + trial.again)),
        "families": {name: dict(counts) for name, counts in sorted(families.items())},
    }
