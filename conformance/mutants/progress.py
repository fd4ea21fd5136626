"""A line now and then on standard error about work that takes minutes."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

__all__ = ["told"]

SECONDS_OF_A_LINE = 60.0
T = TypeVar("T")


def told(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Pass the items on; a line a minute says how many of `total` came, and what is left."""
    begun = last = time.monotonic()
    for number, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if now - last >= SECONDS_OF_A_LINE:
            left = round((now - begun) * (total - number) / number)
            line = f"{number} of {total} {what}, {left // 60}:{left % 60:02} left"
            print(line, file=sys.stderr, flush=True)
            last = now
