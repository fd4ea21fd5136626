"""Sizes on the command line: `5000000`, `5MB`, `1.5 MiB`, or `20%` of a file."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass

__all__ = ["Size", "parse_size"]

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9} | {
    "KIB": 1 << 10,
    "MIB": 1 << 20,
    "GIB": 1 << 30,
}
MOST = 1 << 62
FORM = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(%|[A-Za-z]*)\s*")


@dataclass(frozen=True)
class Size:
    """Bytes, or a part of a file; one of the two is None."""

    n_bytes: int | None
    part: float | None = None

    def of(self, whole: int) -> int:
        """Bytes, where the file has `whole`."""
        return round(self.part * whole) if self.part is not None else self.n_bytes or 0


def parse_size(text: str) -> Size:
    """An argparse type.

    Raises:
        argparse.ArgumentTypeError: the text is no size.
    """
    found = FORM.fullmatch(text)
    number, unit = found.groups() if found else ("", "?")
    if unit == "%" and float(number) <= 100:
        return Size(None, float(number) / 100)
    factor = UNITS.get(unit.upper())
    if factor is None or not float(number) * factor <= MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is no size: try 5000000, 5MB, 4.5MiB or 20%")
    # Digits alone are exact; a float64 is not beyond 2**53.
    return Size(int(number) if factor == 1 and number.isdigit() else round(float(number) * factor))
