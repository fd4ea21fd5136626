"""Arithmetic of byte ranges: (begin, end) pairs, in order, without overlap."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

__all__ = ["Range", "length", "merged", "pieces", "without"]

Range: TypeAlias = tuple[int, int]


def merged(ranges: Iterable[Range], gap: int = 0) -> list[Range]:
    """The same bytes in order; ranges with at most `gap` bytes between them become one."""
    found: list[Range] = []
    for begin, end in sorted(ranges):
        if begin >= end:
            continue
        if found and begin <= found[-1][1] + gap:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return found


def without(ranges: list[Range], others: list[Range]) -> list[Range]:
    """The bytes of `ranges` that are in none of `others`; both are in order, as the result is."""
    found: list[Range] = []
    first = 0
    for begin, end in ranges:
        while first < len(others) and others[first][1] <= begin:
            first += 1
        at = first
        while at < len(others) and others[at][0] < end:
            if begin < others[at][0]:
                found.append((begin, others[at][0]))
            begin = max(begin, others[at][1])
            at += 1
        if begin < end:
            found.append((begin, end))
    return found


def pieces(ranges: Iterable[Range], size: int) -> list[Range]:
    """The same ranges in pieces of at most `size` bytes."""
    return [(at, min(at + size, end)) for begin, end in ranges for at in range(begin, end, size)]


def length(ranges: Iterable[Range]) -> int:
    """How many bytes they have."""
    return sum(end - begin for begin, end in ranges)
