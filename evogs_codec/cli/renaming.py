"""Files that stand in for others, such as URLs, have the names of these in all that is said."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import TextIOBase
from typing import TextIO

from evogs_codec.errors import InputError

__all__ = ["renaming"]


@contextmanager
def renaming(names: Mapping[str, str], out: TextIO, err: TextIO) -> Iterator[None]:
    """Print to these streams, and raise, with other words in place of some.

    Args:
        names: the words, such as paths, and what is said instead; more may come while it runs.
        out: what standard output is then.
        err: what standard error is then.

    Raises:
        InputError, OSError: as they come, renamed.
    """
    try:
        with redirect_stdout(_Renamed(out, names)), redirect_stderr(_Renamed(err, names)):
            yield
    except InputError as error:
        said = _renamed(str(error), names)
        if said == str(error):
            raise
        raise InputError(said) from error
    except OSError as error:
        if str(error.filename) not in names:
            raise
        raise OSError(error.errno, error.strerror, names[str(error.filename)]) from error


def _renamed(text: str, names: Mapping[str, str]) -> str:
    for word, other in names.items():
        text = text.replace(word, other).replace(json.dumps(word)[1:-1], json.dumps(other)[1:-1])
    return text


class _Renamed(TextIOBase):
    """Prints what it is given, with other words in place of some."""

    def __init__(self, out: TextIO, names: Mapping[str, str]) -> None:
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
