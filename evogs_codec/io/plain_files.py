"""Files of a folder of cameras: only plain ones are opened, so nothing waits for a pipe."""

from __future__ import annotations

import stat
from collections.abc import Iterable
from pathlib import Path

from evogs_codec.common.printable import shown
from evogs_codec.errors import InputError

__all__ = ["MAX_PATH", "first_there", "is_there", "read_plain"]

MAX_PATH = 500  # characters of a path in a message


def is_there(path: Path, what: str = "file") -> bool:
    """Whether there is a plain file.

    Args:
        path: of the file; a link is followed.
        what: it should be, for messages.

    Raises:
        InputError: a folder, a pipe or a device is there, or the path cannot be looked at.
    """

    def refusal(why: str) -> InputError:
        return InputError(f"{shown(path, MAX_PATH)}: {why}")

    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise refusal(f"cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a zero byte, or half a character
        raise refusal(f"no {what} that can be read: {shown(error)}") from error
    if not stat.S_ISREG(mode):
        raise refusal(f"no {what} that can be read: it is not a file")
    return True


def first_there(paths: Iterable[Path], what: str = "file") -> Path | None:
    """The first of the paths where a plain file is, if there is one.

    Raises:
        InputError: there is none, and one of them cannot be looked at, or is something else.
    """
    refused = None
    for path in paths:
        try:
            if is_there(path, what):
                return path
        except InputError as error:
            refused = refused or error
    if refused is not None:
        raise refused
    return None


def read_plain(path: Path, missing: str) -> bytes:
    """All bytes of a plain file.

    Args:
        path: of the file.
        missing: what to say where it is missing.

    Raises:
        InputError: it is missing, or cannot be read.
    """
    if not is_there(path):
        raise InputError(f"{shown(path, MAX_PATH)}: {missing}")
    try:
        return path.read_bytes()
    except OSError as error:
        name = shown(path, MAX_PATH)
        raise InputError(f"{name}: cannot be read: {error.strerror or error}") from error
