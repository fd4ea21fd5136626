"""The verdict on a run: what was expected against what came. No exit status is believed alone."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from conformance.harness.judging.dumps import difference
from conformance.harness.manifest import Case
from conformance.harness.running.answers import Answer

__all__ = ["EXPECTED", "KINDS", "Result", "judge"]

# Every kind of outcome, and what it means for the reader of a report.
KINDS = {
    "pass": "as expected",
    "skipped": "needs a feature that the decoder declares not to have, and says so with 127",
    "not asked": "needs an option of the contract that the decoder does not declare to know",
    "wrong verdict": "accepted, rejected, not complete, over limits, unsupported: not as expected",
    "wrong dump": "the right verdict, but not the right integers",
    "wrong code": "rejected, but for another reason or at another place",
    "stray output": "OUT holds something where there must be nothing",
    "noise": "standard output holds something else than the contract allows",
    "protocol": "not an answer of the batch protocol",
    "crash": "ended in another way than the contract allows",
    "timeout": "no end within the time limit",
    "memory": "over the memory limit",
    "output": "wrote too much, or touched files that are not its own",
    "nondeterministic": "another answer when asked again",
}
# Of each kind without an answer to judge: what the contract asks for.
EXPECTED = {
    "noise": "nothing on standard output, but for one line on exit 1, 3, 4, 127:"
    ' {"code": "E_CRC", "offset": 371}',
    "protocol": 'a line for each request, and no other: {"id": 812, "exit": 0}',
    "crash": "exit 0, 1, 3, 4 or 127; in batch mode a line for each request",
    "timeout": "an answer within the time limit; in batch mode a line that is flushed",
    "memory": "less memory than the limit",
    "output": "fewer bytes in files than the limit, and no file touched that is not its own",
}
UNJUDGED = ("skipped", "not asked")
VERDICTS = {
    0: "accepted",
    1: "rejected",
    3: "not complete",
    4: "over the limits",
    127: "not supported",
}


@dataclass(frozen=True)
class Result:
    """A run, its answer, and the verdict: `kind` is one of `KINDS`, `says` one line."""

    case: Case
    answer: Answer
    kind: str
    says: str

    @property
    def failed(self) -> bool:
        """Whether the decoder is not right here."""
        return self.kind not in ("pass", *UNJUDGED)

    @property
    def judged(self) -> bool:
        """Whether the decoder was asked and gave an answer to judge."""
        return self.kind not in UNJUDGED


def judge(
    case: Case,
    answer: Answer,
    lacking: list[str],
    golden: Callable[[str], bytes],
    *,
    codes: bool,
) -> Result:
    """Judge an answer.

    Args:
        case: the run.
        answer: what came.
        lacking: what the run needs and the decoder declares not to have.
        golden: the dump with a hash.
        codes: the decoder declares that it reports fault codes.
    """
    run = case.run
    if answer.trouble:
        return Result(case, answer, answer.trouble, answer.detail)
    output = answer.output or b""
    if lacking and answer.exit == 127 and not output:
        return Result(case, answer, "skipped", f"does not have: {', '.join(lacking)}")
    if answer.exit != run.exit:
        wanted = VERDICTS[run.exit] + (f" ({run.code})" if run.code else "")
        why = f" ({answer.code} at {answer.offset})" if answer.code else ""
        exits = f"exit {answer.exit}, not {run.exit}"
        says = f"{VERDICTS[answer.exit or 0]}{why}, should be {wanted}: {exits}"
        return Result(case, answer, "wrong verdict", says)
    if run.dump is None:
        if output:
            says = f"{VERDICTS[run.exit]}, but OUT has {len(output)} bytes"
            return Result(case, answer, "stray output", says)
    elif hashlib.sha256(output).hexdigest() != run.dump:
        at = "" if run.level is None else f"level {run.level}, "
        at += "the state beside the fault: " if run.exit == 1 else ""
        says = at + difference(output, golden(run.dump))
        return Result(case, answer, "wrong dump", says)
    if codes and run.code is not None and run.exit != 0:
        found = (answer.code, answer.offset if run.offset is not None else None)
        if found != (run.code, run.offset):
            says = f"{answer.code} at {answer.offset}, should be {run.code} at {run.offset}"
            return Result(case, answer, "wrong code", says)
    return Result(case, answer, "pass", "")
