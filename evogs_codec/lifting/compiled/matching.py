"""The loops of `pairing`: candidate pairs, what they cost, and the greedy matching.

Letters: n nodes, k neighbours, e edges.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from evogs_codec.common.compiled import jit
from evogs_codec.model.splats import F32, F64, I64

__all__ = ["differences", "edges", "greedy", "prices"]

Numbers: TypeAlias = tuple[float, ...]

_jit = jit(error_model="numpy")


@_jit
def edges(rows: I64, found: I64) -> tuple[I64, I64]:
    """Each node with its neighbours, every pair once, in order: (e,), (e,).

    Arguments, several to a line:
        rows: (n,) node at each place.
        found: (n, k) places of the neighbours of the node at each place.
    """
    n, k = found.shape
    ends = np.zeros(n + 1, np.int64)  # of the neighbours above each node
    for place in range(n):
        for at in range(k):
            low = min(rows[place], rows[found[place, at]])
            ends[low + 1] += place != found[place, at]
    for node in range(n):
        ends[node + 1] += ends[node]
    others = np.empty(ends[n], np.int64)
    filled = ends[:-1].copy()
    for place in range(n):
        for at in range(k):
            if place != found[place, at]:
                a, b = rows[place], rows[found[place, at]]
                low = min(a, b)
                others[filled[low]] = max(a, b)
                filled[low] += 1
    i, j = np.empty(ends[n], np.int64), np.empty(ends[n], np.int64)
    e = 0
    for node in range(n):
        begin, end = ends[node], ends[node + 1]
        for at in range(begin + 1, end):  # few: sorted by insertion
            other = others[at]
            while at > begin and others[at - 1] > other:
                others[at] = others[at - 1]
                at -= 1
            others[at] = other
        last = -1
        for at in range(begin, end):
            if others[at] != last:
                last = others[at]
                i[e], j[e] = node, last
                e += 1
    return i[:e].copy(), j[:e].copy()


@_jit
def pack(
    rest: F32,
    scales: F32,
    quats: F32,
    mass: F64,
    mean: F64,
    cov: F64,
    log_mass: F64,
    tiny: float,
    alike: F32,
    sums: F64,
) -> None:
    """What prices are made of, a row for each node: what belongs together lies together.

    Arguments, several to a line:
        rest, scales, quats: of the features.
        mass, mean, cov: the moments.
        log_mass: (n,) log2 of the mass.
        alike, sums: as `differences` takes them, out.
    """
    for node in range(len(mass)):
        row = alike[node]
        for c in range(7):
            row[c] = rest[c, node]
        for c in range(3):
            row[7 + c] = scales[c, node]
        for c in range(4):
            row[10 + c] = quats[c, node]
        xx, xy, xz = cov[0, 0, node], cov[0, 1, node], cov[0, 2, node]
        yy, yz, zz = cov[1, 1, node], cov[1, 2, node], cov[2, 2, node]
        own = sums[node]
        own[0] = mass[node]
        own[1], own[2], own[3] = mean[0, node], mean[1, node], mean[2, node]
        own[4], own[5], own[6], own[7], own[8], own[9] = xx, xy, xz, yy, yz, zz
        own[10] = _size(xx, xy, xz, yy, yz, zz, tiny)
        own[11] = log_mass[node]


@_jit
def _size(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float, tiny: float) -> float:
    """`parents.sizes` of one covariance."""
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    return np.sqrt(tiny if minors < tiny else minors)


@_jit
def differences(
    i: I64, j: I64, alike: F32, sums: F64, constants: Numbers, logs: F32, growth: F64
) -> None:
    """What prices take the logarithms of.

    Arguments, several to a line:
        i, j: (e,) nodes.
        alike: (n, 14) `rest` and `scales` of the features, then `quats`.
        sums: (n, 12) mass, mean, covariance (upper triangle by rows), size, log2 of the mass.
        constants: `TINY`, and what a turn is divided by.
        logs: (11, e), out.
        growth: (2, e) cross-section of the union, and sum of those of its parts, out.
    """
    one, two, three = np.float32(1), np.float32(2), np.float32(3)
    edge = np.float32(0.5**0.5)
    unit = np.float32(constants[1])
    tiny = constants[0]
    for e in range(len(i)):
        p, q = alike[i[e]], alike[j[e]]
        for c in range(10):
            logs[c, e] = one + abs(p[c] - q[c])
        pw, px, py, pz = p[10], p[11], p[12], p[13]
        qw, qx, qy, qz = q[10], q[11], q[12], q[13]
        a = abs(pw * qw + px * qx + py * qy + pz * qz)
        b = abs(pw * qx - px * qw - py * qz + pz * qy)
        c = abs(pw * qy - py * qw - pz * qx + px * qz)
        d = abs(pw * qz - pz * qw - px * qy + py * qx)
        a, b = min(a, b), max(a, b)
        c, d = min(c, d), max(c, d)
        a, c = min(a, c), max(a, c)
        b, d = min(b, d), max(b, d)
        b, c = min(b, c), max(b, c)
        best = max(d, max((c + d) * edge, (a + b + c + d) / two))
        turn = np.sqrt(max(one / (best * best) - one, np.float32(0)) / three)
        logs[10, e] = one + turn / unit

        first, second = sums[i[e]], sums[j[e]]
        mass = first[0] + second[0]
        share = first[0] / mass if mass > 0 else 0.5
        rest = 1 - share
        both = share * rest
        dx, dy, dz = first[1] - second[1], first[2] - second[2], first[3] - second[3]
        xx = share * first[4] + rest * second[4] + both * (dx * dx)
        xy = share * first[5] + rest * second[5] + both * (dx * dy)
        xz = share * first[6] + rest * second[6] + both * (dx * dz)
        yy = share * first[7] + rest * second[7] + both * (dy * dy)
        yz = share * first[8] + rest * second[8] + both * (dy * dz)
        zz = share * first[9] + rest * second[9] + both * (dz * dz)
        growth[0, e] = _size(xx, xy, xz, yy, yz, zz, tiny)
        size = first[10] + second[10]
        growth[1, e] = tiny if size < tiny else size


@_jit
def prices(
    i: I64, j: I64, sums: F64, constants: Numbers, logs: F32, growth: F64, price: F32, grown: F32
) -> None:
    """Prices and growths (e,) of edges, out, from the logarithms of `differences`.

    Arguments, several to a line:
        constants: `BITS_PER_GROWTH`, `BITS_PER_MASS`, `FREE_MASS` and `MAX_MASS`.
    """
    per_growth, per_mass, free, most = constants
    for e in range(len(i)):
        bits = logs[0, e]
        for c in range(1, 7):
            bits += logs[c, e]
        bits += (logs[7, e] + logs[8, e]) + logs[9, e]
        bits += np.float32(3) * logs[10, e]
        own = np.float32(growth[0, e] - growth[1, e])
        bits += np.float32(per_growth) * max(own, np.float32(0))
        unlike = abs(sums[i[e], 11] - sums[j[e], 11])
        price[e] = np.float32(bits + per_mass * max(unlike - free, 0.0))
        grown[e] = np.inf if unlike > most else own


@_jit
def greedy(i: I64, j: I64, price: F32, n: int) -> tuple[I64, I64]:
    """Edges that each round of `pairing._greedy` takes, and where rounds begin and end."""
    left = np.arange(len(i))
    n_left = len(i)
    cheapest = np.empty(n, np.int64)
    least = np.empty(n, np.float32)
    is_free = np.ones(n, np.bool_)
    taken, ends = np.empty(n // 2, np.int64), [0]
    n_taken = 0
    while n_left:
        for at in range(n_left):
            e = left[at]
            cheapest[i[e]] = cheapest[j[e]] = -1
        for at in range(n_left):  # in order: of equal ones the first
            e = left[at]
            for node in (i[e], j[e]):
                if cheapest[node] < 0 or price[e] < least[node]:
                    cheapest[node], least[node] = e, price[e]
        for at in range(n_left):
            e = left[at]
            if cheapest[i[e]] == e and cheapest[j[e]] == e:
                taken[n_taken] = e
                n_taken += 1
                is_free[i[e]] = is_free[j[e]] = False
        ends.append(n_taken)
        kept = 0
        for at in range(n_left):
            e = left[at]
            if is_free[i[e]] and is_free[j[e]]:
                left[kept] = e
                kept += 1
        n_left = kept
    return taken[:n_taken].copy(), np.array(ends)
