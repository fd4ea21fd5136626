"""URLs in place of files: commands that need a whole file get one that stands in for it."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import StringIO, TextIOBase
from pathlib import Path
from typing import TextIO

from evogs_codec.cli.reports import fetched_text
from evogs_codec.cli.terminal import complain, progress_bar
from evogs_codec.errors import InputError, StreamError
from evogs_codec.format.directory import HEADER_SIZE, read_header
from evogs_codec.io.files import check_target
from evogs_codec.io.makers import MAX_MARK
from evogs_codec.stores.client import put_object
from evogs_codec.stores.remote_file import RemoteFile
from evogs_codec.stores.sources import ByteSource
from evogs_codec.stores.urls import Url

__all__ = ["fetched", "remote_files", "say_fetched"]

MAX_DIRECTORY = 64 << 20  # bytes of a stream that is replaced that are looked at


@contextmanager
def remote_files(args: argparse.Namespace, *, keeps_input: bool) -> Iterator[None]:
    """Give a command files in place of URLs; what it makes is put when all is done.

    What it prints has the URLs in place of the files.

    Args:
        args: of the command; in the end they are as they were.
        keeps_input: the command reads its input by ranges, so that it gets a `RemoteFile`.

    Raises:
        InputError: an output cannot be written, or must not be.
        OSError: a file cannot be read or written; the error names the URL.
    """
    before = dict(vars(args))
    urls = [url for value in before.values() for url in _urls_of(value)]
    if not urls:
        yield
        return
    with ExitStack() as stack:
        names: dict[str, str] = {}
        try:
            output = before.get("output")
            _check_resume(args, urls)
            if isinstance(output, Url):
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="evogs-"))
                args.output = Path(folder) / output.name
                names[str(args.output)] = str(output)
                _check_object(args, output, urls, names)
            for name in before.keys() - {"output"}:
                is_kept = keeps_input and name == "input"
                setattr(args, name, _stand_in(before[name], is_kept, names, stack))
            # What a command says of its output is printed when that is where it says.
            out = StringIO() if isinstance(output, Url) else sys.stdout
            with (
                redirect_stdout(_Renamed(out, names)),
                redirect_stderr(_Renamed(sys.stderr, names)),
            ):
                yield
            if isinstance(output, Url) and args.output.is_file():
                put_object(output, args.output)
            if isinstance(out, StringIO):
                print(out.getvalue(), end="")
        except InputError as error:
            raise InputError(_renamed(str(error), names)) from error
        except OSError as error:
            if str(error.filename) not in names:
                raise
            raise OSError(error.errno, error.strerror, names[str(error.filename)]) from error
        finally:
            vars(args).update(before)


def _urls_of(value: object) -> list[Url]:
    """The URLs of an option, which may be one, or some of a list."""
    return [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, Url)]


def _stand_in(value: object, is_kept: bool, names: dict[str, str], stack: ExitStack) -> object:
    """An option with files in place of URLs, or a `RemoteFile` in place of one that is kept."""
    if isinstance(value, list):
        return [_stand_in(one, is_kept, names, stack) for one in value]
    if not isinstance(value, Url):
        return value
    if is_kept:
        return stack.enter_context(RemoteFile(value))
    path = fetched(value, stack)
    names[str(path)] = str(value)
    return path


def _check_resume(args: argparse.Namespace, urls: list[Url]) -> None:
    """Refuse to go on with a run of which nothing can be left."""
    if not getattr(args, "resume", False):
        return
    if urls != [getattr(args, "output", None)] or not getattr(args, "scratch", None):
        raise InputError("--resume: needs inputs on the disk, and --scratch if the output is a URL")


def fetched(url: Url, stack: ExitStack) -> Path:
    """The whole file of a URL, which goes with the stack."""
    remote = stack.enter_context(RemoteFile(url))
    with progress_bar() as progress:
        path = remote.whole(progress)
    say_fetched(remote)
    return path


def say_fetched(source: ByteSource) -> None:
    """Say on standard error how much of a URL was fetched; nothing of a file on the disk."""
    if isinstance(source, RemoteFile):
        said = fetched_text(source.n_fetched, source.n_requests)
        complain(f"{source}: fetched {said}, of {source.size:,}")


def _check_object(
    args: argparse.Namespace, url: Url, others: list[Url], names: dict[str, str]
) -> None:
    """Refuse an object that must not be replaced, as `check_target` refuses a file."""
    if not url.is_store:
        raise InputError(f"{url}: an output is written to a file, s3:// or gs://")
    if others.count(url) > 1:
        raise InputError(f"{url}: is an input of the command; name another output")
    kind = args.output_kind(args.output) if callable(args.output_kind) else args.output_kind
    try:
        remote = RemoteFile(url)
    except FileNotFoundError as error:
        if "bucket" in (error.strerror or ""):
            raise
        return
    with remote:
        names[str(remote.path)] = str(url)
        if not args.force:  # its begin says what it is, or the end of a zip
            remote.having([(0, _begin_of(remote)), (remote.size - MAX_MARK, remote.size)])
            check_target(remote.path, kind, command=args.command)


def _begin_of(remote: RemoteFile) -> int:
    """How many bytes say which command made a file: of a stream, the directory."""
    head = remote.having([(0, HEADER_SIZE)])[:HEADER_SIZE]
    try:
        return min(HEADER_SIZE + int(read_header(head)["chunks_size"]), MAX_DIRECTORY)
    except StreamError:
        return MAX_MARK


def _renamed(text: str, names: dict[str, str]) -> str:
    """`text` with URLs in place of the files that stand in for them."""
    for path, url in names.items():
        text = text.replace(path, url).replace(json.dumps(path)[1:-1], json.dumps(url)[1:-1])
    return text


class _Renamed(TextIOBase):
    """Prints what it is given, with URLs in place of the files that stand in for them."""

    def __init__(self, out: TextIO, names: dict[str, str]) -> None:
        self._out = out
        self._names = names

    def write(self, text: str) -> int:
        self._out.write(_renamed(text, self._names))
        return len(text)

    def flush(self) -> None:
        self._out.flush()

    def isatty(self) -> bool:
        return self._out.isatty()

    def fileno(self) -> int:
        return self._out.fileno()
