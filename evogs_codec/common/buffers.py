"""Large arrays whose memory costs little: fresh pages take longer than what is written to them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Scratch", "empty"]

HUGE_PAGE = 2 << 20  # bytes
# Bytes of the first chunk, and of each at most: they double. Of what is not used no page is made.
FIRST, CHUNK = 64 << 10, 24 << 20
LINE = 64  # bytes of a cache line


def empty(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """`numpy.empty`, whose large arrays begin and end where a huge page does.

    NumPy asks for huge pages, but the parts of an array before the first and after the last of
    them are pages of 4 KiB, which are most of the page faults of decoding.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < HUGE_PAGE // 2:
        return np.empty(shape, dtype)
    memory = np.empty(size + 2 * HUGE_PAGE, np.uint8)
    start = -memory.ctypes.data % HUGE_PAGE
    return memory[start : start + size].view(dtype).reshape(shape)


class Scratch:
    """Arrays one after the other, in memory that the next tile takes again."""

    def __init__(self) -> None:
        self._chunks: list[npt.NDArray[np.uint8]] = []
        self._chunk, self._at = 0, 0

    def rewind(self) -> None:
        """Say that no array that was taken is used any more."""
        self._chunk, self._at = 0, 0

    def take(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """An array of any content."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if not size:  # or it might begin a chunk for nothing
            return np.empty(shape, dtype)
        while self._chunk < len(self._chunks):
            memory, at = self._chunks[self._chunk], self._at
            if at + size <= len(memory):
                self._at = at + -(-size // LINE) * LINE
                return memory[at : at + size].view(dtype).reshape(shape)
            self._chunk, self._at = self._chunk + 1, 0
        so_far = sum(map(len, self._chunks))
        n_bytes = max(size, min(max(so_far, FIRST), CHUNK))
        self._chunks.append(empty((n_bytes,), np.uint8))
        return self.take(shape, dtype)
