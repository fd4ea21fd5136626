"""The bytes of a stream, however a caller has them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeAlias

__all__ = ["Source", "bytes_of"]

Source: TypeAlias = "bytes | bytearray | memoryview | str | os.PathLike[str]"


def bytes_of(source: Source) -> memoryview:
    """The bytes themselves, without a copy; those of the file if `source` is a path.

    Raises:
        OSError: the file cannot be read.
        TypeError: `source` is neither bytes nor a path.
    """
    if isinstance(source, str | os.PathLike):
        return memoryview(Path(source).read_bytes())
    try:
        view = memoryview(source)
    except TypeError:
        kind = type(source).__name__
        raise TypeError(f"expected the bytes of a stream, or its path, not {kind}") from None
    return view if view.format == "B" and view.ndim == 1 else view.cast("B")
