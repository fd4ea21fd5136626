"""Decoders that do not end as the contract says, or do something beside it. All are bounded."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time

from conformance.harness.bad.right import Question, Reply, Table

__all__ = ["ENDINGS"]

LONG = 60  # seconds: longer than any bound of a self-test, and not for ever
MIB = 1 << 20


def crash(table: Table, question: Question) -> Reply:
    os.kill(os.getpid(), signal.SIGSEGV)
    return Reply(0)


def crash_after_success(table: Table, question: Question) -> Reply:
    """Writes the right dump, says so, and dies."""
    reply = table.answer(question)
    if reply.dump is not None:
        question.target.write_bytes(reply.dump)
    os.kill(os.getpid(), signal.SIGSEGV)
    return reply


def exception(table: Table, question: Question) -> Reply:
    """Python's exit status for what nobody caught is the one for a rejection."""
    raise RuntimeError("list index out of range")


def unknown_status(table: Table, question: Question) -> Reply:
    sys.exit(42)


def hang(table: Table, question: Question) -> Reply:
    time.sleep(LONG)
    return Reply(1)


def sleeps_at_the_end(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    if reply.dump is not None:
        question.target.write_bytes(reply.dump)
    time.sleep(LONG)
    return reply


def burns_processors(table: Table, question: Question) -> Reply:
    """Two processes beside it that do nothing, as fast as they can."""
    program = f"import time\nend = time.time() + {LONG}\nwhile time.time() < end: pass"
    for _ in range(2):
        subprocess.Popen([sys.executable, "-I", "-c", program])
    time.sleep(LONG)
    return Reply(1)


def leaves_a_process(table: Table, question: Question) -> Reply:
    """Right, but what it started stays: the harness ends it."""
    subprocess.Popen([sys.executable, "-I", "-c", f"import time; time.sleep({LONG})"])
    return table.answer(question)


def memory_hog(table: Table, question: Question) -> Reply:
    kept = []
    for _ in range(40):
        kept.append(b"x" * (16 * MIB))
        time.sleep(0.01)
    time.sleep(LONG)
    return table.answer(question) if kept else Reply(1)


def noise(table: Table, question: Question) -> Reply:
    print("decoding ...", flush=True)
    return table.answer(question)


def huge_noise(table: Table, question: Question) -> Reply:
    """Prints 64 MiB."""
    for _ in range(64):
        os.write(1, b"x" * MIB)
    return table.answer(question)


def huge_output(table: Table, question: Question) -> Reply:
    """An OUT with nothing in it, but 2^30 of it."""
    with question.target.open("wb") as file:
        for _ in range(64):
            file.write(b"\0" * (16 * MIB))
            time.sleep(0.02)
    return Reply(0)


def changes_its_input(table: Table, question: Question) -> Reply:
    reply = table.answer(question)
    question.source.write_bytes(question.source.read_bytes() + b"\0")
    return reply


def removes_its_folder(table: Table, question: Question) -> Reply:
    """With all that is in it, what it was asked and what it said."""
    reply = table.answer(question)
    shutil.rmtree(question.target.parent)
    return Reply(reply.exit, reply.code, reply.offset)


def links_its_output(table: Table, question: Question) -> Reply:
    """OUT is a link to a dump elsewhere."""
    reply = table.answer(question)
    if reply.dump is None:
        return reply
    elsewhere = question.target.with_suffix(".elsewhere")
    elsewhere.write_bytes(reply.dump)
    question.target.symlink_to(elsewhere)
    return Reply(reply.exit, reply.code, reply.offset)


ENDINGS = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(crash, crash_after_success, exception, unknown_status, hang, sleeps_at_the_end),
        *(burns_processors, leaves_a_process, memory_hog, noise, huge_noise, huge_output),
        *(changes_its_input, removes_its_folder, links_its_output),
    )
}
