"""Work that is the same for many things, in parallel; the heavy parts of it release the GIL."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["MIN_THREADED", "parallel_blocks", "parallel_map"]

MIN_THREADED = 10_000  # splats below which threads take longer to start than to work

T = TypeVar("T")
R = TypeVar("R")


def parallel_map(
    function: Callable[[T], R], arguments: Iterable[T], *, n_splats: int = MIN_THREADED
) -> Iterator[R]:
    """`map(function, arguments)` in as many threads as there are processors.

    Few splats, `n_splats` in all, are done in this thread, in order.
    """
    todo = list(arguments)
    if len(todo) < 2 or n_splats < MIN_THREADED:
        yield from map(function, todo)
        return
    with ThreadPoolExecutor(min(len(todo), os.cpu_count() or 1)) as pool:
        yield from pool.map(function, todo)


def parallel_blocks(function: Callable[[slice], None], n_splats: int, size: int) -> None:
    """`function` of blocks of up to `size` splats that follow each other, as `parallel_map`."""
    blocks = [slice(at, min(at + size, n_splats)) for at in range(0, n_splats, size)]
    for _ in parallel_map(function, blocks, n_splats=n_splats):
        pass
