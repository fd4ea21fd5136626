"""Files of a scratch folder, as an earlier run left them: a damaged one is named in one line."""

from __future__ import annotations

import contextlib
import errno
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evogs_codec.errors import EvogsError, InputError

__all__ = ["arrays_of", "of_scratch"]

DAMAGED = (
    EvogsError,
    ValueError,
    EOFError,
    KeyError,
    TypeError,
    RuntimeError,  # of `zipfile`, as of an encrypted member
    zipfile.BadZipFile,
    zlib.error,
)


@contextlib.contextmanager
def of_scratch(path: Path) -> Iterator[None]:
    """What is wrong with a file that an earlier run left is said of that file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        yield
    except (*DAMAGED, OSError) as error:
        # The operating system refuses to seek to a place before the file, and says EINVAL.
        if isinstance(error, OSError) and error.errno != errno.EINVAL:
            raise
        raise InputError(f"{path}: is damaged: run again without --resume") from error


@contextlib.contextmanager
def arrays_of(path: Path) -> Iterator[Any]:
    """What `numpy.load` finds in a file that an earlier run left.

    Raises:
        InputError: as of `of_scratch`.
    """
    with of_scratch(path), path.open("rb") as file:
        yield np.load(file)
