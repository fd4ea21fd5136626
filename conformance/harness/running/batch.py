"""Asking a decoder that answers many runs in one process: a line in, a line out."""

from __future__ import annotations

import os
import random
import select
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from typing import IO

from conformance.harness.running.answers import Answer, AnswerError, Parcel, read_entry
from conformance.harness.running.oneshot import died, last_words, over
from conformance.harness.running.plain import plain
from conformance.harness.running.process import MAX_SAID, Bounds, Watched, read_tail
from conformance.harness.running.scratch import read_regular, scratch

__all__ = ["Batch"]

LATE_SECONDS = 3.0  # seconds in which an answer that was kept back comes when the input ends
REST = 1.0  # seconds in which a process whose input or output has ended should end too


class Batch:
    """A decoder that stays; started anew after every failure, so that none taints the next run."""

    def __init__(self, command: Sequence[str], bounds: Bounds, seed: int = 0) -> None:
        self.command = [*command, "--batch"]
        self.bounds = bounds
        self.n_starts = 0
        self._numbers = random.Random(seed)
        self._process: _Process | None = None

    def ask(self, parcel: Parcel, environment: Mapping[str, str]) -> Answer:
        """The answer to a run.

        Raises:
            OSError: the command cannot be started.
        """
        if self._process is None:
            self._process = _Process(self.command, environment, self.bounds)
            self.n_starts += 1
        process, started = self._process, time.monotonic()
        number = self._numbers.randrange(1 << 31)
        trouble, line = process.exchange(parcel, number, started)
        seconds = time.monotonic() - started
        if trouble:
            return self._fail(trouble, seconds, number=number)
        try:
            status, code, offset = read_entry(line, number)
        except AnswerError as error:
            return self._fail("protocol", seconds, f'answer "{plain(line, 80)}": {error}')
        if process.has_more():
            return self._fail("protocol", seconds, "more than one line for one request")
        output = read_regular(parcel.target, self.bounds.written)
        peak = process.watched.peak
        return Answer(status, output, code, offset, seconds=seconds, peak=peak)

    def close(self) -> None:
        """End the process; it is told by the end of its input and has a second to obey."""
        if self._process is not None:
            self._process.stdin.close()
            self._process.watched.wait_for(REST)
            self._end()

    def _fail(
        self, trouble: str, seconds: float, detail: str = "", number: int | None = None
    ) -> Answer:
        """End the process, whose state cannot be trusted any more."""
        process = self._process
        assert process is not None
        if trouble == "crash":
            process.watched.wait_for(REST)
            ended = process.watched.end()
            if ended.over != "killed":
                trouble, detail = died(ended, self.bounds)
            words = last_words(read_tail(process.stderr))
            detail = f"{detail}{words}" if detail else f"its output ended without an answer{words}"
            trouble = trouble or "crash"
        elif trouble == "timeout" and number is not None:
            detail = f"no answer within {self.bounds.seconds:g} s{process.why_late(number)}"
        elif trouble == "noise":
            detail = f"over {MAX_SAID} bytes without a line end on standard output"
        elif not detail:
            trouble, detail = over(trouble, self.bounds)
        peak = process.watched.peak
        self._end()
        return Answer(None, trouble=trouble, detail=detail, seconds=seconds, peak=peak)

    def _end(self) -> None:
        assert self._process is not None
        self._process.close()
        self._process = None


class _Process:
    """A process of the batch mode, in a folder of its own."""

    def __init__(
        self, command: Sequence[str], environment: Mapping[str, str], bounds: Bounds
    ) -> None:
        self.bounds = bounds
        self._said = b""
        with ExitStack() as stack:
            home = stack.enter_context(scratch(prefix="batch-"))
            self.stderr = stack.enter_context(tempfile.TemporaryFile(buffering=0))
            theirs, self.stdin = _pipe(stack, "wb", end=1)
            ours, self.stdout = _pipe(stack, "rb", end=0)
            try:
                self.watched = Watched(
                    command,
                    home,
                    {**environment, "HOME": str(home), "TMPDIR": str(home)},
                    bounds,
                    files=(theirs, ours, self.stderr.fileno()),
                    written=[home],
                )
            finally:
                os.close(theirs)
                os.close(ours)
            self._stack = stack.pop_all()

    def exchange(self, parcel: Parcel, number: int, started: float) -> tuple[str, bytes]:
        """Send a line and wait for one: (trouble, line)."""
        try:
            self.stdin.write(parcel.request(number))
        except OSError:  # it has ended
            return "crash", b""
        looked = started
        while b"\n" not in self._said:
            if select.select([self.stdout], [], [], self.watched.nap)[0]:
                if not self._hear():
                    return "crash", b""
                if len(self._said) > MAX_SAID:
                    return "noise", b""
            if time.monotonic() - looked > self.watched.nap:
                why = self.watched.over(started, parcel.folders)
                if why:
                    return why, b""
                looked = time.monotonic()
        self.watched.look()
        line, _, self._said = self._said.partition(b"\n")
        return "keeper" if self.watched.is_lost() else "", line

    def has_more(self) -> bool:
        """Whether it said something that nobody asked for."""
        return bool(self._said or select.select([self.stdout], [], [], 0)[0])

    def why_late(self, number: int) -> str:
        """What may explain that this request was not answered; "" if nothing does.

        Its input is closed, and it is heard for another moment.
        """
        if _answers(self._said, number):
            return ": the answer is there, but its line does not end"
        with suppress(OSError):
            self.stdin.close()
        deadline = time.monotonic() + LATE_SECONDS
        while (left := deadline - time.monotonic()) > 0 and len(self._said) <= MAX_SAID:
            if not select.select([self.stdout], [], [], left)[0] or not self._hear():
                break
        if _answers(self._said.partition(b"\n")[0], number):
            return (
                "; it came when the input had ended: flush standard output after each line, and"
                " read line by line"
            )
        return ""

    def close(self) -> None:
        """End it, and all that it started; remove what it wrote."""
        self.watched.end()
        with suppress(OSError):  # what was not yet sent cannot be
            self._stack.close()

    def _hear(self) -> bool:
        """Take in what it says; whether it can say more."""
        piece = os.read(self.stdout.fileno(), MAX_SAID)
        self._said += piece
        return bool(piece)


def _pipe(stack: ExitStack, mode: str, end: int) -> tuple[int, IO[bytes]]:
    """(the end of a pipe for the process, our end)."""
    numbers = os.pipe()
    return numbers[1 - end], stack.enter_context(os.fdopen(numbers[end], mode, buffering=0))


def _answers(line: bytes, number: int) -> bool:
    try:
        read_entry(line, number)
    except AnswerError:
        return False
    return True
