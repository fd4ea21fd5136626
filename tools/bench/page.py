"""The page of figures, `docs/figures.md`: a section for each table, which is a CSV file too."""

from __future__ import annotations

import csv
import inspect
import sys
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from reference_trainer.runtime.hardware import machine
from tools.bench import plots

__all__ = ["Rows", "markdown", "text_of", "write"]

SCENES = "Where the scenes, photographs and trees come from: [datasets.md](datasets.md)."

Rows = list[dict[str, object]]
Table = tuple[str, str, Rows]  # title, what the reader has to know, numbers


def text_of(measure: Callable[[], Rows]) -> str:
    """What the docstring of a measurement says below its first line."""
    function = measure.func if isinstance(measure, partial) else measure
    return (inspect.getdoc(function) or "").partition("\n\n")[2].replace("\n", " ")


def write(out: Path, command: str, tables: dict[str, Table], *, keep_others: bool) -> None:
    """One CSV file per table, a picture of some, and a page with all of them in `out`.

    Args:
        out: folder of the page.
        command: what made the tables.
        tables: by the name of their files.
        keep_others: leave the sections of other tables as they are.
    """
    (out / "figures").mkdir(parents=True, exist_ok=True)
    path = out / "figures.md"
    made = f"Made by `{command}` on {machine()}."
    keep_others = keep_others and path.exists()
    head, sections = _read_page(path) if keep_others else (f"# Figures\n\n{made}\n\n{SCENES}", {})
    for name, (title, text, rows) in tables.items():
        _write_csv(out / "figures" / f"{name}.csv", rows)
        parts = [made if keep_others else "", text, "\n".join(markdown(rows))]
        if name in plots.PLOTS:
            parts.append(_picture(out / "figures" / f"{name}.png", title, rows))
        sections[title] = "\n\n".join(part for part in parts if part)
    body = [f"## {title}\n\n{text}" for title, text in sections.items()]
    path.write_text("\n\n".join([head, *body]) + "\n", encoding="utf-8")


def markdown(rows: Rows) -> list[str]:
    """Lines of a table."""
    head = list(rows[0])
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(str(row[key]) for key in head) + " |" for row in rows]


def _read_page(path: Path) -> tuple[str, dict[str, str]]:
    """What stands before the first section, and the text below each title."""
    head, *sections = path.read_text(encoding="utf-8").split("\n## ")
    titled = (section.split("\n", 1) for section in sections)
    return head.strip(), {title: text.strip() for title, text in titled}


def _write_csv(path: Path, rows: Rows) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _picture(path: Path, title: str, rows: Rows) -> str:
    """A line that shows the picture of a table; without matplotlib the old picture stays."""
    if find_spec("matplotlib") is None:
        print(f"{path.name} is not drawn: pip install -e '.[bench]'", file=sys.stderr)
    else:
        # Without the version of matplotlib, so that the same numbers give the same file.
        plots.PLOTS[path.stem](rows).savefig(path, dpi=90, metadata={"Software": None})
    return f"![{title}](figures/{path.name})"
