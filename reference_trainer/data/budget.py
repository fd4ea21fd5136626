"""A budget that threads share: together they never hold more than there is of something."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition

__all__ = ["Budget"]


class Budget:
    """So many of something.

    Attributes:
        left: what nobody holds.
    """

    def __init__(self, total: int) -> None:
        self._total = self.left = total
        self._changed = Condition()

    @contextmanager
    def holding(self, n: int) -> Iterator[None]:
        """Wait until `n` are left, and hold them; who wants more than all gets all."""
        n = min(n, self._total)
        with self._changed:
            self._changed.wait_for(lambda: self.left >= n)
            self.left -= n
        try:
            yield
        finally:
            with self._changed:
                self.left += n
                self._changed.notify_all()
