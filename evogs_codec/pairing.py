"""Who merges with whom: neighbours whose difference costs few bits, matched greedily.

The price of a pair is the estimated number of bits of its difference: log2(1 + |d| / (2 step)) per
channel, the steps being those of a good coarse quantiser (`STEP_*`). Prices add up over unlike
groups, saturate where a channel is hopeless anyway, and are what a codec pays.

Letters: n nodes, e edges (candidate pairs), channel-major arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from evogs_codec.axes import N_TURNS, PERMUTE, TURNS
from evogs_codec.splats import F32, F64, I64

__all__ = ["Features", "match", "morton_order", "nearest_turn"]

# Steps of a quantiser of good quality; a position step is in units of the median splat's size.
STEP_POSITION = 0.2
STEP_ROTATION = 0.003
STEP_SCALE = 0.0624
STEP_OPACITY = 0.125
STEP_SH = 1 / 32

N_NEIGHBOURS = 12
N_EXACT = 5  # edges per node that are priced with all 24 turns
MAX_G = 1.5  # a turn may not move |g| beyond this: 1 / w would amplify errors
MAX_GROWTH = 3.0
W_GROWTH = 2.0
POW = 0.0
CHUNK = 1 << 17  # edges priced at a time, to bound memory


@dataclass(frozen=True, eq=False)
class Features:
    """What prices are made of, float32, each channel divided by twice its step.

    Attributes:
        points: (n, 3) float64 means in scene units, for the neighbour search.
        quats: (4, n) unit quaternions.
        scales: (3, n) log-scales.
        rest: (C, n) channels that no turn changes: position, opacity, colour.
    """

    points: F64
    quats: F32
    scales: F32
    rest: F32
    mass: F64
    cov: F64
    size: F64


def match(features: Features) -> tuple[I64, I64]:
    """Disjoint pairs (i, j) of nodes, close in space and alike."""
    n = len(features.points)
    free = np.ones(n, bool)
    pairs = []
    for candidates in (_near_edges, _near_edges, _near_edges, _morton_edges, _morton_edges):
        nodes = np.flatnonzero(free)
        if len(nodes) < 2:
            break
        i, j = (nodes[end] for end in candidates(features.points[nodes]))
        price, growth = _price(features, i, j, n)
        keep = growth < MAX_GROWTH
        i, j, price = i[keep], j[keep], price[keep]
        i, j = _greedy(i, j, price, n)
        free[i] = free[j] = False
        pairs.append((i, j))
    if not pairs:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])


def _near_edges(points: F64) -> tuple[I64, I64]:
    """Each node with its nearest neighbours, every pair once: (e,), (e,)."""
    n = len(points)
    k = min(N_NEIGHBOURS + 1, n)
    _, near = cKDTree(points).query(points, k=k)
    start = np.repeat(np.arange(n), k)
    end = near.ravel().astype(np.int64)
    keys = np.unique(np.minimum(start, end) * n + np.maximum(start, end))
    i, j = keys // n, keys % n
    return i[i != j], j[i != j]


def _morton_edges(points: F64) -> tuple[I64, I64]:
    """Each node with the next three in Morton order: finds what coincident points hide."""
    order = morton_order(points)
    i = np.concatenate([order[:-d] for d in (1, 2, 3)])
    j = np.concatenate([order[d:] for d in (1, 2, 3)])
    return i, j


def morton_order(points: F64) -> I64:
    """(n,) nodes along the Z curve of their bounding cube, 21 bits per axis."""
    if not len(points):
        return np.empty(0, np.int64)
    low = points.min(axis=0)
    size = max(float((points - low).max()), np.finfo(np.float64).tiny)
    cells = ((points - low) * ((2**21 - 1) / size)).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << np.uint64(axis)
    out: I64 = np.argsort(code, kind="stable")
    return out


def _spread(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Bit b of the 21 low bits moves to bit 3 b."""
    masks = (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    )
    for shift, mask in masks:
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


def _greedy(i: I64, j: I64, price: F32, n: int) -> tuple[I64, I64]:
    """Pairs in order of price, each of two nodes that are still free.

    An edge that is the cheapest of both its ends belongs to the greedy matching whatever the rest
    does, so all such edges are taken at once, and again with the edges that are left.
    """
    order = np.argsort(price, kind="stable")
    i, j = i[order], j[order]
    free = np.ones(n, bool)
    taken: list[tuple[I64, I64]] = []
    cheapest = np.empty(n, np.int64)
    while len(i):
        rank = np.arange(len(i))
        # Of repeated indices numpy keeps the last: written backwards, the cheapest edge.
        cheapest[np.stack([i, j], axis=1).ravel()[::-1]] = np.repeat(rank, 2)[::-1]
        mutual = (cheapest[i] == rank) & (cheapest[j] == rank)
        taken.append((i[mutual], j[mutual]))
        free[i[mutual]] = free[j[mutual]] = False
        keep = free[i] & free[j]
        i, j = i[keep], j[keep]
    if not taken:
        return i, j
    return np.concatenate([t[0] for t in taken]), np.concatenate([t[1] for t in taken])


def _price(features: Features, i: I64, j: I64, n: int) -> F32:
    """(e,) bits of the difference of the nodes i and j."""
    price = np.empty(len(i), np.float32)
    growth = np.empty(len(i), np.float32)
    by_size = np.sort(features.scales, axis=0)
    for at in range(0, len(i), CHUNK):
        a, b = i[at : at + CHUNK], j[at : at + CHUNK]
        bits = _bits(features.rest[:, a] - features.rest[:, b])
        bits += _bits(by_size[:, a] - by_size[:, b])
        bits += _rotation_bits(features.quats[:, a], features.quats[:, b])
        grow = _growth(features, a, b)
        growth[at : at + CHUNK] = grow
        price[at : at + CHUNK] = bits + W_GROWTH * np.maximum(grow, 0)
    return price, growth


def _growth(f: Features, a: I64, b: I64):
    """log2 of the cross-section of the merged Gaussian over the sum of its parts'"""
    wa = (f.mass[a] / (f.mass[a] + f.mass[b])).astype(np.float32)
    wb = 1 - wa
    d = (f.points[a] - f.points[b]).T.astype(np.float32)
    u = np.sqrt(wa * wb) * d
    xx, yy, zz, xy, xz, yz = wa * f.cov[:, a] + wb * f.cov[:, b]
    xx = xx + u[0] * u[0]
    yy = yy + u[1] * u[1]
    zz = zz + u[2] * u[2]
    xy = xy + u[0] * u[1]
    xz = xz + u[0] * u[2]
    yz = yz + u[1] * u[2]
    e2 = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    return 0.5 * np.log2(np.maximum(e2, 1e-38)) - np.log2(f.size[a] + f.size[b])


def _bits(scaled: F32) -> F32:
    """(e,) sum over the channels of log2(1 + |d|)."""
    out: F32 = np.log2(1 + np.abs(scaled)).sum(axis=0)
    return out


def _rotation_bits(p: F32, q: F32) -> F32:
    """(e,) bits of the smallest turn between p and any equivalent of q, without finding which."""
    w = np.abs((p * q).sum(axis=0))
    x = np.abs(p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2])
    y = np.abs(p[0] * q[2] - p[2] * q[0] - p[3] * q[1] + p[1] * q[3])
    z = np.abs(p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1])
    s = np.sort(np.stack([w, x, y, z]), axis=0)
    best = np.maximum(s[3], np.maximum((s[3] + s[2]) * 0.5**0.5, s.sum(axis=0) * 0.5))
    g = np.sqrt(np.maximum(1 / (best * best) - 1, 0) / 3)
    out: F32 = 3 * np.log2(1 + g / (2 * STEP_ROTATION))
    return out


def nearest_turn(g: F64, scales: F64, quats: F64, log_scales: F64) -> npt.NDArray[np.uint8]:
    """(n,) the turn of the Gaussians (quats, log_scales) that costs fewest bits beside (g, scales)."""
    best = np.full(g.shape[1], np.inf, np.float32)
    out = np.zeros(g.shape[1], np.uint8)
    ours = log_scales.astype(np.float32)
    theirs = scales.astype(np.float32)
    # |difference| of every axis of one with every axis of the other, as a factor 1 + |d|.
    factor = 1 + np.abs(theirs[:, None] - ours[None]) / np.float32(2 * STEP_SCALE)
    w, x, y, z = quats.astype(np.float32)
    gx, gy, gz = g.astype(np.float32)
    unit = np.float32(1 / (2 * STEP_ROTATION))
    for k in range(N_TURNS):
        a, b, c, d = (np.float32(t) for t in TURNS[k])
        with np.errstate(all="ignore"):
            r = 1 / (a * w - b * x - c * y - d * z)
            hx = (a * x + b * w + d * y - c * z) * r
            hy = (a * y + c * w + b * z - d * x) * r
            hz = (a * z + d * w + c * x - b * y) * r
            cost = (1 + np.abs(hx - gx) * unit) * (1 + np.abs(hy - gy) * unit)
            cost *= 1 + np.abs(hz - gz) * unit
            for axis in range(3):
                cost *= factor[axis, PERMUTE[k, axis]]
            cost *= (1 + hx * hx + hy * hy + hz * hz) ** POW
            better = (cost < best) & (hx * hx + hy * hy + hz * hz < MAX_G**2)
        best = np.where(better, cost, best)
        out[better] = k
    return out
