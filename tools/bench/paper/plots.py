"""Figures; all of matplotlib is here, an extra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench.paper.report import Canvas, Rows
from tools.bench.paper.runs import TITLES

__all__ = ["bars", "curves", "grid_of_pictures", "lines", "scatter"]

WIDTH, HEIGHT = 5.2, 3.6  # inches, of one panel
COLORS = {title: f"C{k}" for k, title in enumerate(TITLES.values())}  # of matplotlib's cycle


def curves(rows: Rows) -> Canvas:
    """Quality against bytes, a panel for each coding."""
    codings = list(dict.fromkeys(row["coding"] for row in rows))
    figure, axes = _panels(len(codings))
    for axis, coding in zip(axes, codings, strict=True):
        for stream in dict.fromkeys(row["stream"] for row in rows):
            own = [r for r in rows if (r["stream"], r["coding"]) == (stream, coding)]
            axis.plot(
                [r["bytes"] / 1e6 for r in own],
                [r["PSNR, dB"] for r in own],
                marker=".",
                label=stream,
            )
        axis.set(title=coding, xlabel="MB", ylabel="PSNR, dB")
        axis.locator_params(axis="x", nbins=6)
    axes[0].legend(fontsize=8)
    return figure


def lines(
    panels: Mapping[str, Mapping[str, tuple[Sequence[float], Sequence[float]]]],
    x: str,
    y: str,
    *,
    logarithmic: bool = False,
) -> Canvas:
    """Panels by title, in each lines by name: (x, y)."""
    figure, axes = _panels(len(panels))
    for axis, (title, found) in zip(axes, panels.items(), strict=True):
        for name, (across, up) in found.items():
            axis.plot(across, up, label=name)
        axis.set(title=title, xlabel=x, ylabel=y)
        if logarithmic:
            axis.set_yscale("log")
        axis.locator_params(axis="x", nbins=6)
    axes[0].legend(fontsize=8)
    return figure


def scatter(rows: Rows) -> Canvas:
    """Quality against storage, a panel for each level."""
    levels = sorted({row["level"] for row in rows})
    figure, axes = _panels(len(levels))
    for axis, level in zip(axes, levels, strict=True):
        for method in dict.fromkeys(row["method"] for row in rows):
            own = [r for r in rows if (r["method"], r["level"]) == (method, level)]
            axis.scatter(
                [r["storage, MB"] for r in own],
                [r["PSNR, dB"] for r in own],
                color=COLORS[method],
                label=method,
            )
        axis.set(title=f"L{level}", xlabel="storage, MB", ylabel="PSNR, dB")
    axes[0].legend(fontsize=7)
    return figure


def bars(panels: Mapping[str, Mapping[str, Sequence[float]]], y: str) -> Canvas:
    """Panels by title, in each a group of bars for every level, one of each name."""
    figure, axes = _panels(len(panels))
    for axis, (title, found) in zip(axes, panels.items(), strict=True):
        for k, (name, heights) in enumerate(found.items()):
            at = np.arange(len(heights)) + (k + 0.5) / len(found) * 0.8 - 0.4
            axis.bar(at, heights, 0.8 / len(found), color=COLORS[name], label=name)
        n = max(len(heights) for heights in found.values())
        axis.set_xticks(range(n), [f"L{level}" for level in range(n)])
        axis.set(title=title, ylabel=y)
        axis.legend(fontsize=7)
    return figure


def grid_of_pictures(columns: Mapping[str, Sequence[Path | None]], names: Sequence[str]) -> Canvas:
    """Columns of PNG files by title, None for one that is missing; a name for each row."""
    from matplotlib.image import imread

    figure, axes = _figure(len(names), len(columns), 2.0, 2.05)
    for column, (title, paths) in enumerate(columns.items()):
        for row, path in enumerate(paths):
            axis = axes[row][column]
            if path is not None:
                axis.imshow(imread(path), interpolation="nearest")
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_frame_on(path is None)
            if row == 0:
                axis.set_title(title, fontsize=9)
            if column == 0:
                axis.set_ylabel(names[row], fontsize=9)
    return figure


def _panels(n: int) -> tuple[Any, list[Any]]:
    figure, axes = _figure(1, n, WIDTH if n < 4 else 0.75 * WIDTH, HEIGHT)
    for axis in axes[0]:
        axis.grid(alpha=0.3)
    return figure, list(axes[0])


def _figure(n_rows: int, n_columns: int, width: float, height: float) -> tuple[Any, Any]:
    # Not pyplot: it keeps figures, and wants a display where there is one.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((width * n_columns, height * n_rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(n_rows, n_columns, squeeze=False)
