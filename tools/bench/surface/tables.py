"""The tables of the surface."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial

from tools.bench.subjects import subjects
from tools.bench.surface.efforts import efforts
from tools.bench.surface.iterations import iterations
from tools.bench.surface.precision import exponentials, precisions
from tools.bench.surface.streams import streams

__all__ = ["measurements"]

Rows = list[dict[str, object]]


def measurements(args: argparse.Namespace) -> Iterator[tuple[str, str, Callable[[], Rows]]]:
    """Name, title and what measures each; logs of runs only where a folder of them is given."""
    of = tuple(subjects(args))
    title = "The trade-off surface: "
    yield "surface", title + "streams", partial(streams, of)
    yield "surface-effort", title + "effort of Zstandard", partial(efforts, of)
    yield "surface-precision", title + "numbers of the rasterizer", partial(precisions, of)
    yield "surface-exponential", title + "exponential of the rasterizer", exponentials
    if args.runs:
        name = title + "training iterations"
        yield "surface-iterations", name, partial(iterations, args.runs)
