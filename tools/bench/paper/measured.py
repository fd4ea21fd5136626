"""What all sections share: the runs, the views, and numbers that are measured once and kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evogs_codec.io.files import write_atomic
from evogs_codec.io.json_files import read_json
from tools.bench.paper.runs import Run, Views

__all__ = ["Bench"]

Json = Any
VERSION = 2  # of what is measured; a change of it forgets all that was kept


@dataclass(frozen=True, eq=False)
class Bench:
    """The material of a report.

    Attributes:
        runs: finished ones.
        views: what they are measured on.
        kept: folder of measurements, one JSON file each.
        say: told what is being measured.
    """

    runs: list[Run]
    views: Views
    kept: Path
    say: Callable[[str], None]

    def of(self, budget: str, method: str) -> list[Run]:
        """All seeds of a method."""
        return [run for run in self.runs if (run.budget, run.method) == (budget, method)]

    def first(self, budget: str, method: str) -> Run | None:
        """The first seed of a method, for what is measured once."""
        return next(iter(self.of(budget, method)), None)

    def measure(
        self, run: Run, what: str, function: Callable[[Run], object], depends: object = None
    ) -> Json:
        """What `function` gives for a run, as JSON has it.

        It is read from the file of an earlier call if the tree, the views and what else it
        `depends` on are the same. Changes of the code are not seen: delete the file.
        """
        path = self.kept / f"{run.folder.name}.{what}.json"
        key: dict[str, Any] = {"version": VERSION, "tree": run.sha256, "views": self.views.sha256}
        key["depends"] = repr(depends)
        if path.exists():
            found = read_json(path)
            if isinstance(found, dict) and found.get("key") == key and "value" in found:
                return found["value"]
        self.say(f"{run.folder.name}: {what}")
        value = json.loads(json.dumps(function(run)))
        self.kept.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"key": key, "value": value}, indent=1) + "\n"
        write_atomic(path, text.encode())
        return value
