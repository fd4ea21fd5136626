"""What commands print beside their output: errors, warnings, progress."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
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
    """A bar on standard error for what takes over two seconds, if that is a terminal."""
    with tqdm(total=100, delay=2, disable=None, leave=False, bar_format="{l_bar}{bar}") as bar:

        def report(stage: str, part: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.n = round(100 * part)
            bar.refresh()

        yield report
