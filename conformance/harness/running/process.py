"""A process under watch: bounded in time, memory and output, killed with all that it started.

Limits are watched from outside (resident memory of the whole process tree, wall time, bytes written
to its folders), because limits set inside mean different things to different runtimes: address
space says nothing about the memory of a program on a virtual machine. Where the system has
`prlimit`, file size is limited as well, for what escapes the watch.
"""

from __future__ import annotations

import os
import signal
import stat
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

from conformance.harness.running.keepers import Keeper, KeeperLostError, free_keeper
from conformance.harness.running.scratch import written_too_much

__all__ = ["MAX_SAID", "Bounds", "Ended", "Watched", "clean_environment", "read_tail", "run"]

MIN_MEMORY = 1 << 20  # of a process: so their number is bounded too
GLANCE = 0.02  # seconds between looks
DUTY = 4  # a look that takes long is not taken more often than this
MAX_SAID = 1 << 16  # bytes of standard output that are kept
MAX_WORDS = 1 << 12  # and of standard error
TRIES = 3


@dataclass(frozen=True)
class Bounds:
    """What a process may use: wall seconds, bytes of memory, bytes written to files, files."""

    seconds: float = 20.0
    memory: int = 1 << 30
    written: int = 64 << 20
    files: int = 10_000


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes:
        status: its exit status; negative: the number of the signal that ended it.
        over: what it used too much of and was killed for: "timeout", "memory", "output";
            "killed": without a reason; "keeper": it did away with its keeper; "left": it started
            processes that cannot be killed; "": it ended by itself.
        seconds: wall time.
        peak: bytes of memory at most, of one of its processes or, as far as seen, of all together.
        stdout: the first bytes on standard output, one more than `MAX_SAID` at most.
        stderr: the last bytes on standard error.
    """

    status: int
    over: str
    seconds: float
    peak: int
    stdout: bytes = b""
    stderr: bytes = b""


class Watched:
    """A running process, below a keeper that ends all that it starts."""

    def __init__(
        self,
        command: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        bounds: Bounds,
        *,
        files: tuple[int, int, int],
        written: Sequence[Path] = (),
    ) -> None:
        """Start it.

        Args:
            command: its words.
            folder: where it starts.
            environment: its own.
            bounds: what it may use.
            files: its standard input, output and error; they stay open here.
            written: folders that count as its output, as do regular files among `files`.

        Raises:
            OSError: it cannot be started.
        """
        self.bounds = bounds
        self.peak = 0
        self.nap = GLANCE  # seconds until it should be looked at again
        self.ended: Ended | None = None
        self._written = written
        # Not those of pipes: as long as they are open here, their readers hear of no end.
        regular = (one for one in files[1:] if stat.S_ISREG(os.fstat(one).st_mode))
        self._files = [os.dup(number) for number in regular]
        self.started = time.monotonic()
        self._keeper: Keeper | None = None
        try:
            with _interrupts_held():
                self._keeper = _started(command, folder, environment, bounds.written, files)
        except BaseException:
            if self._keeper is not None:  # an interrupt
                self.end()
            self._close_files()
            raise

    def look(self) -> int:
        """Bytes of memory that the process and all it started have used at most; kept in `peak`."""
        if self._keeper is not None:
            processes = self._keeper.processes(self.bounds.memory // MIN_MEMORY)
            self.peak = max(self.peak, sum(map(memory_of, processes)))
        return self.peak

    def is_lost(self) -> bool:
        """Whether nobody watches it any more."""
        return self._keeper is not None and self._keeper.is_lost()

    def over(self, since: float, also: Sequence[Path] = ()) -> str:
        """What the process uses too much of; "" if nothing.

        Args:
            since: from when on wall time counts.
            also: more folders that count as its output.
        """
        began = time.monotonic()
        why = ""
        if self.is_lost():
            why = "keeper"
        elif self.look() > self.bounds.memory:
            why = "memory"
        elif self._wrote_too_much(also):
            why = "output"
        elif began - since > self.bounds.seconds:
            why = "timeout"
        self.nap = max(GLANCE, DUTY * (time.monotonic() - began))
        return why

    def wait(self) -> Ended:
        """Wait for the end, or bring it about."""
        over = ""
        while not over:
            ended = self.wait_for(self.nap)
            if ended is not None:
                return ended
            over = self.over(self.started)
        return self.end(over)

    def wait_for(self, seconds: float) -> Ended | None:
        """How it ended, if it does so in this time."""
        if self._keeper is not None:
            try:
                answer = self._keeper.answer(seconds)
            except KeeperLostError:
                return self._lost()
            if answer is None:
                return None
            self._conclude(answer, "")
        return self.ended

    def end(self, over: str = "killed") -> Ended:
        """Kill it for this reason, unless it has ended by itself."""
        if self._keeper is not None:
            try:
                answer = self._keeper.end()
            except KeeperLostError:
                return self._lost()
            self._conclude(answer, over)
        assert self.ended is not None
        return self.ended

    def _conclude(self, answer: Mapping[str, int], over: str) -> None:
        assert self._keeper is not None
        self.peak = max(self.peak, answer["peak"])
        over = over if answer["killed"] else ""
        over = over or ("output" if self._wrote_too_much() else "")
        self._close_files()
        if answer["left"]:
            over = over or "left"
            self._keeper.discard()
        else:
            self._keeper.give_back()
        self._keeper = None
        self.ended = Ended(answer["status"], over, time.monotonic() - self.started, self.peak)

    def _lost(self) -> Ended:
        assert self._keeper is not None
        self._keeper.discard()
        self._keeper = None
        self._close_files()
        seconds = time.monotonic() - self.started
        self.ended = Ended(-signal.SIGKILL, "keeper", seconds, self.peak)
        return self.ended

    def _wrote_too_much(self, also: Sequence[Path] = ()) -> bool:
        most = self.bounds.written
        if self._files and sum(os.fstat(number).st_size for number in self._files) > most:
            return True
        return written_too_much([*self._written, *also], most, self.bounds.files)

    def _close_files(self) -> None:
        for number in self._files:
            os.close(number)
        self._files = []


def _started(
    command: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    written: int,
    files: tuple[int, int, int],
) -> Keeper:
    """A keeper that has started a command.

    Raises:
        OSError: the command cannot be started.
    """
    for _ in range(TRIES):
        keeper = free_keeper()
        try:
            keeper.start(command, folder, environment, written, files)
        except KeeperLostError:  # ended while it was free
            keeper.discard()
        except OSError:
            keeper.give_back()
            raise
        else:
            return keeper
    raise OSError("what should start it ends at once")


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
    written: Sequence[Path] = (),
) -> Ended:
    """Run a command to its end; what it said stands in the answer.

    Standard output and standard error are files without a name, which nobody else can replace.

    Raises:
        OSError: it cannot be started.
    """
    with (
        Path(os.devnull).open("rb") as nothing,
        tempfile.TemporaryFile(buffering=0) as out,
        tempfile.TemporaryFile(buffering=0) as err,
    ):
        files = (nothing.fileno(), out.fileno(), err.fileno())
        watched = Watched(command, folder, environment, bounds, files=files, written=written)
        try:
            ended = watched.wait()
        except BaseException:  # an interrupt
            watched.end()
            raise
        said = os.pread(out.fileno(), MAX_SAID + 1, 0)
        return replace(ended, stdout=said, stderr=read_tail(err))


def read_tail(file: IO[bytes]) -> bytes:
    """The last bytes of a file."""
    number = file.fileno()
    return os.pread(number, MAX_WORDS, max(0, os.fstat(number).st_size - MAX_WORDS))


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


def memory_of(pid: int) -> int:
    """The most resident bytes of a process, one MiB at least; that much where there is no /proc.

    Its first thread may have ended while others run: then only they show the memory.
    """
    process = Path("/proc") / str(pid)
    peak = _peak(process)
    if not peak:
        with suppress(OSError):  # it has ended
            peak = max(map(_peak, (process / "task").iterdir()), default=0)
    return max(peak, MIN_MEMORY)


def _peak(task: Path) -> int:
    """What the line VmHWM says in bytes; 0 if there is none, as of a thread that has ended.

    Only the beginning of a line counts: another line has the name of the process, which may be
    any bytes but a line end.
    """
    with suppress(OSError):  # it has ended
        for line in (task / "status").read_bytes().split(b"\n"):
            if line.startswith(b"VmHWM:"):
                return int(line.split()[1]) * 1024
    return 0
