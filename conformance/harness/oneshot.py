"""Asking a decoder with one process per run."""

from __future__ import annotations

import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

from conformance.harness.answers import (
    EXITS,
    MAX_TEXT,
    Answer,
    AnswerError,
    Parcel,
    read_fault,
    read_output,
)
from conformance.harness.process import Bounds, Ended, run

__all__ = ["OneShot", "died", "last_words"]

OVER = {
    "timeout": "over the time limit of {0.seconds:g} s",
    "memory": "over the memory limit of {0.memory} bytes",
    "output": "wrote over {0.written} bytes to files",
}


class OneShot:
    """A decoder that is started for each run."""

    def __init__(self, command: Sequence[str], bounds: Bounds) -> None:
        self.command = list(command)
        self.bounds = bounds

    def ask(self, parcel: Parcel, environment: Mapping[str, str]) -> Answer:
        """The answer to a run."""
        stdout, stderr = (parcel.target.parent / name for name in ("stdout", "stderr"))
        ended = run(
            [*self.command, *parcel.arguments()],
            parcel.home,
            {**environment, "HOME": str(parcel.home), "TMPDIR": str(parcel.home)},
            self.bounds,
            stdout=stdout,
            stderr=stderr,
            written=parcel.folders,
        )
        trouble, detail = died(ended, self.bounds, stderr)
        answer = Answer(None, None, None, None, trouble, detail, ended.seconds, ended.peak)
        if trouble:
            return answer
        said = read_output(stdout, MAX_TEXT) or b""
        output = read_output(parcel.target, self.bounds.written)
        code, offset, noise = _fault(ended.status, said)
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


def died(ended: Ended, bounds: Bounds, stderr: Path) -> tuple[str, str]:
    """(trouble, in words) of a process that did not answer; ("", "") if it did."""
    if ended.over:
        return ended.over, OVER[ended.over].format(bounds)
    if ended.peak > bounds.memory:
        return "memory", OVER["memory"].format(bounds)
    if ended.status in EXITS:
        return "", ""
    if ended.status < 0:
        try:
            how = f"killed by {signal.Signals(-ended.status).name}"
        except ValueError:
            how = f"killed by signal {-ended.status}"
    else:
        how = f"exit status {ended.status}, which means nothing"
    return "crash", f"{how}{last_words(stderr)}"


def last_words(stderr: Path) -> str:
    """The last line on standard error, to go behind a message."""
    try:
        with stderr.open("rb") as file:
            file.seek(max(0, stderr.stat().st_size - 4096))
            lines = file.read().decode("utf-8", "replace").split("\n")
    except OSError:
        return ""
    lines = [line.strip() for line in lines if line.strip()]
    return f": {lines[-1][:200]}" if lines else ""


def _fault(status: int, said: bytes) -> tuple[str | None, int | None, str]:
    """(code, offset, what is wrong with standard output)."""
    if not said:
        return None, None, ""
    if status == 0:
        return None, None, f"accepted, but standard output has {said[:40]!r}"
    try:
        return *read_fault(said.decode("utf-8", "replace")), ""
    except AnswerError as error:
        return None, None, f"standard output has {said[:40]!r}: {error}"
