"""`-` in place of a file: standard input, or standard output."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from evogs_codec.errors import InputError

__all__ = ["standard_streams"]

DASH = Path("-")


@contextmanager
def standard_streams(args: argparse.Namespace) -> Iterator[None]:
    """Give a command files in place of `-`; what it makes is copied when all is done.

    What it prints goes to standard error then. A scene on standard output is a `.ply`.

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
        if reads:
            args.input = Path(folder) / "standard-input"
            with args.input.open("wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file)
        if not writes:
            yield
            return
        args.output = Path(folder) / "standard-output"
        with redirect_stdout(sys.stderr):
            yield
        if args.output.is_file():
            with args.output.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()
