"""Jobs that kill their worker, for the tests of engines; a worker imports them by name."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

__all__ = ["dies_always", "dies_at_first", "doubled", "process_of", "sleeps"]


def doubled(number: int) -> int:
    """Twice the number."""
    return 2 * number


def process_of(_number: int) -> int:
    """The number of the process that does the job."""
    return os.getpid()


def dies_at_first(number: int, mark: str) -> int:
    """Twice the number; the first of all kills its process as the system does without memory."""
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def dies_always(_number: int) -> int:
    """Kills its process."""
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def sleeps(seconds: float) -> None:
    """Says that it has begun, and sleeps."""
    print("begun", flush=True)
    time.sleep(seconds)
