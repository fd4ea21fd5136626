"""Compiled loops of the trainer: the tree's arithmetic with its gradient, and Adam.

Every row is worked on by one thread and written by it alone, so results do not depend on the
number of threads. Letters: S slots, m records of a block, d numbers of a group.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render.compiled import parallel_kernel, prange

__all__ = ["adam", "evolve", "evolve_free", "evolve_free_gradient", "evolve_gradient", "shrink"]

Array = npt.NDArray[Any]


@parallel_kernel
def evolve(values: Array, slots: Array, first: int, psi: Array, alpha: Array) -> None:
    """C1 = P + psi into `slots` of `values` (S, d), C2 = P - alpha psi into the slots from `first`.

    `psi` is (m, d), `alpha` (m,).
    """
    for i in prange(len(slots)):
        s = slots[i]
        a = alpha[i]
        for k in range(values.shape[1]):
            p, step = values[s, k], psi[i, k]
            values[s, k] = p + step
            values[first + i, k] = p - a * step


@parallel_kernel
def evolve_gradient(
    g: Array, slots: Array, first: int, psi: Array, alpha: Array, to_psi: Array, to_alpha: Array
) -> None:
    """The gradient `g` (S, d) after `evolve` becomes the one before it; fills the other two."""
    for i in prange(len(slots)):
        s = slots[i]
        a = alpha[i]
        total = alpha.dtype.type(0)
        for k in range(g.shape[1]):
            g1, g2 = g[s, k], g[first + i, k]
            to_psi[i, k] = g1 - a * g2
            total += psi[i, k] * g2
            g[s, k] = g1 + g2
        to_alpha[i] = -total


@parallel_kernel
def evolve_free(
    values: Array, slots: Array, first: int, psi1: Array, psi2: Array, keep: float
) -> None:
    """C1 = keep P + psi1 and C2 = keep P + psi2: the paper's options B (keep 1) and A (keep 0)."""
    weight = values.dtype.type(keep)
    for i in prange(len(slots)):
        s = slots[i]
        for k in range(values.shape[1]):
            p = weight * values[s, k]
            values[s, k] = p + psi1[i, k]
            values[first + i, k] = p + psi2[i, k]


@parallel_kernel
def evolve_free_gradient(
    g: Array, slots: Array, first: int, keep: float, to_psi1: Array, to_psi2: Array
) -> None:
    """The gradient `g` (S, d) after `evolve_free` becomes the one before it; fills the others."""
    weight = g.dtype.type(keep)
    for i in prange(len(slots)):
        s = slots[i]
        for k in range(g.shape[1]):
            g1, g2 = g[s, k], g[first + i, k]
            to_psi1[i, k] = g1
            to_psi2[i, k] = g2
            g[s, k] = weight * (g1 + g2)


@parallel_kernel
def adam(
    x: Array, g: Array, m: Array, v: Array, rates: Array, b1: float, b2: float, eps: float, t: int
) -> None:
    """One step of Adam, the `t`-th (from 1), in place on `x`, `m`, `v` (n, d); `rates` is (d,)."""
    real = x.dtype.type
    one = real(1)
    beta1, beta2, tiny = real(b1), real(b2), real(eps)
    unbias1 = real(1.0 / (1.0 - b1**t))
    unbias2 = real(np.sqrt(1.0 / (1.0 - b2**t)))
    for i in prange(len(x)):
        for k in range(x.shape[1]):
            grad = g[i, k]
            first = beta1 * m[i, k] + (one - beta1) * grad
            second = beta2 * v[i, k] + (one - beta2) * grad * grad
            m[i, k] = first
            v[i, k] = second
            x[i, k] -= rates[k] * (first * unbias1) / (np.sqrt(second) * unbias2 + tiny)


@parallel_kernel
def shrink(
    x: Array, v: Array, rates: Array, quanta: Array, price: float, b2: float, eps: float, t: int
) -> None:
    """Pull `x` (n, d) towards 0 by what log2(1 + |x| / quanta) bits cost, as Adam would step.

    Nothing is pulled past 0. `v` are Adam's second moments after the `t`-th step, `quanta` (d,).
    """
    real = x.dtype.type
    tiny, nothing = real(eps), real(0)
    unbias2 = real(np.sqrt(1.0 / (1.0 - b2**t)))
    cost = real(price / np.log(2.0))
    for i in prange(len(x)):
        for k in range(x.shape[1]):
            size = abs(x[i, k])
            if size == nothing:
                continue
            slope = cost / (size + quanta[k])
            pull = rates[k] * slope / (np.sqrt(v[i, k]) * unbias2 + tiny)
            left = max(size - pull, nothing)
            x[i, k] = left if x[i, k] > nothing else -left
