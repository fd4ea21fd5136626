"""Who merges with whom: neighbours whose difference costs few bits, matched greedily.

The price of a pair is the estimated number of bits of its difference: log2(1 + |d| / (2 step)) per
channel, the steps being those of a good coarse quantiser. Prices of unlike groups add up, saturate
where a channel is hopeless anyway, and are what a codec pays. To it comes what the picture pays:
the growth, by which the merged Gaussian hides more than its two parts, and an unlike mass, where
the colour of one would be lost in the other. Splats that find only such partners wait, alone.

Letters: n nodes, e edges (candidate pairs), channel-major arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import ModuleType

import numpy as np

from evogs_codec.common.parallel import parallel_blocks, parallel_map
from evogs_codec.lifting.compiled.dispatch import compiled_for
from evogs_codec.lifting.neighbours import nearest
from evogs_codec.lifting.orientations import BLOCK, STEP_ROTATION, STEP_SCALE
from evogs_codec.lifting.parents import TINY, Moments, cross_sections, merged
from evogs_codec.model.splats import F32, F64, I64

__all__ = ["N_NEIGHBOURS", "Features", "features", "match"]

STEP_POSITION = 0.2  # in units of the median splat
STEP_OPACITY = 0.125
STEP_SH0 = 1 / 32

N_NEIGHBOURS = 8
BITS_PER_GROWTH = 6.0  # price of a doubling of the cross-section
# Doublings of the cross-section that a round of matching allows; beyond, a splat stays alone.
# At last anything goes where many are left: a tree that does not shrink is of no use either.
MAX_GROWTH = (2.0, 2.0, 2.0, 3.0, 3.0, np.inf, np.inf, np.inf)
MAX_ALONE = 0.01  # share of the nodes below which no further round is worth its time
MAX_WAITING = 0.2  # share of the nodes that may wait for better partners
BITS_PER_MASS = 2.0  # price of a doubling of the ratio of the masses beyond FREE_MASS doublings
FREE_MASS = 2.0
MAX_MASS = 7.0  # doublings; beyond, the lesser would only tint the greater
JITTER = 1e-3  # in units of the median splat
CHUNK = 1 << 16  # edges priced at a time: fits the cache
COMPILED_CHUNK = 1 << 13


@dataclass(frozen=True, eq=False)
class Features:
    """What prices are made of; each channel divided by twice its step.

    Attributes:
        points: (3, n) float64 means in units of the median splat.
        quats: (4, n) unit quaternions.
        scales: (3, n) log-scales in increasing order.
        rest: (C, n) channels that no turn of the axes changes: position, opacity, colour.
        moments: of the leaves below each node.
    """

    points: F64
    quats: F32
    scales: F32
    rest: F32
    moments: Moments


def features(x: F64, moments: Moments, unit: float) -> Features:
    """Features of the nodes (D, n); `unit` is the size of the median splat."""
    n, middle = x.shape[1], x[0:3].mean(axis=1, keepdims=True)
    points = np.empty((3, n))
    quats, scales, rest = (np.empty((rows, n), np.float32) for rows in (4, 3, 7))

    def fill(part: slice) -> None:
        own = x[:, part]
        points[:, part] = (own[0:3] - middle) / unit
        quats[:, part] = own[3:7] / np.linalg.norm(own[3:7], axis=0)
        scales[:, part] = _float32(np.sort(own[7:10], axis=0) / (2 * STEP_SCALE))
        rest[:, part] = _float32(_rest(points[:, part], own) / 2)

    parallel_blocks(fill, n, BLOCK)
    return Features(points, quats, scales, rest, moments)


def _rest(points: F64, x: F64) -> F64:
    """(7, n) `Features.rest` in steps, of some nodes (D, n)."""
    red, green, blue = x[11:14]
    chroma = red - blue
    middle = (red + blue) / 2
    colour = np.stack([(middle + green) / 2, chroma, green - middle])
    return np.concatenate([points / STEP_POSITION, x[10:11] / STEP_OPACITY, colour / STEP_SH0])


def match(f: Features, n_neighbours: int = N_NEIGHBOURS) -> tuple[I64, I64]:
    """Disjoint pairs (i, j) of nodes that are close and alike, of most nodes.

    Args:
        f: of n nodes.
        n_neighbours: candidates of each node, besides those of which it is a candidate.
    """
    n = f.points.shape[1]
    points = f.points.T + JITTER * _spread_points(n)
    prices_of = _pricer(f)
    free = np.ones(n, bool)
    taken = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    for limit in MAX_GROWTH:
        nodes = np.flatnonzero(free)
        if len(nodes) < max(2, (MAX_WAITING if limit == np.inf else MAX_ALONE) * n):
            break
        i, j = (nodes[end] for end in _edges(points[nodes], n_neighbours))
        price, growth = prices_of(i, j)
        kept = np.flatnonzero(growth <= limit)
        i, j = _greedy(i[kept], j[kept], price[kept], n)
        free[i] = free[j] = False
        taken.append((i, j))
    return np.concatenate([t[0] for t in taken]), np.concatenate([t[1] for t in taken])


def _spread_points(n: int) -> F64:
    """(n, 3) evenly spread in the unit cube.

    A k-d tree cannot divide coincident points and takes quadratic time over them; moved apart by
    this they are as good as any neighbours.
    """
    # The R3 sequence of M. Roberts: powers of the root of x**4 = x + 1.
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    out: F64 = np.modf(np.arange(n)[:, None] * steps)[0]
    return out


def _edges(points: F64, n_neighbours: int = N_NEIGHBOURS) -> tuple[I64, I64]:
    """Each node with its nearest neighbours, every pair once: (e,), (e,)."""
    n = len(points)
    order, near = nearest(points, min(n_neighbours + 1, n))
    loops = compiled_for(n)
    if loops is not None:
        found: tuple[I64, I64] = loops.matching.edges(order, near)
        return found
    start, end = np.repeat(order, near.shape[1]), order[near.ravel()]
    keys = (np.minimum(start, end) * n + np.maximum(start, end))[start != end]
    keys.sort()  # 15 times as fast as np.unique, which hashes
    i, j = np.divmod(keys[np.diff(keys, prepend=-1) > 0], n)
    return i, j


def _greedy(i: I64, j: I64, price: F32, n: int) -> tuple[I64, I64]:
    """Pairs in order of price, each of two nodes that are still free.

    An edge that is the cheapest of both its ends belongs to the greedy matching whatever the rest
    does, so all such edges are taken at once, and again with the edges that are left.
    """
    loops = compiled_for(n)
    if loops is not None:
        taken, ends = loops.matching.greedy(i, j, price, n)
        rounds = [taken[begin:end] for begin, end in pairwise(ends.tolist())]
        rows = [one[np.argsort(price[one], kind="stable")] for one in rounds]
        order = np.concatenate([np.empty(0, np.int64), *rows])
        return i[order], j[order]
    order = np.argsort(price, kind="stable")
    i, j = i[order], j[order]
    free = np.ones(n, bool)
    cheapest = np.empty(n, np.int64)
    taken = [(i[:0], j[:0])]
    while len(i):
        rank = np.arange(len(i))
        # Of repeated indices numpy keeps the last: written backwards, the cheapest edge.
        cheapest[np.stack([i, j], axis=1).ravel()[::-1]] = np.repeat(rank, 2)[::-1]
        mutual = (cheapest[i] == rank) & (cheapest[j] == rank)
        taken.append((i[mutual], j[mutual]))
        free[i[mutual]] = free[j[mutual]] = False
        left = free[i] & free[j]
        i, j = i[left], j[left]
    return np.concatenate([t[0] for t in taken]), np.concatenate([t[1] for t in taken])


def _pricer(f: Features) -> Callable[[I64, I64], tuple[F32, F32]]:
    """`_prices` of the features, compiled where that pays."""
    loops = compiled_for(f.points.shape[1])
    if loops is None:
        return partial(_prices, f)
    m = f.moments
    n = len(m.mass)
    alike, sums = np.empty((n, 14), np.float32), np.empty((n, 12))
    mass = np.log2(np.maximum(m.mass, TINY))
    loops.matching.pack(f.rest, f.scales, f.quats, m.mass, m.mean, m.cov, mass, TINY, alike, sums)
    return partial(_compiled_prices, loops.matching, alike, sums)


def _compiled_prices(
    matching: ModuleType, alike: F32, sums: F64, i: I64, j: I64
) -> tuple[F32, F32]:
    """`_prices`: all but the logarithms in compiled loops."""
    price, growth = np.empty(len(i), np.float32), np.empty(len(i), np.float32)

    def fill(part: slice) -> None:
        a, b = i[part], j[part]
        logs, sides = np.empty((11, len(a)), np.float32), np.empty((2, len(a)))
        matching.differences(a, b, alike, sums, (TINY, 2 * STEP_ROTATION), logs, sides)
        np.log2(logs, out=logs)
        np.log2(sides, out=sides)
        numbers = (BITS_PER_GROWTH, BITS_PER_MASS, FREE_MASS, MAX_MASS)
        matching.prices(a, b, sums, numbers, logs, sides, price[part], growth[part])

    chunks = [slice(at, at + COMPILED_CHUNK) for at in range(0, len(i), COMPILED_CHUNK)]
    list(parallel_map(fill, chunks))
    return price, growth


def _prices(f: Features, i: I64, j: I64) -> tuple[F32, F32]:
    """(e,) price and (e,) growth, in doublings, of the pairs of nodes i and j."""
    price = np.empty(len(i), np.float32)
    growth = np.empty(len(i), np.float32)
    size = cross_sections(f.moments.cov)
    mass = np.log2(np.maximum(f.moments.mass, TINY))
    for at in range(0, len(i), CHUNK):
        part = slice(at, at + CHUNK)
        a, b = i[part], j[part]
        growth[part] = _growth(f.moments, size, a, b)
        price[part] = _bits(f.rest[:, a] - f.rest[:, b])
        price[part] += _bits(f.scales[:, a] - f.scales[:, b])
        price[part] += _rotation_bits(f.quats[:, a], f.quats[:, b])
        price[part] += np.float32(BITS_PER_GROWTH) * np.maximum(growth[part], 0)
        unlike = np.abs(mass[a] - mass[b])
        price[part] += np.float32(BITS_PER_MASS) * np.maximum(unlike - FREE_MASS, 0)
        growth[part][unlike > MAX_MASS] = np.inf
    return price, growth


def _growth(m: Moments, size: F64, a: I64, b: I64) -> F64:
    """(e,) log2 of the cross-section of the merged Gaussian over the sum of its parts'."""
    both = merged(m.take(a), m.take(b))
    out: F64 = np.log2(cross_sections(both.cov)) - np.log2(np.maximum(size[a] + size[b], TINY))
    return out


def _bits(difference: F32) -> F32:
    """(e,) sum over the channels of log2(1 + |d|)."""
    out: F32 = np.log2(1 + np.abs(difference)).sum(axis=0)
    return out


def _rotation_bits(p: F32, q: F32) -> F32:
    """(e,) bits of the least turn from p to any equivalent of q, without asking which it is."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    x = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    y = p[0] * q[2] - p[2] * q[0] - p[3] * q[1] + p[1] * q[3]
    z = p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1]
    a, b, c, d = np.sort(np.abs(np.stack([w, x, y, z])), axis=0)
    # The turns of the cube are about axes, edges and corners (`orientations`).
    best = np.maximum(d, np.maximum((c + d) * np.float32(0.5**0.5), (a + b + c + d) / 2))
    g = np.sqrt(np.maximum(1 / (best * best) - 1, 0) / 3)
    out: F32 = 3 * np.log2(1 + g / np.float32(2 * STEP_ROTATION))
    return out


def _float32(x: F64) -> F32:
    """Rounded to float32, far values bounded so that no difference overflows."""
    out: F32 = np.clip(x, -1e37, 1e37).astype(np.float32)
    return out
