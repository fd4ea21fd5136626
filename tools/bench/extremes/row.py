"""`Row`: an extreme, the bound that is promised for it, what was observed, and what lies beyond."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import evogs_codec

__all__ = ["Row", "attempted", "outcome"]


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes:
        extreme: what is measured.
        bound: what is promised: an error, with its unit, or the words for exactness.
        observed: the largest error, in the same unit.
        part: observed divided by the bound; above 1 the promise is broken.
        beyond: what happens past the range of the promise.
    """

    extreme: str
    bound: str
    observed: str
    part: float
    beyond: str

    @property
    def holds(self) -> bool:
        """Whether the bound is kept."""
        return self.part <= 1

    def cells(self) -> dict[str, object]:
        """By column."""
        part = "none" if self.part == 0 else f"{self.part:.3g}"
        return {
            "extreme": self.extreme,
            "bound": self.bound,
            "observed": self.observed,
            "part of the bound": part if self.holds else f"**{part}: broken**",
            "beyond": self.beyond,
        }

    @staticmethod
    def exact(extreme: str, n_differences: int, n: int, beyond: str) -> Row:
        """A line of integers or bits that must be the same."""
        part = math.inf if n_differences else 0.0
        return Row(extreme, "exact", f"{n_differences} of {n:,} differ", part, beyond)


def _public_name(error: Exception) -> str:
    """What a caller of the codec knows the error by: the nearest class that the package exports."""
    names = (kind.__name__ for kind in type(error).__mro__)
    return next((name for name in names if name in evogs_codec.__all__), type(error).__name__)


def outcome(run: Callable[[], str]) -> str:
    """What `run` returned, or the error it ended with, or its first warning, in one line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            text = run()
        except Exception as error:
            return f"`{_public_name(error)}`: {error}"
    if caught:
        return f"`{caught[0].category.__name__}`: {caught[0].message}; {text}"
    return text


def attempted(extreme: str, bound: str, run: Callable[[], Row]) -> Row:
    """What `run` returns; a broken line where it ends with an error."""
    try:
        return run()
    except Exception as error:
        return Row(extreme, bound, f"`{type(error).__name__}`: {error}", math.inf, "")
