"""How long work tells how far it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

__all__ = ["Progress", "no_progress"]

# Called with the name of a stage and the part of it that is done, 0 to 1; perhaps by several
# threads.
Progress: TypeAlias = Callable[[str, float], None]


def no_progress(_stage: str, _part: float) -> None:
    """The default of every `progress` argument."""
