"""A run of a wrong decoder, which may raise anything, never end, or want all memory."""

from __future__ import annotations

import hashlib
import resource
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType, ModuleType
from typing import Any

from conformance.decoders.outcomes import Outcome, Run, by_oracle

__all__ = ["CRASH", "fault_text", "limit_memory", "outcome", "run_of", "verdict"]

CRASH = Outcome(-1)  # how a run ends that ends in no way of the contract
SECONDS = 3.0  # of processor time that a run may take: far more than the oracle takes
MEMORY = 2 << 30  # address space of a process


class _TimeUp(BaseException):
    """Not an Exception, so that no decoder catches it."""


def outcome(module: ModuleType, data: bytes, run: Run) -> Outcome:
    """The outcome of a run of a mutant; `CRASH` for any exception but a fault, and without end."""
    try:
        with _seconds(SECONDS):
            return by_oracle(data, run, module)
    except (Exception, _TimeUp):
        return CRASH


def run_of(entry: Mapping[str, Any]) -> Run:
    """A run of a vector in the manifest."""
    arrival = entry["arrival"]
    return Run(
        entry["mode"],
        entry["level"],
        entry["limits"],
        entry["verify"],
        None if arrival is None else tuple((at, size) for at, size in arrival),
        entry.get("dump_on_fault", False),
    )


def verdict(exit_code: int, digest: str | None) -> str:
    """What decoders are compared by: "0:" and digits of the hash of the dump, "1:-", "crash"."""
    return "crash" if exit_code == CRASH.exit else f"{exit_code}:{digest[:12] if digest else '-'}"


def fault_text(code: str | None, offset: int | None) -> str:
    """What decoders that report codes are compared by: "E_CRC@371"."""
    return "-" if code is None else f"{code}@{offset}"


def sha256(dump: bytes | None) -> str | None:
    """SHA-256 of a dump in hex."""
    return None if dump is None else hashlib.sha256(dump).hexdigest()


def limit_memory() -> None:
    """Bound the address space of this process: a check that is missing may ask for anything."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


@contextmanager
def _seconds(n: float) -> Iterator[None]:
    """Raise `_TimeUp` in the main thread after n seconds of processor time."""

    def ring(signum: int, frame: FrameType | None) -> None:
        raise _TimeUp

    before = signal.signal(signal.SIGVTALRM, ring)
    signal.setitimer(signal.ITIMER_VIRTUAL, n)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
