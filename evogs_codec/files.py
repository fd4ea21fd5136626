"""Writing files so that a reader sees the old file or the new one, never half of one."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

__all__ = ["check_target", "write_atomic"]


def check_target(path: str | os.PathLike[str]) -> None:
    """Refuse now what could not be written later, after the work is done.

    Raises:
        OSError: the folder of `path` is missing, is no folder, or may not be written to.
    """
    target = Path(path)
    if target.exists() and not target.is_file():
        return  # a device or pipe; `write_atomic` refuses a folder
    folder = target.resolve().parent
    if not folder.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def write_atomic(path: str | os.PathLike[str], data: bytes | Callable[[BinaryIO], object]) -> None:
    """Write `data` to `path` through a temporary file in the same folder.

    Args:
        path: the file to make or replace; a device or pipe is written to directly.
        data: the bytes, or a function that writes them to the stream it is given.

    Raises:
        OSError: the file cannot be written; it names `path`, not the temporary file.
    """
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    try:
        if target.exists() and not target.is_file():
            with target.open("wb") as stream:  # replacing /dev/null would remove it
                _fill(stream, data)
            return
        # A link keeps pointing at the file that it names.
        _replace(target.resolve(), data)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def _replace(target: Path, data: bytes | Callable[[BinaryIO], object]) -> None:
    # Not `tempfile`: its files are private to the user, ours get the usual permissions. The name
    # is short, so that it fits wherever the name of the target does.
    temporary = target.with_name(f".{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
            _fill(stream, data)
        temporary.replace(target)
    except BaseException:  # also Ctrl-C
        temporary.unlink(missing_ok=True)
        raise


def _fill(stream: BinaryIO, data: bytes | Callable[[BinaryIO], object]) -> None:
    if callable(data):
        data(stream)
    else:
        stream.write(data)
