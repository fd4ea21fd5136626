"""The harness's end of its keepers (`keeper`): a decoder is started through one that is free."""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from conformance.harness.running import keeper

__all__ = ["Keeper", "KeeperLostError", "free_keeper"]

PYTHON = sys.executable
PATIENCE = keeper.PATIENCE + 5.0  # seconds for the answer to an order to end
MAX_ANSWER = 1 << 16  # bytes
MAX_PROCESSES = 10_000  # that are looked for
ROUNDS = 5  # of killing where the keeper cannot do it

Message = dict[str, Any]


class KeeperLostError(Exception):
    """A keeper does not answer any more: the decoder ended or stopped it."""


class Keeper:
    """A process that keeps one decoder after another."""

    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair()
        with theirs:
            command = [PYTHON, "-I", "-S", keeper.__file__, str(theirs.fileno())]
            self._process = subprocess.Popen(
                command,
                cwd="/",
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._said = b""
        self._decoder = 0  # its process, while there is one
        self._seen: list[int] = []
        _all.add(self)

    def start(
        self,
        command: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        written: int,
        files: tuple[int, int, int],
    ) -> None:
        """Start a decoder; `files` are its standard input, output and error.

        Raises:
            OSError: it cannot be started.
            KeeperLostError: the keeper cannot.
        """
        order: Message = {"command": list(command), "folder": str(folder)}
        order |= {"environment": dict(environment), "written": written}
        raw = json.dumps(order).encode() + b"\n"
        try:
            self._channel.sendall(raw[socket.send_fds(self._channel, [raw], files) :])
        except OSError:
            raise KeeperLostError from None
        answer = self.answer(PATIENCE)
        if answer is None:
            raise KeeperLostError
        if "pid" not in answer:
            raise OSError(answer["errno"], answer["strerror"], answer["filename"])
        self._decoder, self._seen = answer["pid"], []

    def answer(self, seconds: float) -> Message | None:
        """What the keeper says next; None: nothing in this time.

        Raises:
            KeeperLostError: it will never say anything.
        """
        deadline = time.monotonic() + seconds
        while b"\n" not in self._said:
            left = max(0.0, deadline - time.monotonic())
            if not select.select([self._channel], [], [], left)[0]:
                return None
            try:
                piece = self._channel.recv(MAX_ANSWER)
            except OSError:
                piece = b""
            if not piece:
                raise KeeperLostError
            self._said += piece
        line, _, self._said = self._said.partition(b"\n")
        return dict(json.loads(line))

    def end(self) -> Message:
        """Have the decoder and all that it started killed.

        Raises:
            KeeperLostError: the keeper does not do it.
        """
        try:
            self._channel.sendall(b'{"end": true}\n')
        except OSError:
            raise KeeperLostError from None
        answer = self.answer(PATIENCE)
        if answer is None:
            raise KeeperLostError
        return answer

    def processes(self, most: int = MAX_PROCESSES) -> list[int]:
        """The decoder and all that it started; of over `most` only some."""
        self._seen = keeper.descendants(self._process.pid, most)
        return self._seen

    def is_lost(self) -> bool:
        """Whether it has ended."""
        try:
            ready = select.select([self._channel], [], [], 0)[0]
            return bool(ready) and not self._channel.recv(1, socket.MSG_PEEK)
        except OSError:
            return True

    def give_back(self) -> None:
        """Nothing of the decoder is left: the keeper is free for another."""
        self._decoder = 0
        _free.append(self)

    def discard(self) -> None:
        """End the keeper, and all that is known to be below it."""
        known = self._seen
        for _ in range(ROUNDS):
            keeper.kill_all(known)
            known = self.processes()
        with suppress(ProcessLookupError, PermissionError):
            if self._decoder:
                os.killpg(self._decoder, signal.SIGKILL)
        self.close()

    def close(self) -> None:
        """End the keeper: it ends what it keeps."""
        _all.discard(self)
        self._channel.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:  # it was stopped
            self._process.kill()
            self._process.wait()


_all: set[Keeper] = set()
_free: list[Keeper] = []


def free_keeper() -> Keeper:
    """One that keeps nothing."""
    try:
        return _free.pop()
    except IndexError:
        return Keeper()


@atexit.register
def _close_all() -> None:
    """End what an interrupt has left running, wherever it came."""
    for one in list(_all):
        one.close()
