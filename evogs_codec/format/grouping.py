"""Which planes of a packet share a frame (spec 5.9): those whose bytes are alike.

A frame costs its headers and its code tables, so a small plane does better with its neighbours. A
code that has to serve unlike planes costs bits of every byte, so a large one does better alone.

Letters: Q planes of a packet.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evogs_codec.format.frames import MAX_BLOCK
from evogs_codec.model.splats import F64

__all__ = ["grouped"]

FRAME_BYTES, SYMBOL_BYTES = 24.0, 0.7  # of the headers of a frame, of a symbol in its code table
MAX_PLANES = 64  # planes of a frame


def grouped(planes: Sequence[bytes]) -> list[tuple[int, int]]:
    """First plane and the one after the last of each frame, in order.

    The cheapest division into runs by the entropy of their bytes and what frames cost beside; a run
    of several planes is no longer than a block.
    """
    n = len(planes)
    sizes = np.cumsum([0, *map(len, planes)])
    counts = np.zeros((n + 1, 256))
    for k, plane in enumerate(planes):
        counts[k + 1] = counts[k] + np.bincount(np.frombuffer(plane, np.uint8), minlength=256)
    least, begins = np.zeros(n + 1), np.zeros(n + 1, np.int64)
    for end in range(1, n + 1):
        first = max(int(np.searchsorted(sizes, sizes[end] - MAX_BLOCK)), end - MAX_PLANES, 0)
        first = min(first, end - 1)
        of_runs = counts[end] - counts[first:end]
        costs = least[first:end] + _bytes(of_runs)
        begins[end] = first + int(np.argmin(costs))
        least[end] = costs[begins[end] - first]
    runs, end = [], n
    while end:
        runs.append((int(begins[end]), end))
        end = int(begins[end])
    return runs[::-1]


def _bytes(counts: F64) -> F64:
    """(n,) estimated bytes of frames whose contents have these counts (n, 256) of each byte."""
    total = counts.sum(1)
    bits = total * np.log2(np.maximum(total, 1)) - (counts * np.log2(np.maximum(counts, 1))).sum(1)
    found: F64 = bits / 8 + FRAME_BYTES + SYMBOL_BYTES * (counts > 0).sum(1)
    return found
