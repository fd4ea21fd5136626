"""A process under watch: bounded in time, memory and output, killed with all that it started.

Limits are watched from outside (resident memory of the whole process tree, wall time, bytes written
to its folder), because limits set inside mean different things to different runtimes: address space
says nothing about the memory of a program on a virtual machine. Where the system has `prlimit`,
file size and processor time are limited as well, for what escapes the watch.
"""

from __future__ import annotations

import atexit
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

__all__ = ["Bounds", "Ended", "Watched", "clean_environment", "folder_size", "run"]

# Linux counts ru_maxrss in KiB, macOS in bytes.
RSS_UNIT = 1 if sys.platform == "darwin" else 1024
SLACK = 1 << 20
SHORTEST_NAP, LONGEST_NAP = 0.001, 0.02  # seconds


@dataclass(frozen=True)
class Bounds:
    """What a process may use: wall seconds, bytes of memory, bytes written to files."""

    seconds: float = 20.0
    memory: int = 1 << 30
    written: int = 64 << 20


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes:
        status: its exit status; negative: the number of the signal that ended it.
        over: what it used too much of and was killed for: "timeout", "memory", "output";
            "killed": without a reason; "": it ended by itself.
        seconds: wall time.
        peak: bytes of memory at most, as far as seen: of a short run that took less than the
            harness itself, what a look at it showed.
    """

    status: int
    over: str
    seconds: float
    peak: int


class Watched:
    """A running process in a session of its own."""

    def __init__(
        self,
        command: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        bounds: Bounds,
        *,
        stdin: int | IO[bytes] = subprocess.DEVNULL,
        stdout: int | IO[bytes] = subprocess.DEVNULL,
        stderr: int | IO[bytes] = subprocess.DEVNULL,
        written: Sequence[Path] = (),
    ) -> None:
        self.bounds = bounds
        self.peak = 0
        self._written = written
        # A process begins as a copy of this one, and the system counts that.
        self._ours = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        self.started = time.monotonic()
        try:
            with _interrupts_held():
                self.process = subprocess.Popen(
                    list(command),
                    cwd=folder,
                    env=dict(environment),
                    stdin=stdin,
                    stdout=stdout,
                    stderr=stderr,
                    start_new_session=True,
                )
                _running.add(self)
        except KeyboardInterrupt:
            if "process" in vars(self):
                self.end()
            raise
        if sys.platform == "linux":
            limit = resource.prlimit
            try:
                most = bounds.written + SLACK  # so that the watch sees who wrote too much
                limit(self.process.pid, resource.RLIMIT_FSIZE, (most, most))
                limit(self.process.pid, resource.RLIMIT_CORE, (0, 0))
            except OSError:  # it has ended already
                pass

    def look(self) -> int:
        """Bytes of memory that the process and all it started have used at most; kept in `peak`."""
        self.peak = max(self.peak, tree_memory(self.process.pid))
        return self.peak

    def over(self, since: float) -> str:
        """What the process uses too much of, with wall time counted from `since`; "" if nothing."""
        if self.look() > self.bounds.memory:
            return "memory"
        if self._wrote_too_much():
            return "output"
        return "timeout" if time.monotonic() - since > self.bounds.seconds else ""

    def wait(self) -> Ended:
        """Wait for the end, or bring it about."""
        over, nap = "", SHORTEST_NAP
        while not over:
            ended = self._reap(os.WNOHANG)
            if ended is not None:
                return ended
            time.sleep(nap)
            nap = min(nap * 1.5, LONGEST_NAP)
            if nap > 4 * SHORTEST_NAP:
                over = self.over(self.started)
        return self.end(over)

    def end(self, over: str = "killed") -> Ended:
        """Kill it for this reason, unless it has ended by itself."""
        ended = self._reap(os.WNOHANG)
        if ended is None:
            self._kill()
            ended = self._reap(0)
            assert ended is not None
            ended = replace(ended, over=over)
        return ended

    def _reap(self, options: int) -> Ended | None:
        pid, status, usage = os.wait4(self.process.pid, options)
        if not pid:
            return None
        self.process.returncode = code = os.waitstatus_to_exitcode(status)
        _running.discard(self)
        self._kill()  # what it started and left behind
        if usage.ru_maxrss > self._ours:
            self.peak = max(self.peak, usage.ru_maxrss * RSS_UNIT)
        over = "output" if self._wrote_too_much() else ""
        return Ended(code, over, time.monotonic() - self.started, self.peak)

    def _wrote_too_much(self) -> bool:
        return sum(map(folder_size, self._written)) > self.bounds.written

    def _kill(self) -> None:
        with suppress(ProcessLookupError, PermissionError):  # macOS: only zombies are left
            os.killpg(self.process.pid, signal.SIGKILL)


_running: set[Watched] = set()


@atexit.register
def _end_all() -> None:
    """End what an interrupt has left running, wherever it came."""
    for watched in list(_running):
        watched._kill()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """An interrupt takes effect afterwards.

    One that comes while a process is being started would leave a process that nobody knows.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # nothing interrupts it
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


def run(
    command: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    bounds: Bounds,
    *,
    stdout: Path,
    stderr: Path,
    written: Sequence[Path] = (),
) -> Ended:
    """Run a command to its end; standard output and standard error go to files."""
    with stdout.open("wb") as out, stderr.open("wb") as err:
        watched = Watched(
            command, folder, environment, bounds, stdout=out, stderr=err, written=written
        )
        try:
            return watched.wait()
        except BaseException:  # an interrupt
            watched.end()
            raise


def clean_environment(home: Path, passed: Sequence[str] = ()) -> dict[str, str]:
    """The environment of a decoder: nothing of ours but PATH and what was asked for by name."""
    environment = {
        "PATH": os.environ.get("PATH", os.defpath),
        "HOME": str(home),
        "TMPDIR": str(home),
        "LANG": "C.UTF-8",
        "LC_ALL": "C.UTF-8",
        "TZ": "UTC",
    }
    return environment | {name: os.environ[name] for name in passed if name in os.environ}


def tree_memory(pid: int) -> int:
    """The most resident bytes of a process and of all it started; 0 where there is no /proc."""
    total, waiting = 0, [pid]
    while waiting:
        root = Path("/proc") / str(waiting.pop())
        try:
            _, _, rest = (root / "status").read_text().partition("VmHWM:")
            total += int(rest.split(maxsplit=1)[0]) * 1024 if rest else 0  # none: a zombie
            for task in (root / "task").iterdir():
                waiting += map(int, (task / "children").read_text().split())
        except OSError:  # it has ended, or there is no /proc
            continue
    return total


def folder_size(folder: Path) -> int:
    """Bytes of the files directly in a folder."""
    total = 0
    with suppress(OSError):  # it is gone, or a file in it
        for entry in os.scandir(folder):
            total += entry.stat(follow_symlinks=False).st_size
    return total
