"""The page of coded bytes: a table of all points, BD-rates, a figure."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from tools.bench.coded.curves import distances
from tools.bench.paper.plots import lines
from tools.bench.paper.report import Canvas, Figure, Section, Table, pivot, write_report
from tools.bench.paper.runs import TITLES

__all__ = ["write_page"]

Rows = list[dict[str, Any]]
PAPER = ("evogs", "evogs-a")  # whose better one is a rival of its own


def write_page(path: Path, rows: Rows, command: str, of: str, needed: Rows, sizes: Rows) -> None:
    """The page and its files.

    Args:
        path: of the page.
        rows: a point and level each, with `method`, `distortion`, `point`, `level`, `bytes`,
            `psnr`, `splats` and `seconds`.
        command: that makes the same again.
        of: the method that the others are rivals of.
        needed: what its numbers are worth, as `worth` says it; none without a run.
        sizes: levels of trees as `at_the_next_size` has them, each with `method`.
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    head = (
        f"# PSNR against coded bytes\n\nMade by `{command}`. PSNR is on the held-out views of each"
        " level, bytes are those of a stream up to that level. Trees are trained in integers, at"
        " several distortions. Others are trained in floats and encoded at several PSNR against"
        " themselves."
    )
    points = [
        {
            "method": TITLES[row["method"]],
            "point": row["point"] if row["distortion"] is None else f"{row['distortion']:g}",
            "seconds": round(row["seconds"]),
            "level": row["level"],
            "kB": row["bytes"] / 1e3,
            "PSNR, dB": row["psnr"],
        }
        for row in rows
    ]
    shown = pivot(points, "level", ["kB", "PSNR, dB"])
    rivals: list[tuple[str, ...]] = [(name,) for name in methods if name != of]
    if all(name in methods for name in PAPER) and of not in PAPER:
        rivals.insert(0, PAPER)
    tables = [Table("points", "All points", points, shown)]
    if rivals:
        found = distances(rows, of, rivals)
        tables.append(
            Table(
                "bd-rate",
                "BD-rate, and bytes at the PSNR where they compare worst: negative is smaller",
                found,
            )
        )
    figures = [Figure("curves", "PSNR against coded bytes", partial(_figure, rows))]
    sections = [Section("Curves", "", tables, figures)]
    if needed:
        text = (
            "The tree of the middle distortion without one class of the numbers of its splits and"
            " refines, at the last level: as it is, then trained further in integers, so that its"
            " other numbers make up for them. The whole tree was trained as much further. Alphas"
            " become one for a whole level, which takes no bytes. As many bytes can go by a larger"
            " distortion, which loses what comes next; and the last column says how many bytes more"
            " the tree without the class takes than a whole tree of the same PSNR: nothing where"
            " the curve does not come as low."
        )
        table = Table("numbers", "Numbers that could go", needed)
        sections.append(Section("What numbers are worth", text, [table], []))
    if sizes:
        text = (
            "What a level of the middle distortion shows at the size of the next one, before that"
            " is there. Every picture is drawn with footprints dilated by 0.3 square pixels, which"
            " are smaller in the scene the larger the picture is. So the level is drawn once more"
            " with what it was trained with, dilated as much of the scene as at its own size. The"
            " last column enlarges photographs of its own size (bicubic)."
        )
        table = Table("sizes", "Levels at the next size", [_at_next(row) for row in sizes])
        sections.append(Section("Levels at the next size", text, [table], []))
    write_report(path, head, sections)


def _at_next(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "method": TITLES[row["method"]],
        "level": row["level"],
        "own size, dB": row["own"],
        "next size, dB": row["next"],
        "next level there, dB": row["above"],
        "less than the next level, dB": row["above"] - row["next"],
        "dilated as at its own size, dB": row["wide"],
        "then less, dB": row["above"] - row["wide"],
        "its photographs enlarged, dB": row["enlarged"],
    }


def _figure(rows: Rows) -> Canvas:
    panels: dict[str, dict[str, tuple[list[float], list[float]]]] = {}
    for level in sorted({row["level"] for row in rows}):
        panel = panels[f"L{level}"] = {}
        for method in dict.fromkeys(row["method"] for row in rows):
            own = [r for r in rows if (r["method"], r["level"]) == (method, level)]
            points = sorted((row["bytes"] / 1e3, row["psnr"]) for row in own)
            panel[TITLES[method]] = [x for x, _ in points], [y for _, y in points]
    return lines(panels, "kB", "PSNR, dB")
