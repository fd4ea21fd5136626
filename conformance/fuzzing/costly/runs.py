"""Zstandard frames of long runs, written by hand: 4 bytes for 128 KiB."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from evogs_codec.format.frames import MAGIC, MAX_BLOCK

__all__ = ["Run", "frame"]

Run: TypeAlias = tuple[int, int]  # a byte, and how often it comes
RAW, RUN = 0, 1


def frame(planes: Sequence[Sequence[Run]], least: int = 0) -> bytes:
    """One frame of some planes, of at least so many bytes if raw blocks can make it as long."""
    runs = [run for plane in planes for run in plane]
    size = sum(length for _, length in runs)
    head = MAGIC + bytes([0xA0]) + size.to_bytes(4, "little")
    largest = min(MAX_BLOCK, size)
    n_raw = least  # of which the heads of blocks are some
    blocks: list[tuple[int, int, bytes]] = []
    for byte, length in runs:
        left = length
        while left:
            n = min(left, largest)
            if n_raw > 0:
                n = min(n, n_raw)
                n_raw -= n + 3
                blocks.append((RAW, n, bytes([byte]) * n))
            else:
                blocks.append((RUN, n, bytes([byte])))
            left -= n
    last = len(blocks) - 1
    return head + b"".join(
        ((k == last) | kind << 1 | n << 3).to_bytes(3, "little") + content
        for k, (kind, n, content) in enumerate(blocks)
    )
