"""Lifting: a tree under an existing splat set, without photographs or training.

Neighbours are paired, each pair gets a parent, and the parents are paired again. A parent lies on
the line through its children in every group: C1 = P + psi, C2 = P - alpha psi, one alpha per group.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec import pairing
from evogs_codec.axes import COMPOSE, largest_w, matrices, turned
from evogs_codec.pairing import Features, match, morton_order, nearest_turn
from evogs_codec.splats import F32, F64, I64, SplatParams
from evogs_codec.tree import EvolutionTree, Kind, Step

__all__ = ["Lifted", "lift", "lift_with_order"]

ALPHAS_POSITION = (0.25, 0.5, 1.0)
ALPHAS_SCALE = (-0.875, -0.75, -0.5, -0.25, 0.0, 0.5, 1.0)
ALPHAS_OPACITY = (-0.75, -0.5, -0.25, 0.0, 0.5, 1.0)
OVER = 1.0
MIN_W = 0.6
MAX_LOGIT = 4.6
LAMBDA = (0.05, 0.02, 0.02)


@dataclass(frozen=True, eq=False)
class Lifted:
    tree: EvolutionTree
    leaf_of: I64


@dataclass(frozen=True, eq=False)
class Moments:
    """mass (n,), mean (3,n), cov (3,3,n) of the leaves below each node"""

    mass: F64
    mean: F64
    cov: F64

    def take(self, rows):
        return Moments(self.mass[rows], self.mean[:, rows], self.cov[:, :, rows])


def merge(a: Moments, b: Moments) -> Moments:
    mass = a.mass + b.mass
    wa = a.mass / mass
    wb = 1 - wa
    d = a.mean - b.mean
    return Moments(
        mass,
        b.mean + wa * d,
        wa * a.cov + wb * b.cov + (wa * wb) * d[:, None] * d[None],
    )


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def area(ls):
    return (np.exp(ls[0] + ls[1]) + np.exp(ls[0] + ls[2]) + np.exp(ls[1] + ls[2])) / 3


def moments_of(x: F64) -> Moments:
    r = matrices(x[4:7])
    m = r * np.exp(x[7:10])[None]
    cov = np.einsum("ikn,jkn->ijn", m, m)
    return Moments(sigmoid(x[10]) * area(x[7:10]) + 1e-300, x[0:3].copy(), cov)


def choose(d, c2, target, alphas, unit, lam):
    """best alpha per column: |P - target|^2 / unit2 + lam bits"""
    best = np.full(d.shape[1], np.inf)
    out = np.zeros(d.shape[1])
    over = OVER if len(alphas) == len(ALPHAS_SCALE) else 1.0
    for a in alphas:
        psi = d / (1 + a)
        p = c2 + a * psi
        e = (p - target) / unit
        cost = (np.where(e > 0, over, 1.0) * e * e).sum(0) - 2 * lam * np.log2(1 + a) * len(d)
        better = cost < best
        best = np.where(better, cost, best)
        out[better] = a
    return out


def line_parent(c1: F64, c2: F64, mom: Moments):
    """c (D,n) channel-major with g in 4:7 and 1 in 3."""
    d = c1 - c2
    n = d.shape[1]
    alpha = np.ones((5, n))
    size = np.exp(np.maximum(c1[7:10], c2[7:10])).mean(0)
    alpha[0] = choose(d[0:3], c2[0:3], mom.mean, ALPHAS_POSITION, size, LAMBDA[0])
    g = (c1[4:7] + c2[4:7]) / 2
    r = matrices(g)
    var = np.einsum("ikn,ijn,jkn->kn", r, mom.cov, r)
    target = 0.5 * np.log(np.maximum(var, 1e-300))
    alpha[2] = choose(d[7:10], c2[7:10], target, ALPHAS_SCALE, 1.0, LAMBDA[1])
    p = np.empty_like(c1)
    for k, s in enumerate((slice(0, 3), slice(3, 7), slice(7, 10))):
        p[s] = c2[s] + alpha[k] / (1 + alpha[k]) * d[s]
    o = np.clip(mom.mass / area(p[7:10]), 1e-12, sigmoid(MAX_LOGIT))
    target = np.log(o / (1 - o))[None]
    alpha[3] = choose(d[10:11], c2[10:11], target, ALPHAS_OPACITY, 1.0, LAMBDA[2])
    p[10] = c2[10] + alpha[3] / (1 + alpha[3]) * d[10]
    p[11:] = c2[11:] + 0.5 * d[11:]
    return p, alpha


def lift(
    splats: SplatParams, n_levels: int = 5, *, progress: Callable[[float], None] | None = None
) -> EvolutionTree:
    return lift_with_order(splats, n_levels, progress=progress).tree


def features_of(x: F64, unit: float, mom) -> Features:
    q = np.concatenate([x[3:4], x[4:7]])
    q = q / np.linalg.norm(q, axis=0)
    sh = x[11:14]
    co = sh[0] - sh[2]
    t = sh[2] + co / 2
    cg = sh[1] - t
    y = t + cg / 2
    rest = np.concatenate(
        [
            x[0:3] / (2 * pairing.STEP_POSITION * unit),
            x[10:11] / (2 * pairing.STEP_OPACITY),
            np.stack([y, co, cg]) / (2 * pairing.STEP_SH),
        ]
    )
    return Features(
        np.ascontiguousarray(x[0:3].T),
        q.astype(np.float32),
        (x[7:10] / (2 * pairing.STEP_SCALE)).astype(np.float32),
        rest.astype(np.float32),
        mom.mass,
        mom.cov[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].astype(np.float32),
        e2(mom.cov).astype(np.float32),
    )


def e2(c):
    return np.sqrt(
        np.maximum(
            c[0, 0] * c[1, 1]
            - c[0, 1] ** 2
            + c[0, 0] * c[2, 2]
            - c[0, 2] ** 2
            + c[1, 1] * c[2, 2]
            - c[1, 2] ** 2,
            1e-38,
        )
    )


def lift_with_order(splats, n_levels=5, *, progress=None) -> Lifted:
    import time

    T = time.time()
    n = len(splats)
    x = splats.channels().astype(np.float64)
    norm = np.linalg.norm(x[3:7], axis=0)
    quats = np.where(
        norm > 0, x[3:7] / np.where(norm > 0, norm, 1), np.array([[1.0], [0], [0], [0]])
    )
    scales = x[7:10].copy()
    leaf_turn = largest_w(quats)
    w, x[4:7], x[7:10] = turned(quats, scales, leaf_turn)
    x[3] = 1
    unit = float(np.exp(np.median(scales.mean(0)))) if n else 1.0
    # pass 1
    cur = x[:14]
    mom = moments_of(cur)
    ids = np.arange(n)
    rounds = []
    hints = [(x[:10].copy(), ids)]
    total = n
    for _ in range(n_levels - 1):
        i, j = match(features_of(cur, unit, mom))
        swap = mom.mass[i] > mom.mass[j]
        i, j = np.where(swap, j, i), np.where(swap, i, j)
        o = np.argsort(i)
        i, j = i[o], j[o]
        q = cur[3:7, j] / np.linalg.norm(cur[3:7, j], axis=0)
        turn_j = nearest_turn(cur[4:7, i], cur[7:10, i], q, cur[7:10, j])
        c2 = cur[:, j].copy()
        _, c2[4:7], c2[7:10] = turned(q, cur[7:10, j], turn_j)
        pm = merge(mom.take(i), mom.take(j))
        p, _ = line_parent(cur[:, i], c2, pm)
        q = p[3:7] / np.linalg.norm(p[3:7], axis=0)
        turn_p = largest_w(q)
        _, p[4:7], p[7:10] = turned(q, p[7:10], turn_p)
        pid = total + np.arange(len(i))
        total += len(i)
        rounds.append((ids[i], ids[j], pid, turn_j, turn_p))
        hints.append((p[:10], pid))
        alone = np.ones(len(ids), bool)
        alone[i] = alone[j] = False
        print(f"  n={len(ids)} matched={2 * len(i) / max(1, len(ids)):.4f} t={time.time() - T:.1f}")
        cur = np.concatenate([cur[:, alone], p], axis=1)
        mm = mom.take(alone)
        mom = Moments(
            np.concatenate([mm.mass, pm.mass]),
            np.concatenate([mm.mean, pm.mean], 1),
            np.concatenate([mm.cov, pm.cov], 2),
        )
        ids = np.concatenate([ids[alone], pid])
    # pass 2
    frame = np.zeros(total, np.uint8)
    local = np.empty((10, total))
    for l, k in hints:
        local[:, k] = l[:10]
    final = np.empty((6, total))
    final[:, ids] = local[4:10, ids]
    nbad = 0
    for c1, c2, p, tj, tp in reversed(rounds):
        frame[c1] = COMPOSE[tp, frame[p]]
        frame[c2] = COMPOSE[COMPOSE[tj, tp], frame[p]]
        for c, ref in ((c1, p), (c2, c1)):
            q = local[3:7, c] / np.linalg.norm(local[3:7, c], axis=0)
            w, g, s = turned(q, local[7:10, c], frame[c])
            bad = np.abs(w) < MIN_W
            nbad += bad.sum()
            f = nearest_turn(
                final[:3, ref[bad]], final[3:, ref[bad]], q[:, bad], local[7:10, c[bad]]
            )
            frame[c[bad]] = f
            _, g[:, bad], s[:, bad] = turned(q[:, bad], local[7:10, c[bad]], f)
            final[:3, c], final[3:, c] = g, s
    turn = COMPOSE[leaf_turn, frame[:n]]
    _, x[4:7], x[7:10] = turned(quats, scales, turn)
    print(
        "  far",
        nbad / total,
        np.quantile(np.linalg.norm(x[4:7], axis=0), [0.5, 0.9, 0.99, 0.999, 1]).round(2),
    )
    # pass 3
    mom = moments_of(x)
    v = np.empty((len(x), total))
    v[:, :n] = x
    M = Moments(np.empty(total), np.empty((3, total)), np.empty((3, 3, total)))
    M.mass[:n], M.mean[:, :n], M.cov[:, :, :n] = mom.mass, mom.mean, mom.cov
    alphas = []
    for c1, c2, p, *_ in rounds:
        pm = merge(M.take(c1), M.take(c2))
        M.mass[p], M.mean[:, p], M.cov[:, :, p] = pm.mass, pm.mean, pm.cov
        v[:, p], a = line_parent(v[:, c1], v[:, c2], pm)
        alphas.append(a)
    # tree
    roots = ids[morton_order(np.ascontiguousarray(v[0:3, ids].T))]
    slot = np.full(total, -1)
    slot[roots] = np.arange(len(roots))
    used = len(roots)
    steps = [Step.of_adds(0, v[:, roots].astype(np.float32))]
    node_of = list(roots)
    order = roots
    for level, ((c1, c2, p, *_), a) in enumerate(zip(reversed(rounds), reversed(alphas)), 1):
        o = np.argsort(slot[p])
        c1, c2, p, a = c1[o], c2[o], p[o], a[:, o]
        psi = (v[:, c1] - v[:, p]).astype(np.float32)
        steps.append(
            Step(
                level,
                slot[p].astype(np.int32),
                np.full(len(p), Kind.SPLIT, np.uint8),
                psi,
                a.astype(np.float32),
                np.empty((len(x), 0), np.float32),
            )
        )
        order = np.concatenate([order, c2])
        order[slot[p]] = c1
        slot[c1] = slot[p]
        slot[c2] = used + np.arange(len(c2))
        used += len(c2)
    print(f"  total t={time.time() - T:.1f}")
    return Lifted(EvolutionTree(splats.sh_degree, tuple(steps)), order)
