"""`-` in place of a file: standard input, or standard output."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, TextIO

from evogs_codec.errors import InputError

__all__ = ["names_of_standard_streams", "standard_streams"]

DASH = Path("-")
STREAMS = {"standard-input": "standard input", "standard-output": "standard output"}


@contextmanager
def names_of_standard_streams(args: argparse.Namespace) -> Iterator[None]:
    """Print no path of a file that `standard_streams` gives a command, but what it stands for.

    Around all that prints, which is also what says how a command failed.
    """
    if not _uses_dash(args):
        yield
        return
    args.names = names = dict[str, str]()
    with (
        redirect_stdout(_Renaming(sys.stdout, names)),  # type: ignore[type-var]
        redirect_stderr(_Renaming(sys.stderr, names)),  # type: ignore[type-var]
    ):
        yield


@contextmanager
def standard_streams(args: argparse.Namespace) -> Iterator[None]:
    """Give a command files in place of `-`; what it makes is copied when all is done.

    What it prints goes to standard error then. A scene on standard output is a `.ply`.

    Raises:
        InputError: standard output is a terminal.
    """
    if not _uses_dash(args):
        yield
        return
    reads, writes = (getattr(args, name, None) == DASH for name in ("input", "output"))
    if writes and sys.stdout.isatty():
        raise InputError("standard output is a terminal: name a file, or pipe it somewhere")
    with tempfile.TemporaryDirectory(prefix="evogs-") as folder:
        files = {name: Path(folder) / name for name in STREAMS}
        args.names.update((str(path), STREAMS[name]) for name, path in files.items())
        if reads:
            args.input = files["standard-input"]
            with args.input.open("wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file)
        if not writes:
            yield
            return
        args.output = files["standard-output"]
        with redirect_stdout(sys.stderr):
            yield
        if args.output.is_file():
            with args.output.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()


def _uses_dash(args: argparse.Namespace) -> bool:
    return DASH in (getattr(args, "input", None), getattr(args, "output", None))


class _Renaming:
    """A stream of text that writes other words for some.

    Attributes:
        names: the words, and what is written for them; more may come.
    """

    def __init__(self, stream: TextIO, names: dict[str, str]) -> None:
        self._stream = stream
        self.names = names

    def write(self, text: str) -> int:
        """As of the stream; within a command that is said, in backquotes, the word is `-`."""
        for word, other in self.names.items():
            parts = text.split("`")
            parts[::2] = [part.replace(word, other) for part in parts[::2]]
            parts[1::2] = [part.replace(word, str(DASH)) for part in parts[1::2]]
            text = "`".join(parts)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - all else is that of the stream
        return getattr(self._stream, name)
