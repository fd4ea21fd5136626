"""Nearest neighbours of many points in space, each of the points with all others.

A k-d tree whose nodes halve the points at the median: node k of level l, counted from 0, has the
points from n k / 2**l up to n (k + 1) / 2**l of an order that building finds. So a node is its
number, and only boxes are stored. In an array of boxes, that node is row 2**l + k.

Letters: n points, k neighbours of each.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import F64, I64

__all__ = ["build", "depth_of", "nearest"]

_jit = jit()
LEAF = 16  # points of a leaf at most


def depth_of(n: int) -> int:
    """Levels of the tree below its root."""
    depth = 0
    while n > LEAF << depth:
        depth += 1
    return depth


@_jit
def build(points: F64, rows: I64, boxes: F64, depth: int) -> None:
    """Bring points into the order of the tree.

    Arguments, several to a line:
        points, rows: (3, n) and (n,), in place.
        boxes: (2**(depth + 1), 6) least and greatest of each axis, out.
    """
    n = points.shape[1]
    for node in range(1, 1 << depth):
        # Depth first would go through memory less often; by levels needs no stack.
        level = _level(node)
        k = node - (1 << level)
        begin, end = n * k >> level, n * (k + 1) >> level
        _bound(points, begin, end, boxes[node])
        box = boxes[node]
        axis = 0
        for other in range(1, 3):
            if box[3 + other] - box[other] > box[3 + axis] - box[axis]:
                axis = other
        _part(points, rows, axis, begin, end, n * (2 * k + 1) >> (level + 1))
    for k in range(1 << depth):
        _bound(points, n * k >> depth, n * (k + 1) >> depth, boxes[(1 << depth) + k])


@_jit
def _level(node: int) -> int:
    level = 0
    while node >> (level + 1):
        level += 1
    return level


@_jit
def _bound(points: F64, begin: int, end: int, box: F64) -> None:
    for axis in range(3):
        row = points[axis]
        low = high = row[begin]
        for at in range(begin + 1, end):
            low = min(low, row[at])
            high = max(high, row[at])
        box[axis], box[3 + axis] = low, high


@_jit
def _part(points: F64, rows: I64, axis: int, begin: int, end: int, middle: int) -> None:
    """Order points so that those before `middle` are below those from it on along the axis."""
    x, y, z = points[0], points[1], points[2]
    along = points[axis]
    low, high = begin, end - 1
    while low < high:
        a, b, c = along[low], along[(low + high) // 2], along[high]
        pivot = max(min(a, b), min(max(a, b), c))
        left, right = low, high
        while left <= right:
            while along[left] < pivot:
                left += 1
            while along[right] > pivot:
                right -= 1
            if left <= right:
                x[left], x[right] = x[right], x[left]
                y[left], y[right] = y[right], y[left]
                z[left], z[right] = z[right], z[left]
                rows[left], rows[right] = rows[right], rows[left]
                left += 1
                right -= 1
        if middle <= right:
            high = right
        elif middle >= left:
            low = left
        else:
            return


@_jit
def nearest(
    points: F64,
    boxes: F64,
    depth: int,
    first: int,
    last: int,
    found: I64,
    is_tied: npt.NDArray[np.bool_],
) -> None:
    """The k nearest of the points of leaves `first` to `last`, themselves among them.

    Arguments, several to a line:
        points, boxes: as `build` leaves them.
        found: (n, k), out, in the order of the tree.
        is_tied: (n,), out: another point is as near as the last of the k.
    """
    n, k = found.shape
    x, y, z = points[0], points[1], points[2]
    best = np.empty(k)
    which = np.empty(k, np.int64)
    apart = np.empty(LEAF)
    stack = np.empty(2 * depth + 2, np.int64)
    n_leaves = 1 << depth
    for leaf in range(first, last):
        for at in range(n * leaf >> depth, n * (leaf + 1) >> depth):
            px, py, pz = x[at], y[at], z[at]
            best[:] = np.inf
            next_best = np.inf  # of those that are not among the k
            own = n_leaves + leaf
            stack[0] = own
            top = 1
            while True:
                while top:
                    top -= 1
                    node = stack[top]
                    if not _away(boxes[node], px, py, pz) <= best[k - 1]:
                        continue
                    if node < n_leaves:
                        child = 2 * node
                        a, b = boxes[child], boxes[child + 1]
                        if _away(a, px, py, pz) < _away(b, px, py, pz):
                            stack[top], stack[top + 1] = child + 1, child
                        else:
                            stack[top], stack[top + 1] = child, child + 1
                        top += 2
                        continue
                    begin = n * (node - n_leaves) >> depth
                    end = n * (node - n_leaves + 1) >> depth
                    xs, ys, zs = x[begin:end], y[begin:end], z[begin:end]
                    for q in range(len(xs)):
                        dx, dy, dz = px - xs[q], py - ys[q], pz - zs[q]
                        apart[q] = dx * dx + dy * dy + dz * dz
                    for q in range(end - begin):
                        d = apart[q]
                        if not d < best[k - 1]:
                            next_best = min(next_best, d)
                            continue
                        next_best = min(next_best, best[k - 1])
                        place = k - 1
                        while place and best[place - 1] > d:
                            best[place], which[place] = best[place - 1], which[place - 1]
                            place -= 1
                        best[place], which[place] = d, begin + q
                    if next_best == 0 and best[k - 1] == 0:
                        own, top = 1, 0
                if own <= 1:
                    break
                stack[0] = own ^ 1
                top = 1
                own >>= 1
            is_tied[at] = not next_best > best[k - 1]
            found[at] = which


@_jit
def _away(box: F64, x: float, y: float, z: float) -> float:
    """Squared distance of a point from a box; rounded, none of its points seems nearer."""
    dx = max(box[0] - x, x - box[3], 0.0)
    dy = max(box[1] - y, y - box[4], 0.0)
    dz = max(box[2] - z, z - box[5], 0.0)
    return dx * dx + dy * dy + dz * dz
