"""A clock of processor time, for decoders that do not end."""

from __future__ import annotations

import signal
from types import FrameType

__all__ = ["Alarm", "TooLong"]


class TooLong(BaseException):
    """A decoder did not end in time; no Exception, so that nothing catches it."""


class Alarm:
    """Raise `TooLong` in the main thread after some seconds of processor time."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        self.before = signal.signal(signal.SIGPROF, self.ring)
        signal.setitimer(signal.ITIMER_PROF, self.seconds)

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, self.before)

    @staticmethod
    def ring(signum: int, frame: FrameType | None) -> None:
        """What the signal calls."""
        raise TooLong
