"""The nearest neighbours of each of many points among the others.

Letters: n points, k neighbours of each.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import scipy

from evogs_codec.common.morton import morton_order
from evogs_codec.common.parallel import parallel_map
from evogs_codec.lifting.compiled.dispatch import compiled_for
from evogs_codec.model.splats import F64, I64

__all__ = ["nearest"]

MIN_PART = 2048  # points that are worth a thread


def nearest(points: F64, k: int) -> tuple[I64, I64]:
    """The k points that are nearest to each of (n, 3): itself, most likely, and k - 1 others.

    Returns:
        The points in an order (n,) in which neighbours lie beside each other, and (n, k) places in
        that order of the neighbours of the point at each place.
    """
    loops = compiled_for(len(points))
    if loops is not None and k < len(points):
        return _compiled(loops.neighbours, points, k)
    order = morton_order(points.T)
    return order, np.concatenate(list(_of_scipy(points[order], slice(None), k)))


def _of_scipy(points: F64, rows: I64 | slice, k: int) -> Iterator[I64]:
    """(n, k) of the points in `rows`, in parts; points in Morton order take a third of the time."""
    tree = scipy.spatial.cKDTree(points)
    wanted = points[rows]
    # Not with `workers` of scipy: an interrupt frees the arrays that its threads still write to.
    parts = np.array_split(wanted, _n_parts(len(wanted)))
    return parallel_map(lambda part: tree.query(part, k=k)[1], parts)


def _compiled(neighbours: ModuleType, points: F64, k: int) -> tuple[I64, I64]:
    """`nearest` for more than k points."""
    n, depth = len(points), neighbours.depth_of(len(points))
    ordered, order = np.ascontiguousarray(points.T), np.arange(n)
    boxes = np.empty((2 << depth, 6))
    neighbours.build(ordered, order, boxes, depth)
    near, is_tied = np.empty((n, k), np.int64), np.empty(n, bool)

    def find(leaves: I64) -> None:
        if len(leaves):
            begin, end = int(leaves[0]), int(leaves[-1]) + 1
            neighbours.nearest(ordered, boxes, depth, begin, end, near, is_tied)

    leaves = np.arange(1 << depth)
    list(parallel_map(find, np.array_split(leaves, _n_parts(n))))
    tied = np.flatnonzero(is_tied)
    if len(tied):
        # Which of equally near ones are taken is for scipy to say, with and without numba.
        place = np.empty(n, np.int64)
        place[order] = np.arange(n)
        by_code = morton_order(points.T)
        theirs = np.empty(n, np.int64)
        theirs[by_code] = np.arange(n)
        found = np.concatenate(list(_of_scipy(points[by_code], theirs[order[tied]], k)))
        near[tied] = place[by_code[found]]
    return order, near


def _n_parts(n: int) -> int:
    return max(1, min(os.cpu_count() or 1, n // MIN_PART))
