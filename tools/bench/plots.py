"""Pictures of tables; all of matplotlib is here, an extra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

__all__ = ["PLOTS"]

Rows = list[dict[str, object]]
Canvas = Any  # a figure of matplotlib
Axis = Any
WIDTH, HEIGHT = 5.2, 3.9  # inches, of one panel


def _trade(
    rows: Rows, x: str, y: str, *, panel: str = "", line: str, dominated: str = "", label: str = ""
) -> Canvas:
    """A panel for each value of a column, in it a line for each value of another.

    Args:
        rows: of a table.
        x: the column across, logarithmic.
        y: the column upwards.
        panel: a column, or "": one panel.
        line: a column.
        dominated: the column in which dominated points, drawn as crosses, have a name.
        label: the column that is written beside each point.
    """
    panels = list(dict.fromkeys(row[panel] for row in rows)) if panel else [""]
    lines = list(dict.fromkeys(row[line] for row in rows))
    figure, axes = _panels(len(panels))
    for axis, title in zip(axes, panels, strict=True):
        for k, name in enumerate(lines):
            own = [row for row in rows if row[line] == name and (not panel or row[panel] == title)]
            points = [(_number(row[x]), _number(row[y])) for row in own]
            crossed = [bool(dominated and row[dominated]) for row in own]
            _draw_line(axis, points, crossed, f"C{k}", str(name))
            for row, point in zip(own if label else (), points, strict=False):
                offset = {"xytext": (4, 4), "textcoords": "offset points", "fontsize": 7}
                axis.annotate(str(row[label]), point, **offset)
        _set_up(axis, title=title, xlabel=x, ylabel=y)
    if line != panel:
        axes[0].legend(fontsize=7)
    return figure


def _prefixes(rows: Rows) -> Canvas:
    """A panel for each scene, in it the curve of each order over the part of the bytes."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, axes = _panels(len(scenes))
    for axis, scene in zip(axes, scenes, strict=True):
        for row in (row for row in rows if row["scene"] == scene):
            parts = [name for name in row if name.endswith(" %")]
            across = [float(name.removesuffix(" %")) for name in parts]
            axis.plot(across, [_number(row[name]) for name in parts], ".-", label=row["order"])
        axis.set(title=scene, xlabel="% of the bytes", ylabel="PSNR, dB")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7)
    return figure


def _losses(rows: Rows) -> Canvas:
    """A panel for each scene: prefixes of each stream, and dedicated streams, over the bytes."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, axes = _panels(len(scenes))
    for axis, scene in zip(axes, scenes, strict=True):
        own = [row for row in rows if row["scene"] == scene]
        dedicated = [point for row in own if row["curve"] == "dedicated" for point in _points(row)]
        if dedicated:
            x, y = zip(*sorted(dedicated), strict=True)
            axis.plot(x, y, color="0.7", linewidth=5, label="dedicated")
        for row in own:
            if row["curve"] == "prefix":
                axis.plot(*zip(*_points(row), strict=True), ".-", label=row["stream"])
        axis.set(title=scene, xlabel="bytes a splat", ylabel="PSNR, dB")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7)
    return figure


def _streams(rows: Rows) -> Canvas:
    """A panel for each connection of the last scene: PSNR of each file over the seconds."""
    rows = [row for row in rows if row["scene"] == rows[-1]["scene"]]
    connections = list(dict.fromkeys(row["connection"] for row in rows))
    figure, axes = _panels(len(connections))
    for axis, connection in zip(axes, connections, strict=True):
        for row in (row for row in rows if row["connection"] == connection):
            times = [name for name in row if name.endswith(" s") and row[name] != ""]
            across = [float(name.removesuffix(" s")) for name in times]
            worth = [_number(row[name]) for name in times]
            axis.plot(across, worth, ".-", drawstyle="steps-post", label=row["file"])
        _set_up(axis, title=f"{rows[0]['scene']}, {connection}", xlabel="s", ylabel="PSNR, dB")
    axes[0].legend(fontsize=7)
    return figure


def _points(row: dict[str, object]) -> list[tuple[float, float]]:
    """Bytes a splat and dB, where there is a number."""
    whole = _number(row["bytes a splat"])
    parts = [name for name in row if name.endswith(" %") and row[name] != ""]
    return [(whole * _number(p.removesuffix(" %")) / 100, _number(row[p])) for p in parts]


def _draw_line(
    axis: Axis,
    points: Sequence[tuple[float, float]],
    crossed: Sequence[bool],
    color: str,
    name: str,
) -> None:
    """A thin line; its points are dots, or crosses."""
    if points:
        axis.plot(*zip(*sorted(points), strict=True), color=color, linewidth=0.8, alpha=0.6)
    for is_cross, marker in ((False, "o"), (True, "x")):
        some = [point for point, cross in zip(points, crossed, strict=True) if cross == is_cross]
        if some:
            axis.plot(*zip(*some, strict=True), marker, color=color, markersize=5, label=name)
            name = "_"  # once in the legend


def _set_up(axis: Axis, **texts: object) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set(xscale="log", **texts)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3)


def _number(cell: object) -> float:
    return float(str(cell))


def _panels(n: int) -> tuple[Any, list[Axis]]:
    # Not pyplot: it keeps figures, and wants a display where there is one.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((WIDTH * n, HEIGHT), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(1, n, squeeze=False)[0])


PLOTS: dict[str, Callable[[Rows], Canvas]] = {
    "surface": partial(
        _trade, x="bytes a splat", y="PSNR, dB", panel="scene", line="axis", dominated="smaller"
    ),
    "surface-effort": partial(
        _trade, x="write, s", y="to the default", panel="scene", line="scene",
        dominated="dominated by", label="--effort",
    ),
    "surface-iterations": partial(_trade, x="iterations", y="PSNR, dB", line="run"),
    "prefix": _prefixes,
    "loss-curves": _losses,
    "stream-curves": _streams,
}  # fmt: skip
