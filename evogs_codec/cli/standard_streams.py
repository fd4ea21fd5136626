"""`-` in place of a file: standard input, or standard output."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from evogs_codec.cli.renaming import renaming
from evogs_codec.errors import InputError

__all__ = ["standard_streams"]

DASH = Path("-")
STANDARD_INPUT, STANDARD_OUTPUT = "standard input", "standard output"


@contextmanager
def standard_streams(args: argparse.Namespace) -> Iterator[None]:
    """Give a command files in place of `-`; what it makes is copied when all is done.

    What it prints goes to standard error then, and has the words for the files. A scene on standard
    output is a `.ply`.

    Raises:
        InputError: standard output is a terminal.
    """
    reads, writes = (getattr(args, name, None) == DASH for name in ("input", "output"))
    if not reads and not writes:
        yield
        return
    if writes and sys.stdout.isatty():
        raise InputError("standard output is a terminal: name a file, or pipe it somewhere")
    with tempfile.TemporaryDirectory(prefix="evogs-") as folder:
        names: dict[str, str] = {}
        if reads:
            args.input = _stand_in(folder, STANDARD_INPUT, names)
            with args.input.open("wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file)
        if writes:
            args.output = _stand_in(folder, STANDARD_OUTPUT, names)
        try:
            with renaming(names, sys.stderr if writes else sys.stdout, sys.stderr):
                yield
            if writes and args.output.is_file():
                with args.output.open("rb") as file:
                    shutil.copyfileobj(file, sys.stdout.buffer)
                sys.stdout.buffer.flush()
        finally:
            if reads:
                args.input = Path(STANDARD_INPUT)  # in what is said of a failure


def _stand_in(folder: str, said: str, names: dict[str, str]) -> Path:
    """A path in place of a stream, and what is said for it: `-` in a command that is shown."""
    path = Path(folder) / said.replace(" ", "-")
    names[f" {path} "] = f" {DASH} "
    names[str(path)] = said
    return path
