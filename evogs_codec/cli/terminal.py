"""What commands print beside their output: errors, warnings, progress."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from io import TextIOWrapper
from typing import Any

from tqdm import tqdm

from evogs_codec.common.printable import MAX_LINE, shown
from evogs_codec.common.progress import Progress

__all__ = [
    "complain",
    "escape_what_cannot_be_encoded",
    "noted_warnings",
    "plain_warnings",
    "progress_bar",
]


SECONDS_OF_A_LINE = 60  # of progress in a log
MIN_DONE = 0.02  # of a stage, before what is left of it is said


def complain(message: object) -> None:
    """One line on standard error, whatever is in it."""
    print(f"evogs: {shown(message, MAX_LINE)}", file=sys.stderr)


def escape_what_cannot_be_encoded() -> None:
    """Print a name that the output has no characters for with escapes, and do not fail."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Warnings as one line each on standard error."""

    def show(message: Warning | str, *_: object, **__: object) -> None:
        complain(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.showwarning = show
        warnings.simplefilter("always", UserWarning)
        yield


def noted_warnings() -> list[str]:
    """A list that gets every warning from now on, which is also shown as before.

    Within `plain_warnings`, which puts an end to it.
    """
    notes: list[str] = []
    show = warnings.showwarning

    def note(message: Warning | str, *more: Any, **named: Any) -> None:  # noqa: ANN401 - passed on
        notes.append(str(message))
        show(message, *more, **named)

    warnings.showwarning = note
    return notes


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """How far work is and how long its stage still takes, on standard error.

    A bar on a terminal, for what takes over two seconds; elsewhere, as in a log, a line for every
    `SECONDS_OF_A_LINE`.
    """
    clock = _Clock()
    if not sys.stderr.isatty():
        yield partial(_log, clock, [clock.now()])
        return
    with tqdm(total=100, delay=2, leave=False, bar_format="{l_bar}{bar}{postfix}") as bar:

        def report(stage: str, part: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.n = round(100 * part)
            left = clock.left(stage, part)
            bar.set_postfix_str("" if left is None else f"{_minutes(left)} left", refresh=False)
            bar.refresh()

        yield report


def _log(clock: _Clock, last: list[float], stage: str, part: float) -> None:
    """Print a line if the last one was long ago; `last` says when."""
    left, now = clock.left(stage, part), clock.now()
    if now - last[0] < SECONDS_OF_A_LINE:
        return
    last[0] = now
    said = "" if left is None else f", {_minutes(left)} left of this step"
    complain(f"{stage}: {100 * part:.0f} %, {_minutes(now - clock.begun)} so far{said}")


class _Clock:
    """How long stages take.

    Attributes:
        begun: when the first began, seconds.
    """

    def __init__(self) -> None:
        self.begun = self.now()
        self._stage, self._first, self._part, self._since = "", 0.0, 0.0, self.begun

    def left(self, stage: str, part: float) -> float | None:
        """Seconds until this stage ends at its pace so far; None while that says little."""
        now = self.now()
        if stage != self._stage or part < self._part:
            self._stage, self._first, self._since = stage, part, now
        self._part = part
        done, taken = part - self._first, now - self._since
        return taken * (1 - part) / done if done >= MIN_DONE and taken >= 1 else None

    @staticmethod
    def now() -> float:
        """Seconds of a clock that never goes back."""
        return time.monotonic()


def _minutes(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02}"
