"""Pictures of tables; all of matplotlib is here, an extra."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

__all__ = ["PLOTS"]

Rows = list[dict[str, object]]
Canvas = Any  # a figure of matplotlib
WIDTH, HEIGHT = 5.2, 3.9  # inches, of one panel


def _draw(
    rows: Rows, x: str, y: str, panel: str, line: str, dominated: str = "", *, log: bool = False
) -> Canvas:
    """A panel for each value of a column, a line for each of another; dominated points hollow."""
    from matplotlib.ticker import LogLocator, NullFormatter

    panels = list(dict.fromkeys(row[panel] for row in rows)) if panel else [""]
    figure, axes = _panels(len(panels))
    lines = list(dict.fromkeys(row[line] for row in rows))
    for axis, title in zip(axes, panels, strict=True):
        for k, name in enumerate(lines):
            own = [row for row in rows if row[line] == name and (not panel or row[panel] == title)]
            own.sort(key=lambda row: _number(row[x]))
            across, up = [_number(row[x]) for row in own], [_number(row[y]) for row in own]
            axis.plot(across, up, color=f"C{k}", linewidth=0.8, alpha=0.6)
            filled = [not (dominated and row[dominated]) for row in own]
            for full, marker in ((True, "o"), (False, "x")):
                at = [i for i, is_full in enumerate(filled) if is_full == full]
                axis.plot(
                    [across[i] for i in at],
                    [up[i] for i in at],
                    marker,
                    color=f"C{k}",
                    markersize=5,
                    label=str(name) if full or not any(filled) else None,
                )
        axis.set(title=title, xlabel=x, ylabel=y)
        if log:
            axis.set_xscale("log")
            axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3)
    handles, labels = axes[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes[0].legend(unique.values(), unique.keys(), fontsize=7)
    return figure


def _number(cell: object) -> float:
    return float(str(cell))


def _panels(n: int) -> tuple[Any, list[Any]]:
    # Not pyplot: it keeps figures, and wants a display where there is one.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((WIDTH * n, HEIGHT), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(1, n, squeeze=False)[0])


PLOTS: dict[str, Callable[[Rows], Canvas]] = {
    "surface": partial(
        _draw, x="bytes a splat", y="PSNR, dB", panel="scene", line="axis",
        dominated="smaller", log=True,
    ),
    "surface-effort": partial(
        _draw, x="write, s", y="to the default", panel="scene", line="scene",
        dominated="dominated by", log=True,
    ),
    "surface-iterations": partial(
        _draw, x="iterations", y="PSNR, dB", panel="", line="run",
    ),
}  # fmt: skip
