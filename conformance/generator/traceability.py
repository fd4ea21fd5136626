"""What the spec requires, and which requirements no vector exercises."""

from __future__ import annotations

import csv
import re
from pathlib import Path

__all__ = ["fault_codes", "limitations", "requirements_of"]

REQUIREMENT = re.compile(r"^(?:- )?(R-[0-9.]+-[0-9]+) \[(stream|decoder|encoder)\] (.*)$", re.M)


def requirements_of(root: Path) -> dict[str, tuple[str, str]]:
    """Role and text of each requirement, in the order of the spec."""
    text = (root / "spec" / "evogs.md").read_text(encoding="utf-8")
    return {name: (role, says) for name, role, says in REQUIREMENT.findall(text)}


def limitations(root: Path) -> dict[str, str]:
    """Reason for each requirement that `LIMITATIONS.md` lists."""
    text = (root / "conformance" / "LIMITATIONS.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^\| (R-[0-9.]+-[0-9]+) \| (.+) \|$", text, re.M))


def fault_codes(root: Path) -> list[str]:
    """All fault codes."""
    with (root / "spec" / "faults.csv").open(encoding="utf-8", newline="") as file:
        return [row["code"] for row in csv.DictReader(file)]
