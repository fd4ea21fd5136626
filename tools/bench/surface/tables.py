"""The tables of the surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from tools.bench.subjects import Subject
from tools.bench.surface.efforts import efforts
from tools.bench.surface.iterations import iterations
from tools.bench.surface.precision import exponentials, precisions
from tools.bench.surface.streams import streams

__all__ = ["measurements"]

Rows = list[dict[str, object]]


def measurements(
    of: Sequence[Subject], runs: Path | None
) -> Iterator[tuple[str, str, Callable[[], Rows]]]:
    """Name, title and what measures each; logs of runs only where a folder of them is given."""
    title = "The trade-off surface: "
    yield "surface", title + "streams", partial(streams, of)
    yield "surface-effort", title + "effort of Zstandard", partial(efforts, of)
    yield "surface-precision", title + "numbers of the rasterizer", partial(precisions, of)
    yield "surface-exponential", title + "exponential of the rasterizer", exponentials
    if runs:
        name = title + "training iterations"
        yield "surface-iterations", name, partial(iterations, runs)
