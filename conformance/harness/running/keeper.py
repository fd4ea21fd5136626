"""The keeper of a decoder: a process that starts it, and ends it with all that it started.

A process group is not enough for that: a decoder can leave it. On Linux a keeper is the subreaper
(prctl(2)) of what it starts: a process whose parent has ended becomes its child, in whatever
session it is. So all that a decoder starts is below its keeper, and is gone when the keeper has no
child left. Elsewhere only the process group is ended.

A keeper keeps one decoder after another, so that a run does not wait for an interpreter to start.
The harness starts it by its path, `python keeper.py FD`, with a socket that carries lines of JSON:

    harness: {"command", "folder", "environment", "written"}, with standard input, output, error
    keeper:  {"pid"}, or {"errno", "strerror", "filename"} if it cannot be started
    harness: {"end": true}, to have it killed; the end of the socket says so too
    keeper:  {"status", "peak", "killed", "left"}: all has ended but the `left` that cannot be
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

__all__ = ["descendants", "kill_all", "main"]

PR_SET_CHILD_SUBREAPER = 36
MAX_ORDER = 1 << 22  # bytes
SLACK = 1 << 20
NAP = 0.002  # seconds between two rounds of killing
PATIENCE = 5.0  # seconds for killing all: what is not ours to kill stays
# Linux counts ru_maxrss in KiB, macOS in bytes.
RSS_UNIT = 1 if sys.platform == "darwin" else 1024

Message = dict[str, Any]


def main() -> int:
    """Keep decoders until the harness is gone."""
    channel = socket.socket(fileno=int(sys.argv[1]))
    if sys.platform == "linux":
        words = map(ctypes.c_ulong, (1, 0, 0, 0))
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, *words)
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(waker)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    while order := _receive(channel):
        message, files = order
        if "command" in message:
            try:
                process = _start(message, files)
            except OSError as error:
                told = {"errno": error.errno, "strerror": error.strerror}
                _send(channel, told | {"filename": error.filename})
            else:
                _send(channel, {"pid": process.pid})
                _send(channel, _Kept(process).to_the_end(channel, woken))
    return 0


def descendants(pid: int, most: int = 10_000) -> list[int]:
    """All processes below one, as far as /proc shows them; more than `most` are not looked for."""
    found, waiting = list[int](), [pid]
    while waiting and len(found) <= most:
        children = _children(waiting.pop())
        found += children
        waiting += children
    return found


def kill_all(pids: list[int]) -> None:
    """Send SIGKILL to each that is still there and ours."""
    for pid in pids:
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)


class _Kept:
    """A decoder that was started."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self.peak = 0

    def to_the_end(self, channel: socket.socket, woken: int) -> Message:
        """Wait for its end, or for the order to end it, and end all that it has started."""
        killed = False
        while self._reap() and self.process.returncode is None and not killed:
            ready, _, _ = select.select([channel.fileno(), woken], [], [])
            _drain(woken)
            killed = channel.fileno() in ready
        began = time.monotonic()
        with suppress(ProcessLookupError, PermissionError):  # macOS: only zombies are left
            os.killpg(self.process.pid, signal.SIGKILL)
        while self._reap() and time.monotonic() - began < PATIENCE:
            kill_all(descendants(os.getpid()))
            select.select([woken], [], [], NAP)
            _drain(woken)
        left = descendants(os.getpid()) if self._reap() else []
        killed = killed and self.process.returncode == -signal.SIGKILL
        status = -signal.SIGKILL if self.process.returncode is None else self.process.returncode
        return {"status": status, "peak": self.peak, "killed": killed, "left": len(left)}

    def _reap(self) -> bool:
        """Take note of all that have ended; whether there are others."""
        while True:
            try:
                pid, status, usage = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                return False
            if not pid:
                return True
            self.peak = max(self.peak, usage.ru_maxrss * RSS_UNIT)
            if pid == self.process.pid:
                self.process.returncode = os.waitstatus_to_exitcode(status)


def _start(order: Message, files: list[int]) -> subprocess.Popen[bytes]:
    try:
        process = subprocess.Popen(
            order["command"],
            cwd=order["folder"],
            env=order["environment"],
            stdin=files[0],
            stdout=files[1],
            stderr=files[2],
            start_new_session=True,
        )
    finally:
        for number in files:
            os.close(number)
    if sys.platform == "linux":
        most = order["written"] + SLACK  # so that the watch sees who wrote too much
        with suppress(OSError):  # it has ended already
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))
            resource.prlimit(process.pid, resource.RLIMIT_CORE, (0, 0))
    return process


def _children(pid: int) -> list[int]:
    found = list[int]()
    try:
        for task in (Path("/proc") / str(pid) / "task").iterdir():
            found += map(int, (task / "children").read_bytes().split())
    except OSError:  # it has ended, or there is no such file here
        pass
    return found


def _receive(channel: socket.socket) -> tuple[Message, list[int]] | None:
    """An order and the files with it; None: the harness is gone."""
    raw, files = b"", list[int]()
    while not raw.endswith(b"\n"):
        piece, numbers, _, _ = socket.recv_fds(channel, MAX_ORDER, 3)
        files += numbers
        if not piece:
            return None
        raw += piece
    return json.loads(raw.rstrip(b"\n").rpartition(b"\n")[2]), files


def _send(channel: socket.socket, message: Message) -> None:
    with suppress(OSError):  # the harness is gone
        channel.sendall(json.dumps(message).encode() + b"\n")


def _drain(woken: int) -> None:
    with suppress(BlockingIOError):
        while os.read(woken, 4096):
            pass


if __name__ == "__main__":
    sys.exit(main())
