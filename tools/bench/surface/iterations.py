"""Training iterations: what a run that stops early is worth, from the logs of runs."""

from __future__ import annotations

import csv
from pathlib import Path

from tools.bench.surface.fronts import better

__all__ = ["iterations"]

Rows = list[dict[str, object]]
SAVED_EVERY = 1000


def iterations(folder: Path) -> Rows:
    """PSNR of the last level of each run while it is trained.

    From `FOLDER/*/log.csv`, as `evogs train` and the queue of `python -m tools.bench.paper` write
    them: PSNR over a few held-out views. Seconds are those of the machine that ran them, others
    beside them. The last column names a run that has no less PSNR after no more iterations.
    """
    logs = {path.parent.name: _read(path) for path in sorted(folder.glob("*/log.csv"))}
    last = max(int(row["level"]) for rows in logs.values() for row in rows)
    found = [
        (run, row)
        for run, rows in logs.items()
        for row in rows
        if int(row["level"]) == last and int(row["iteration"]) % SAVED_EVERY == 0
    ]
    points = [
        (f"{run} at {row['iteration']}", float(row["iteration"]), float(row["psnr"]))
        for run, row in found
    ]
    return [
        {
            "run": run,
            "iterations": int(row["iteration"]),
            "splats": int(row["splats"]),
            "seconds": f"{float(row['seconds']):.0f}",
            "PSNR, dB": f"{float(row['psnr']):.2f}",
            "dominated by": other,
        }
        for (run, row), other in zip(found, better(points), strict=True)
    ]


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
