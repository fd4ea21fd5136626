"""The 24 equivalent ways to write one Gaussian, and rotations as (1, g).

A Gaussian does not change if its axes are renamed: a proper rotation `b` of the cube, applied on
the right of the quaternion (q -> q b), and the matching permutation of the log-scales give the same
covariance; nor do the sign and the norm of q matter. A tree stores differences of neighbours, so it
pays to write neighbours alike. Rotations are written g = (x, y, z) / w: scaled so that w is 1, the
w channel of a tree is constant and costs nothing. Of the 24 one always has |g| <= 0.61.

Letters: n Gaussians, channel-major arrays; k in 0..23 an element of the cube's group, 0 the
identity; D channels, R merges, T nodes of a tree that is lifted.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from evogs_codec.common.parallel import parallel_blocks
from evogs_codec.lifting.compiled.dispatch import compiled_for
from evogs_codec.model.splats import F64, I64

__all__ = [
    "BLOCK",
    "COMPOSE",
    "MAX_G",
    "N_TURNS",
    "PERMUTE",
    "STEP_ROTATION",
    "STEP_SCALE",
    "TURNS",
    "Round",
    "consistent_turns",
    "largest_w",
    "matrices",
    "multiply",
    "nearest_turns",
    "turned",
    "unit_quats",
    "write_shape",
]

# Steps of a good coarse quantiser: what a difference is counted in.
STEP_ROTATION = 0.003
STEP_SCALE = 0.0624
MAX_G = 0.85  # no turn may move |g| beyond: far from 0 the same rotation takes more steps of g
BLOCK = 1 << 13  # Gaussians that are worked on together: fits the cache
MIN_W = 0.8  # of a unit quaternion; below, `consistent_turns` writes a node anew


@dataclass(frozen=True, eq=False)
class Round:
    """R merges: nodes c1 and c2 become the node `parent`, all (R,).

    Attributes:
        turn_c2: (R,) turn that writes c2 like c1.
        turn_parent: (R,) turn of the parent after it was formed from the two.
    """

    c1: I64
    c2: I64
    parent: I64
    turn_c2: npt.NDArray[np.uint8]
    turn_parent: npt.NDArray[np.uint8]


def multiply(p: F64, q: F64) -> F64:
    """Hamilton product of quaternions (4, n), w first; shapes broadcast."""
    a, b, c, d = p
    w, x, y, z = q
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def matrices(g: F64) -> F64:
    """(3, 3, n) rotation matrices of g (3, n), that is of the quaternions (1, g)."""
    x, y, z = g
    r = np.array(
        [
            [1 + x * x - y * y - z * z, 2 * (x * y - z), 2 * (x * z + y)],
            [2 * (x * y + z), 1 - x * x + y * y - z * z, 2 * (y * z - x)],
            [2 * (x * z - y), 2 * (y * z + x), 1 - x * x - y * y + z * z],
        ]
    )
    out: F64 = r / (1 + x * x + y * y + z * z)
    return out


def _cube_group() -> F64:
    """(24, 4) unit quaternions of the proper rotations of the cube, one of each sign."""
    half = [q for q in product((1, 0, -1), repeat=4) if sum(map(abs, q)) in (1, 2, 4)]
    # The first non-zero number positive picks the sign; the identity is the first of the list.
    ours = [q for q in half if next(filter(None, q)) > 0]
    ours.sort(key=lambda q: sum(map(abs, q)))
    table = np.array(ours, np.float64)
    out: F64 = table / np.linalg.norm(table, axis=1, keepdims=True)
    return out


def _permutations(turns: F64) -> I64:
    """(24, 3): axis i of the turned Gaussian is axis `[k, i]` of the original."""
    w, xyz = turns[:, 0], turns[:, 1:].T
    with np.errstate(divide="ignore", invalid="ignore"):
        regular = matrices(xyz / w)
    # Half turns have w = 0: R = 2 v v' - 1.
    half = 2 * np.einsum("ik,jk->ijk", xyz, xyz) - np.eye(3)[:, :, None]
    out: I64 = np.abs(np.where(w == 0, half, regular)).argmax(axis=0).T
    return out


def _composition(turns: F64) -> npt.NDArray[np.uint8]:
    """(24, 24): the element that does `[j, k]`, first j, then k."""
    both = multiply(turns.T[:, :, None], turns.T[:, None, :])
    out: npt.NDArray[np.uint8] = (
        np.abs(np.einsum("ijk,mi->mjk", both, turns)).argmax(axis=0).astype(np.uint8)
    )
    return out


TURNS = _cube_group()
N_TURNS = len(TURNS)
PERMUTE = _permutations(TURNS)
COMPOSE = _composition(TURNS)


def unit_quats(quats: F64) -> F64:
    """(4, n) quaternions of norm 1; zero becomes the identity."""
    norm = np.linalg.norm(quats, axis=0)
    identity = np.array([[1.0], [0.0], [0.0], [0.0]])
    return np.where(norm > 0, quats / np.where(norm > 0, norm, 1), identity)


def largest_w(quats: F64) -> npt.NDArray[np.uint8]:
    """(n,) the turn k after which |w| of the unit quaternions (4, n) is largest, at least 0.85."""
    # w of q b is q . conj(b).
    conjugate = TURNS * np.array([1, -1, -1, -1])
    best = np.zeros(quats.shape[1])
    turn = np.zeros(quats.shape[1], np.uint8)
    for k in range(N_TURNS):
        w = np.abs(np.einsum("i,in->n", conjugate[k], quats))  # without threads of BLAS
        # Ties are common (multiples of 90 degrees) and must not depend on rounding.
        better = w > best + 1e-9
        best[better] = w[better]
        turn[better] = k
    return turn


def turned(quats: F64, log_scales: F64, turn: npt.NDArray[np.uint8]) -> tuple[F64, F64, F64]:
    """The Gaussians written with their axes turned by `turn` (n,).

    Returns:
        w (n,) of the unit quaternions, before they are divided by it, and g and log-scales (3, n).
    """
    n = len(turn)
    loops = compiled_for(n)
    if loops is not None:
        w, g, scales = np.empty(n), np.empty((3, n)), np.empty((3, n))

        def fill(rows: slice) -> None:
            loops.shapes.turned(
                quats, log_scales, TURNS, PERMUTE, turn, rows.start, rows.stop, w, g, scales
            )

        parallel_blocks(fill, n, BLOCK)
        return w, g, scales
    q = multiply(quats, TURNS[turn].T)
    w = q[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        g = q[1:] / w
    return w, g, np.take_along_axis(log_scales, PERMUTE[turn].T, axis=0)


def write_shape(x: F64, quats: F64, log_scales: F64, turn: npt.NDArray[np.uint8]) -> None:
    """Write the shape of `x` (D, n) in place: w = 1, g and log-scales of the turned Gaussians."""
    _, x[4:7], x[7:10] = turned(quats, log_scales, turn)
    x[3] = 1


def nearest_turns(
    g: F64, log_scales: F64, quats: F64, their_log_scales: F64
) -> npt.NDArray[np.uint8]:
    """Turns of some Gaussians that cost fewest bits beside others.

    Args:
        g: (3, n) rotations of the others, as written.
        log_scales: (3, n) of the others, as written.
        quats: (4, n) unit quaternions of the Gaussians to turn.
        their_log_scales: (3, n) of the Gaussians to turn.

    Returns:
        (n,) elements of the cube's group, after which |g| is below `MAX_G`.
    """
    n = g.shape[1]
    best = np.full(n, np.inf, np.float32)
    out = np.zeros(n, np.uint8)
    # 1 + |d| of every axis of one with every axis of the other; a sum of logarithms is the
    # logarithm of a product, bounded so that the product stays in float32.
    factor = 1 + np.abs(log_scales[:, None] - their_log_scales[None]) / (2 * STEP_SCALE)
    factor = np.minimum(factor, 1e8).astype(np.float32)
    unit = np.float32(1 / (2 * STEP_ROTATION))
    loops = compiled_for(n)
    if loops is not None:
        numbers = g.astype(np.float32), quats.astype(np.float32), factor
        turns = TURNS.astype(np.float32)
        loops.shapes.nearest_turns(*numbers, turns, PERMUTE, unit, MAX_G**2, out)
        return out
    w, x, y, z = quats.astype(np.float32)
    gx, gy, gz = g.astype(np.float32)
    for k in range(N_TURNS):
        a, b, c, d = TURNS[k].astype(np.float32)
        # A w of 0 gives infinities, which the bound on |g| turns away.
        with np.errstate(all="ignore"):
            r = 1 / (a * w - b * x - c * y - d * z)
            hx = (a * x + b * w + d * y - c * z) * r
            hy = (a * y + c * w + b * z - d * x) * r
            hz = (a * z + d * w + c * x - b * y) * r
            norm = hx * hx + hy * hy + hz * hz
            cost = (1 + np.abs(hx - gx) * unit) * (1 + np.abs(hy - gy) * unit)
            far = 1 + norm
            cost *= (1 + np.abs(hz - gz) * unit) * (far * far * far)  # far from 0, g is dearer
            for axis in range(3):
                cost *= factor[axis, PERMUTE[k, axis]]
            better = (norm < MAX_G**2) & (cost < best)
        best[better] = cost[better]
        out[better] = k
    return out


def consistent_turns(rounds: list[Round], shapes: F64) -> npt.NDArray[np.uint8]:
    """Pass 2 of lifting: (T,) turn of each node, on top of how pass 1 wrote it; none for roots.

    Turning a parent turns its children with it. g is a projective coordinate, so a line stays a
    line, but a child may come to lie far out, where g is coarse: it is then written anew, like the
    relative next to it.

    Args:
        rounds: of pass 1, from the leaves up.
        shapes: (10, T) geometry of all nodes, as pass 1 wrote it.
    """
    turn = np.zeros(shapes.shape[1], np.uint8)
    written = shapes[4:10].copy()
    for r in reversed(rounds):
        of_c1 = COMPOSE[r.turn_parent, turn[r.parent]]
        of_c2 = COMPOSE[r.turn_c2, of_c1]
        for child, of_child, relative in ((r.c1, of_c1, r.parent), (r.c2, of_c2, r.c1)):
            quats, log_scales = unit_quats(shapes[3:7, child]), shapes[7:10, child]
            w, g, turned_scales = turned(quats, log_scales, of_child)
            far = np.flatnonzero(np.abs(w) < MIN_W)
            beside = written[:, relative[far]]
            new = nearest_turns(beside[:3], beside[3:], quats[:, far], log_scales[:, far])
            of_child[far] = new
            _, g[:, far], turned_scales[:, far] = turned(quats[:, far], log_scales[:, far], new)
            turn[child] = of_child
            written[:3, child], written[3:, child] = g, turned_scales
    return turn
