"""Types of arguments: sizes (`5000000`, `5MB`, `20%`), numbers of a range, errors, files."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from evogs_codec.errors import InputError
from evogs_codec.model.channels import GROUPS
from evogs_codec.scene.effort import Effort
from evogs_codec.stores.urls import Url, is_url

__all__ = ["Size", "effort", "error_of_group", "number", "parse_size", "path_or_url"]

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9} | {
    "KIB": 1 << 10,
    "MIB": 1 << 20,
    "GIB": 1 << 30,
}
MAX_NUMBER = 1 << 62
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
    if factor is None or not float(number) * factor <= MAX_NUMBER:
        raise argparse.ArgumentTypeError(f"{text!r} is no size: try 5000000, 5MB, 4.5MiB or 20%")
    # Digits alone are exact; a float64 is not beyond 2**53.
    return Size(int(number) if factor == 1 and number.isdigit() else round(float(number) * factor))


def effort(text: str) -> str | int:
    """An argparse type: a name of `EFFORTS`, or a level of Zstandard.

    Raises:
        argparse.ArgumentTypeError: the text is neither.
    """
    found: str | int = int(text) if text.isdigit() else text
    try:
        Effort.of(found)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return found


def error_of_group(text: str) -> dict[str, float]:
    """An argparse type: `E`, of all groups, or `GROUP=E`."""
    name, is_of_group, number = text.rpartition("=")
    if is_of_group and name not in GROUPS:
        raise argparse.ArgumentTypeError(f"{name} is none of {', '.join(GROUPS)}")
    error = float(number)
    if not 1e-30 <= error <= 1e30:
        raise argparse.ArgumentTypeError(f"{number} is not in 1e-30..1e30")
    return {name: error} if name else dict.fromkeys(GROUPS, error)


def number(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], int | float]:
    """An argparse type for numbers of a range."""

    def parse(text: str) -> int | float:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not in {low}..{high}")
        return value

    parse.__name__ = kind.__name__
    return parse


def path_or_url(text: str) -> Path | Url:
    """An argparse type: a file on the disk, or one that is elsewhere.

    Raises:
        argparse.ArgumentTypeError: it is a URL that names no file.
    """
    try:
        return Url.parse(text) if is_url(text) else Path(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
