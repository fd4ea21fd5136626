"""Which points of a trade are worth nothing, because another is better in every respect."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["NOISE", "better"]

NOISE = 0.25  # of times, on a machine that others use too


def better(points: Sequence[tuple[str, float, float]], slack: float = 0.0) -> list[str]:
    """For each point the name of one that costs no more and is worth no less, or "".

    Of several the one that is worth most. A point is not better than its equals.

    Args:
        points: name, cost and worth of each.
        slack: part of the cost by which another has to be cheaper, for costs that are measured.
    """
    found = []
    for name, cost, worth in points:
        others = [
            (other_worth, -other_cost, other)
            for other, other_cost, other_worth in points
            if other != name
            and other_cost <= (1 - slack) * cost
            and other_worth >= worth
            and (other_cost, other_worth) != (cost, worth)
        ]
        found.append(max(others)[2] if others else "")
    return found
