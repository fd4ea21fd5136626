"""The bytes of a stream, however a caller has them."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol, TypeAlias, cast

from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.stores.ranges import Range
from evogs_codec.stores.remote_file import RemoteFile
from evogs_codec.stores.urls import Url, is_url

__all__ = ["ByteSource", "Source", "bytes_of", "source_of"]


class ByteSource(Protocol):
    """A file whose bytes come when they are asked for."""

    @property
    def size(self) -> int:
        """Bytes of the whole file."""
        ...

    def having(self, ranges: Iterable[Range], progress: Progress = no_progress) -> memoryview:
        """The whole file as one view, of which the bytes of `ranges`, (begin, end), are there.

        Raises:
            OSError: they cannot be read.
        """
        ...


# Text that begins as a URL does is one; other text is a path.
Source: TypeAlias = "bytes | bytearray | memoryview | str | os.PathLike[str] | Url | ByteSource"


class _Given:
    """Bytes of which all are there."""

    def __init__(self, view: memoryview) -> None:
        self._view = view

    @property
    def size(self) -> int:
        return len(self._view)

    def having(self, _ranges: Iterable[Range], _: Progress = no_progress) -> memoryview:
        return self._view


def source_of(source: Source) -> ByteSource:
    """What gives the bytes of `source`. Those of a file are read now, those of a URL as needed.

    Raises:
        InputError: a URL is none that is known, or obstore is not there.
        OSError: the file cannot be read.
        TypeError: `source` is neither bytes nor a path or a URL.
    """
    if isinstance(source, Url) or (isinstance(source, str) and is_url(source)):
        return RemoteFile(source)
    if isinstance(source, str | os.PathLike):
        return _Given(memoryview(Path(source).read_bytes()))
    if hasattr(source, "having"):
        return cast(ByteSource, source)
    try:
        view = memoryview(cast(bytes, source))
    except TypeError:
        kind = type(source).__name__
        raise TypeError(f"expected the bytes of a stream, or its path, not {kind}") from None
    return _Given(view if view.format == "B" and view.ndim == 1 else view.cast("B"))


def bytes_of(source: Source) -> memoryview:
    """All bytes, without a copy where they are given; a file is read, a URL is fetched.

    Raises:
        InputError, OSError, TypeError: as `source_of`.
    """
    found = source_of(source)
    return found.having([(0, found.size)])
