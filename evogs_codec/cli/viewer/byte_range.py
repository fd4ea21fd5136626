"""The part of a file that a request asks for (RFC 9110, sections 13 and 14)."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from email.message import Message

__all__ = ["Part", "etag_of", "part_asked"]

_RANGE = re.compile(r"bytes=(\d{0,18})-(\d{0,18})")


@dataclass(frozen=True)
class Part:
    """What to answer with.

    Attributes:
        status: 200 for the whole file, 206 for a part, 304 if the client has it, 416 if there is
            no such part.
        start: the first byte.
        end: behind the last byte.
    """

    status: int
    start: int
    end: int


def etag_of(status: os.stat_result) -> str:
    """A strong validator: a file that is written again has another one."""
    return f'"{status.st_mtime_ns:x}-{status.st_size:x}"'


def part_asked(headers: Message, size: int, etag: str) -> Part:
    """The part of a file of `size` bytes that a request with these headers asks for."""
    if _names(headers.get("If-None-Match", ""), etag):
        return Part(304, 0, 0)
    whole = Part(200, 0, size)
    # A list of ranges, and what is no range, may be answered with the whole file (14.2).
    match = _RANGE.fullmatch(headers.get("Range", "").strip())
    if match is None or match.group(1) == match.group(2) == "":
        return whole
    if headers.get("If-Range", etag) != etag:
        return whole
    first, last = match.groups()
    if first == "":
        start, end = max(0, size - int(last)), size
    else:
        start, end = int(first), size if last == "" else min(int(last) + 1, size)
        if last != "" and int(last) < start:
            return whole
    return Part(206, start, end) if start < end else Part(416, 0, 0)


def _names(condition: str, etag: str) -> bool:
    tags = [tag.strip().removeprefix("W/") for tag in condition.split(",")]
    return etag in tags or tags == ["*"]
