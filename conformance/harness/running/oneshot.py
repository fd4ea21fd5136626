"""Asking a decoder with one process per run."""

from __future__ import annotations

import signal
from collections.abc import Mapping, Sequence

from conformance.harness.running.answers import EXITS, Answer, AnswerError, Parcel, read_fault
from conformance.harness.running.plain import plain
from conformance.harness.running.process import MAX_SAID, Bounds, Ended, run
from conformance.harness.running.scratch import MAX_DEPTH, read_regular

__all__ = ["OneShot", "died", "last_words", "over"]

OVER = {
    "timeout": "over the time limit of {0.seconds:g} s",
    "memory": "over the memory limit of {0.memory} bytes",
    "output": "wrote over {0.written} bytes to files,"
    f" or over {{0.files}} files, or folders over {MAX_DEPTH} deep or that cannot be read",
    "keeper": "it ended the process of the harness that watches it",
    "left": "it left processes that cannot be ended",
}


class OneShot:
    """A decoder that is started for each run."""

    def __init__(self, command: Sequence[str], bounds: Bounds) -> None:
        self.command = list(command)
        self.bounds = bounds

    def ask(self, parcel: Parcel, environment: Mapping[str, str]) -> Answer:
        """The answer to a run."""
        ended = run(
            [*self.command, *parcel.arguments()],
            parcel.home,
            {**environment, "HOME": str(parcel.home), "TMPDIR": str(parcel.home)},
            self.bounds,
            written=parcel.folders,
        )
        trouble, detail = died(ended, self.bounds)
        answer = Answer(None, None, None, None, trouble, detail, ended.seconds, ended.peak)
        if trouble:
            return answer
        output = read_regular(parcel.target, self.bounds.written)
        code, offset, noise = _fault(ended.status, ended.stdout)
        return Answer(
            ended.status,
            output,
            code,
            offset,
            "noise" if noise else "",
            noise,
            ended.seconds,
            ended.peak,
        )

    def close(self) -> None:
        """Nothing is kept running."""


def died(ended: Ended, bounds: Bounds) -> tuple[str, str]:
    """(trouble, in words) of a process that did not answer; ("", "") if it did."""
    if ended.over:
        return over(ended.over, bounds)
    if ended.peak > bounds.memory:
        return over("memory", bounds)
    if ended.status in EXITS:
        return "", ""
    if ended.status < 0:
        try:
            how = f"killed by {signal.Signals(-ended.status).name}"
        except ValueError:
            how = f"killed by signal {-ended.status}"
    else:
        how = f"exit status {ended.status}, which means nothing"
    return "crash", f"{how}{last_words(ended.stderr)}"


def over(why: str, bounds: Bounds) -> tuple[str, str]:
    """(trouble, in words) of a process that was killed for a reason (`Ended.over`)."""
    return "crash" if why in ("keeper", "left") else why, OVER[why].format(bounds)


def last_words(stderr: bytes) -> str:
    """The last line on standard error, to go behind a message."""
    lines = [line.strip() for line in stderr.split(b"\n") if line.strip()]
    return f": {plain(lines[-1])}" if lines else ""


def _fault(status: int, said: bytes) -> tuple[str | None, int | None, str]:
    """(code, offset, what is wrong with standard output)."""
    if not said:
        return None, None, ""
    if status == 0:
        return None, None, f'accepted, but standard output has "{plain(said, 40)}"'
    if len(said) > MAX_SAID:
        return None, None, f'standard output has over {MAX_SAID} bytes: "{plain(said, 40)}"'
    try:
        return *read_fault(said), ""
    except AnswerError as error:
        return None, None, f'standard output has "{plain(said, 40)}": {error}'
