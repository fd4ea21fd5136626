"""The allocator of the process: training makes and frees the same large arrays all the time."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["keep_freed_memory"]

M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4  # of mallopt in glibc
NEVER = 2**31 - 1


def keep_freed_memory() -> None:
    """Keep what is freed for the arrays to come, where the C library is glibc.

    By default it gives large arrays back to the kernel, which clears their pages anew when the next
    iteration asks for them: with 400,000 splats some 5 to 10 % of an iteration.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # musl has none
        mallopt(M_MMAP_MAX, 0)
        mallopt(M_TRIM_THRESHOLD, NEVER)
