"""The bytes of a stream that came so far: any ranges, in any order, each byte once."""

from __future__ import annotations

from bisect import bisect_left
from heapq import heappop, heappush

__all__ = ["ArrivedRanges"]

MAX_NEW = 1 << 12  # bytes of ranges behind a gap that need not be in order yet


class ArrivedRanges:
    """Byte ranges that came of something that begins at 0; of what comes twice, the first.

    Ranges behind a gap wait in order, new ones in a heap first. The heap is merged when its bytes
    pass half of the others, so the time is that of sorting all ranges, whatever their order.
    """

    def __init__(self) -> None:
        self._head = bytearray()  # from 0 without a gap
        self._later: list[tuple[int, bytes]] = []  # offsets fall; none overlaps another
        self._new: list[tuple[int, bytes]] = []  # a heap; may overlap each other, but not `_later`
        self._n_later = self._n_new = 0  # bytes in these

    def put(self, at: int, data: bytes) -> None:
        """Add a range."""
        if at > len(self._head):
            self._put_later(at, data)
            return
        self._head += data[len(self._head) - at :]
        while waiting := self._next_waiting():
            at, data = waiting
            self._head += data[len(self._head) - at :]

    def covers(self, size: int) -> bool:
        """All bytes 0..size are there."""
        return len(self._head) >= size

    def prefix(self, size: int | None = None) -> bytes:
        """The bytes from 0 on without a gap, `size` of them at most."""
        with memoryview(self._head) as view:
            return bytes(view[:size])

    def all(self) -> list[tuple[int, bytes | memoryview]]:
        """Every range, with its offset."""
        return [(0, memoryview(self._head)), *self._later[::-1], *sorted(self._new)]

    def _next_waiting(self) -> tuple[int, bytes] | None:
        """Take the first range that waits, if it meets the head."""
        if self._later and self._later[-1][0] <= len(self._head):
            waiting = self._later.pop()
            self._n_later -= len(waiting[1])
            return waiting
        if self._new and self._new[0][0] <= len(self._head):
            waiting = heappop(self._new)
            self._n_new -= len(waiting[1])
            return waiting
        return None

    def _put_later(self, at: int, data: bytes) -> None:
        """Keep the parts of a range that fill gaps of `_later`."""
        end = at + len(data)
        place = bisect_left(self._later, -at, key=lambda item: -item[0])
        if place < len(self._later):
            before, there = self._later[place]
            at = max(at, before + len(there))
        while at < end:
            place -= 1  # of the next range behind `at`
            stop = min(end, self._later[place][0]) if place >= 0 else end
            if at < stop:
                heappush(self._new, (at, data[at - end :][: stop - at]))
                self._n_new += stop - at
            if stop == end:
                break
            at = stop + len(self._later[place][1])
        if self._n_new > MAX_NEW + self._n_later // 2:
            self._merge()

    def _merge(self) -> None:
        """Put the new ranges in their places, without bytes that came before, and join them."""
        merged: list[tuple[int, list[bytes]]] = []  # what touches is joined
        end = -1
        for at, data in sorted(self._later + self._new):
            if at > end:
                merged.append((at, [data]))
            elif at + len(data) > end:
                merged[-1][1].append(data[end - at :])
            end = max(end, at + len(data))
        self._later = [(at, b"".join(parts)) for at, parts in reversed(merged)]
        self._new = []
        self._n_later, self._n_new = sum(len(data) for _, data in self._later), 0
