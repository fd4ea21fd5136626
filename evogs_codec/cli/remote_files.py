"""URLs in place of files: commands that need a whole file get one that stands in for it."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import StringIO
from pathlib import Path

from evogs_codec.cli.renaming import renaming
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
    output, names = before.get("output"), dict[str, str]()
    # What a command says of its output is printed when that is where it says.
    out = StringIO() if isinstance(output, Url) else sys.stdout
    with ExitStack() as stack:
        try:
            with renaming(names, out, sys.stderr):
                _check_resume(args, urls)
                if isinstance(output, Url):
                    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="evogs-"))
                    args.output = Path(folder) / output.name
                    names[str(args.output)] = str(output)
                    _check_object(args, output, urls, names)
                for name in before.keys() - {"output"}:
                    is_kept = keeps_input and name == "input"
                    setattr(args, name, _stand_in(before[name], is_kept, names, stack))
                yield
                if isinstance(output, Url) and args.output.is_file():
                    put_object(output, args.output)
            if isinstance(out, StringIO):
                print(out.getvalue(), end="")
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
