"""Asking a decoder that answers many runs in one process: a line in, a line out."""

from __future__ import annotations

import os
import random
import select
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from conformance.harness.answers import (
    MAX_TEXT,
    Answer,
    AnswerError,
    Parcel,
    read_entry,
    read_output,
)
from conformance.harness.oneshot import died, last_words
from conformance.harness.process import Bounds, Watched, folder_size

__all__ = ["Batch"]

GLANCE = 0.02  # seconds between looks at memory while an answer is awaited
REST = 0.05  # seconds in which a process whose output has ended should end too


class Batch:
    """A decoder that stays; started anew after every failure, so that none taints the next run."""

    def __init__(self, command: Sequence[str], bounds: Bounds, seed: int = 0) -> None:
        self.command = [*command, "--batch"]
        self.bounds = bounds
        self.n_starts = 0
        self._numbers = random.Random(seed)
        self._watched: Watched | None = None
        self._home: tempfile.TemporaryDirectory[str] | None = None
        self._rest = b""

    def ask(self, parcel: Parcel, environment: Mapping[str, str]) -> Answer:
        """The answer to a run."""
        watched = self._watched or self._start(environment)
        started = time.monotonic()
        number = self._numbers.randrange(1 << 31)
        trouble, line = self._exchange(watched, parcel, number, started)
        seconds = time.monotonic() - started
        if trouble:
            return self._fail(trouble, seconds)
        try:
            status, code, offset = read_entry(line, number)
        except AnswerError as error:
            return self._fail("protocol", seconds, f"answer {line[:80]!r}: {error}")
        if self._rest or select.select([_pipe(watched.process.stdout)], [], [], 0)[0]:
            return self._fail("protocol", seconds, "more than one line for one request")
        output = read_output(parcel.target, self.bounds.written)
        return Answer(status, output, code, offset, seconds=seconds, peak=watched.peak)

    def close(self) -> None:
        """End the process; it is told by the end of its input and has a second to obey."""
        if self._watched is not None:
            process = self._watched.process
            _pipe(process.stdin).close()
            select.select([_pipe(process.stdout)], [], [], 1.0)
            self._end()

    def _start(self, environment: Mapping[str, str]) -> Watched:
        self._home = tempfile.TemporaryDirectory(prefix="batch-")
        home = Path(self._home.name)
        self._stderr = home / "stderr"
        environment = {**environment, "HOME": str(home), "TMPDIR": str(home)}
        with self._stderr.open("wb") as stderr:
            self._watched = Watched(
                self.command,
                home,
                environment,
                self.bounds,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                written=[home],
            )
        self._rest = b""
        self.n_starts += 1
        return self._watched

    def _exchange(
        self, watched: Watched, parcel: Parcel, number: int, started: float
    ) -> tuple[str, bytes]:
        """Send a line and wait for one: (trouble, line)."""
        try:
            _pipe(watched.process.stdin).write(parcel.request(number))
            _pipe(watched.process.stdin).flush()
        except OSError:  # it has ended
            return "crash", b""
        answers = _pipe(watched.process.stdout)
        looked = started
        while b"\n" not in self._rest:
            if select.select([answers], [], [], GLANCE)[0]:
                piece = os.read(answers.fileno(), MAX_TEXT)
                if not piece:
                    return "crash", b""
                self._rest += piece
                if len(self._rest) > MAX_TEXT:
                    return "noise", b""
            if time.monotonic() - looked > GLANCE:
                over = watched.over(started)
                if not over and sum(map(folder_size, parcel.folders)) > self.bounds.written:
                    over = "output"
                if over:
                    return over, b""
                looked = time.monotonic()
        watched.look()
        line, _, self._rest = self._rest.partition(b"\n")
        return "", line

    def _fail(self, trouble: str, seconds: float, detail: str = "") -> Answer:
        """End the process, whose state cannot be trusted any more."""
        watched = self._watched
        assert watched is not None
        if trouble == "crash":
            time.sleep(REST)
            ended = watched.end()
            _, detail = ("", "") if ended.over else died(ended, self.bounds, self._stderr)
            detail = detail or f"its output ended without an answer{last_words(self._stderr)}"
        elif not detail:
            detail = {
                "timeout": f"no answer within {self.bounds.seconds:g} s",
                "memory": f"over the memory limit of {self.bounds.memory} bytes",
                "output": f"wrote over {self.bounds.written} bytes to files",
                "noise": f"over {MAX_TEXT} bytes without a line end on standard output",
            }[trouble]
        answer = Answer(None, trouble=trouble, detail=detail, seconds=seconds, peak=watched.peak)
        self._end()
        return answer

    def _end(self) -> None:
        assert self._watched is not None
        assert self._home is not None
        process = self._watched.process
        if process.returncode is None:
            self._watched.end()
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):  # what was not yet sent cannot be
                _pipe(pipe).close()
        self._watched = None
        self._home.cleanup()


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe
