"""What a command line asks for, checked before anything is run; and reports written at its end."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from conformance.harness.running.plain import MOST_OF_LINE, plain

__all__ = ["USAGE", "UsageError", "check_reports", "check_sizes", "command_of", "write_reports"]

USAGE = 2  # exit code


class UsageError(Exception):
    """The command line cannot be meant so."""


def command_of(option: str, text: str) -> tuple[str, ...]:
    """The words of a command; files named relative to here are found from everywhere.

    Raises:
        UsageError: it has no words, or an open quotation.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from None
    if not words:
        raise UsageError(f"{option}: no command")
    # Not resolved: a link to a program may be what makes it find its libraries.
    return tuple(str(Path(word).absolute()) if _is_file(word) else word for word in words)


def check_sizes(args: argparse.Namespace, *names: str) -> None:
    """Each of these options must be above 0.

    Raises:
        UsageError: one is not.
    """
    for name in names:
        if not getattr(args, name) > 0:
            raise UsageError(f"--{name}: {getattr(args, name)} is not above 0")


def check_reports(args: argparse.Namespace, *names: str) -> None:
    """Each of these options must name a file that can be written, as far as can be seen.

    Raises:
        UsageError: its folder is not there, or it is a folder.
    """
    for name in names:
        path = getattr(args, name)
        try:
            if path is None or (path.parent.is_dir() and not path.is_dir()):
                continue
        except OSError as error:
            raise UsageError(f"--{name}: {error}") from None
        why = "it is a folder" if path.is_dir() else "its folder is not there"
        raise UsageError(f"--{name}: {path} cannot be written: {why}")


def write_reports(reports: Iterable[tuple[Path | None, Callable[[], str]]]) -> bool:
    """Write what was asked for; whether all could be. What could not is told."""
    is_all = True
    for path, text in reports:
        if path is None:
            continue
        try:
            path.write_text(text(), encoding="utf-8")
        except OSError as error:
            is_all = False
            print(f"no report: {plain(str(error), MOST_OF_LINE)}", file=sys.stderr)
    return is_all


def _is_file(word: str) -> bool:
    try:
        return Path(word).is_file()
    except OSError:  # say a program in an option, too long for a path
        return False
