"""Families of vectors that a harness makes itself from a committed one: prefixes and bit flips."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["GENERATED"]

Entry = dict[str, Any]
GENERATED: tuple[Callable[[Mapping[str, bytes]], list[Entry]], ...] = ()
