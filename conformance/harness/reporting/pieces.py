"""Pieces of a stream: bytes with a name and a value, cut off one after the other."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

__all__ = ["Fields", "Piece", "Reader"]

Fields = tuple[tuple[str, str], ...]  # name and form of each, as `struct` has them


@dataclass(frozen=True)
class Piece:
    """Bytes with a meaning.

    Attributes:
        at: offset in the file.
        raw: the bytes.
        name: the field, by the words of the spec.
        value: what it says.
        remark: what is wrong with it, or is not obvious.
        starts: the structure that begins here, by which faults are placed; "" in its middle.
    """

    at: int
    raw: bytes
    name: str
    value: str = ""
    remark: str = ""
    starts: str = ""


class Reader:
    """Cuts pieces off a stream, as far as there are bytes; `at` is where it is."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def take(
        self, end: int, name: str, value: str = "", remark: str = "", starts: str = ""
    ) -> Piece:
        """The bytes up to `end`, as far as there are any."""
        end = min(end, len(self.data))
        piece = Piece(self.at, self.data[self.at : end], name, value, remark, starts)
        self.at = end
        return piece

    def fields(
        self, fields: Fields, prefix: str, end: int, found: dict[str, tuple[int, ...]]
    ) -> Iterator[Piece]:
        """The fields of a structure, one piece each, as far as they are there; kept in `found`."""
        for name, form in fields:
            stop = self.at + struct.calcsize(f"<{form}")
            if stop > min(end, len(self.data)):
                if self.at < min(end, len(self.data)):
                    yield self.take(end, prefix + name, "", "cut short")
                return
            values = struct.unpack_from(f"<{form}", self.data, self.at)
            found[name] = values
            yield self.take(stop, prefix + name, _show(values))


def _show(values: tuple[object, ...]) -> str:
    if isinstance(values[0], bytes):
        text = values[0]
        return repr(text.decode("latin-1")) if len(text) == 4 else ""
    return ", ".join(map(str, values))
