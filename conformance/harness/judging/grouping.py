"""Runs in the file of fingerprints: by vector and by what came, since ids of runs are long."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["grouped", "ungrouped"]


def grouped(of_runs: Mapping[str, str]) -> dict[str, dict[str, list[int]]]:
    """{"core-x#0": "1:-", "core-x#2": "1:-"} as {"core-x": {"1:-": [0, 2]}}."""
    groups: dict[str, dict[str, list[int]]] = {}
    for run, came in of_runs.items():
        vector, _, number = run.rpartition("#")
        groups.setdefault(vector, {}).setdefault(came, []).append(int(number))
    return groups


def ungrouped(of_vectors: Mapping[str, Mapping[str, list[int]]]) -> dict[str, str]:
    """The same, back."""
    return {
        f"{vector}#{number}": came
        for vector, groups in of_vectors.items()
        for came, numbers in groups.items()
        for number in numbers
    }
