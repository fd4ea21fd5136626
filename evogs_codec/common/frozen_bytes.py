"""Bytes that cannot change while they are read, as those of a mapped file can."""

from __future__ import annotations

__all__ = ["frozen"]


def frozen(data: memoryview) -> memoryview:
    """The bytes of `data` as they are now: `data` itself if it views `bytes`, else a copy.

    A count that is checked and then read again must be the same: compiled loops trust it.
    """
    return data if isinstance(data.obj, bytes) else memoryview(bytes(data))
