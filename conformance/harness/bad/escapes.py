"""Decoders that try to get away: from their bounds, from the end of their run, from their folder.

All are bounded in time.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import signal
import sys
import threading
import time
from pathlib import Path

from conformance.harness.bad.right import Question, Reply, Table

__all__ = ["ALIVE", "ESCAPES"]

LONG = 60  # seconds: longer than any bound of a self-test, and not for ever
MIB = 1 << 20
ALIVE = "alive"  # a file of the suite that is locked by what goes on after a run


def hides_its_memory(table: Table, question: Question) -> Reply:
    """Has a name that looks like the line of a process's peak memory."""
    Path("/proc/self/comm").write_bytes(b"VmHWM: 9 kB")
    _take_memory()
    return table.answer(question)


def hides_its_memory_in_a_thread(table: Table, question: Question) -> Reply:
    """Its first thread ends, so that the process itself shows no memory."""
    threading.Thread(target=_take_memory).start()
    time.sleep(0.1)
    ctypes.CDLL(None).pthread_exit(None)
    return Reply(1)


def hides_its_memory_in_a_daemon(table: Table, question: Question) -> Reply:
    if _is_daemon(table):
        _take_memory()
    time.sleep(LONG)
    return table.answer(question)


def strange_name(table: Table, question: Question) -> Reply:
    """Right, with a name that is not UTF-8."""
    Path("/proc/self/comm").write_bytes(b"\xff\xfe\x1b[2J")
    time.sleep(0.1)
    return table.answer(question)


def leaves_a_daemon(table: Table, question: Question) -> Reply:
    """Right, but what it started stays, out of its session and its group."""
    if _is_daemon(table):
        time.sleep(LONG)
        os._exit(0)
    return table.answer(question)


def leaves_a_hopper(table: Table, question: Question) -> Reply:
    """Right, but what it started stays, and is always another process."""
    if _is_daemon(table):
        end = time.monotonic() + LONG
        while time.monotonic() < end:
            if os.fork():
                os._exit(0)
    return table.answer(question)


def forks_many(table: Table, question: Question) -> Reply:
    """Has more processes than the bound on memory allows."""
    for _ in range(400):
        if not os.fork():
            time.sleep(LONG)
            os._exit(0)
    time.sleep(LONG)
    return Reply(1)


def ends_its_parent(table: Table, question: Question) -> Reply:
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(LONG)
    return table.answer(question)


def huge_output_below(table: Table, question: Question) -> Reply:
    """Writes little to each of many folders in its folder."""
    for number in range(20):
        folder = Path(f"{number}/below")
        folder.mkdir(parents=True)
        (folder / "file").write_bytes(b"x" * MIB)
    return table.answer(question)


def many_files(table: Table, question: Question) -> Reply:
    for number in range(600):
        os.close(os.open(str(number), os.O_CREAT | os.O_WRONLY))
    return table.answer(question)


def deep_folders(table: Table, question: Question) -> Reply:
    """A path longer than can be named, deeper than can be followed."""
    for _ in range(400):
        Path("x" * 200).mkdir()
        os.chdir("x" * 200)
    return table.answer(question)


def pipes_for_files(table: Table, question: Question) -> Reply:
    """What it was asked, and its answer, become pipes, whose reader waits."""
    reply = table.answer(question)
    for path in (question.source, question.target):
        path.unlink(missing_ok=True)
        os.mkfifo(path)
    return Reply(reply.exit, reply.code, reply.offset)


def removes_all_folders(table: Table, question: Question) -> Reply:
    """Those of other runs too."""
    reply = table.answer(question)
    shutil.rmtree(question.target.parents[1], ignore_errors=True)
    return Reply(reply.exit, reply.code, reply.offset)


ESCAPES = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(hides_its_memory, hides_its_memory_in_a_thread, hides_its_memory_in_a_daemon),
        *(strange_name, leaves_a_daemon, leaves_a_hopper, forks_many, ends_its_parent),
        *(huge_output_below, many_files, deep_folders, pipes_for_files, removes_all_folders),
    )
}


def _is_daemon(table: Table) -> bool:
    """Start a process that nobody is the parent of; whether this is it."""
    if os.fork():
        os.wait()
        return False
    os.setsid()
    if os.fork():
        os._exit(0)
    alive = (table.folder / ALIVE).open("wb")
    fcntl.flock(alive, fcntl.LOCK_SH)  # held as long as there is a process that has it
    sys.modules[ALIVE] = alive  # type: ignore[assignment]
    for number in range(3):
        os.close(number)
    return True


def _take_memory() -> None:
    kept = []
    for _ in range(40):
        kept.append(b"x" * (16 * MIB))
        time.sleep(0.01)
    time.sleep(LONG)
