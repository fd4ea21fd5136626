"""The report: sections of tables and figures, as Markdown, CSV and PNG."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evogs_codec.io.files import write_atomic

__all__ = ["Canvas", "Figure", "Rows", "Section", "Table", "pivot", "write_report"]

Rows = list[dict[str, Any]]
Canvas = Any  # a figure of matplotlib, which is an extra
# Decimals of a number, by the end of the name of its column; others have four digits.
DECIMALS = {"dB": 2, "SSIM": 4, "LPIPS": 4, "%": 1, "MB": 2, "bytes a leaf": 2, "times": 1}


@dataclass(frozen=True)
class Table:
    """Rows of numbers: as they are in the CSV, `shown` (or the same, rounded) on the page.

    Attributes:
        name: of the CSV file.
        title: a line above it.
    """

    name: str
    title: str
    rows: Rows
    shown: Rows | None = None


@dataclass(frozen=True)
class Figure:
    """A picture.

    Attributes:
        name: of the PNG file.
        title: what it shows.
        draw: makes it.
    """

    name: str
    title: str
    draw: Callable[[], Canvas]


@dataclass(frozen=True)
class Section:
    """A part of the page; `text` says how its numbers are made, and what is missing."""

    title: str
    text: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


def write_report(path: Path, head: str, sections: Iterable[Section]) -> None:
    """The page at `path`, and its CSV and PNG files in the folder beside it of the same stem."""
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    parts = [head]
    for section in sections:
        parts += [f"## {section.title}", section.text]
        for table in section.tables:
            _write_csv(folder / f"{table.name}.csv", table.rows)
            link = f"[{table.name}.csv]({folder.name}/{table.name}.csv)"
            parts += [f"{table.title} ({link}):", "\n".join(_markdown(table.shown or table.rows))]
        for figure in section.figures:
            canvas = figure.draw()
            # Without the version of matplotlib, so that the same numbers give the same file.
            canvas.savefig(folder / f"{figure.name}.png", dpi=110, metadata={"Software": None})
            parts.append(f"![{figure.title}]({folder.name}/{figure.name}.png)")
    write_atomic(path, ("\n\n".join(part for part in parts if part) + "\n").encode())


def pivot(rows: Rows, across: str, values: Sequence[str]) -> Rows:
    """One row for all that differ in `across` alone, with a column for each value and it."""
    apart = {across, *values}
    numbers = sorted({row[across] for row in rows})
    out: dict[tuple[object, ...], dict[str, Any]] = {}
    for row in rows:
        same = {key: value for key, value in row.items() if key not in apart}
        wide = out.setdefault(
            tuple(same.values()),
            same | {f"L{number} {value}": None for value in values for number in numbers},
        )
        for value in values:
            wide[f"L{row[across]} {value}"] = row[value]
    return list(out.values())


def _write_csv(path: Path, rows: Rows) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({key: _exact(value) for key, value in row.items()})


def _exact(value: object) -> object:
    return f"{value:.9g}" if isinstance(value, float) else value


def _markdown(rows: Rows) -> list[str]:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = (_rounded(key, row.get(key)) for key in columns)
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _rounded(column: str, value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        decimals = next((n for end, n in DECIMALS.items() if column.endswith(end)), None)
        if decimals is None:
            return f"{value:.4g}"
        return f"{round(value, decimals) + 0.0:.{decimals}f}"  # -0.00 becomes 0.00
    return f"{value:,}" if isinstance(value, int) else str(value)
