"""Parents: Gaussian moments, and the point of the line through two children that suits them best.

A parent has to lie on the line through its children in every group: P = C1 - psi = C2 + alpha psi,
so psi = (C1 - C2) / (1 + alpha). Position and SH take the midpoint, alpha = 1: a constant alpha is
free, the midpoint's psi is the shortest, and mass-weighted positions won 0.1 dB for 0.2 bytes per
splat. Rotation takes that of C2, alpha = 0: a mean of two rotations fits neither child, and C1 then
mends the error of its parent instead of inheriting it.
Scale and opacity choose from a small table, since a parent should cover both children, which often
lies beyond the larger child: alpha < 0. C2 is the larger of the two, so that alpha stays in
(-1, 1], and an error of psi is nowhere amplified. The line cannot enlarge children that are alike:
of the mass, free parents lose about 6 % per generation, these about 20 % (playbot).

Letters: n Gaussians or pairs, D channels (`splats`) with rotations as (1, g) (`axes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evogs_codec.axes import matrices
from evogs_codec.splats import F64, GROUP_CHANNELS, I64

__all__ = [
    "ALPHAS_OPACITY",
    "ALPHAS_SCALE",
    "Moments",
    "line_parents",
    "merged",
    "moments",
    "sizes",
]

# Near -1 the line is stretched by 1 / (1 + alpha), and so is what it costs: none closer than 1 / 8.
# No scale between the children's (alpha > 0): cheaper, but it loses mass at every generation.
ALPHAS_SCALE = (-0.875, -0.75, -0.5, -0.25, 0.0)
ALPHAS_OPACITY = (-0.75, 1.0)

# A parent too large smears over its surroundings, one too small only leaves a gap.
TOO_LARGE = 2.0
# Square of a log-scale error that is worth one bit of psi.
SCALE_PER_BIT = 0.01
MAX_OPACITY = 0.99
# A psi above this is no extrapolation but an odd file: such children take the midpoint.
MAX_PSI = 1e4
# Beyond, exp of twice a log-scale leaves float64 or means nothing.
MAX_LOG_SCALE = 40.0
TINY = 1e-300

_POSITION, _ROTATION, _SCALE, _OPACITY, _SH = GROUP_CHANNELS


@dataclass(frozen=True, eq=False)
class Moments:
    """Mass, mean and covariance of sets of Gaussians.

    Attributes:
        mass: (n,) opacity times cross-section (`sizes`): how much of its background a set hides.
        mean: (3, n) scene units.
        cov: (3, 3, n) squared scene units.
    """

    mass: F64
    mean: F64
    cov: F64

    def take(self, rows: I64) -> Moments:
        """The moments of `rows`."""
        return Moments(self.mass[rows], self.mean[:, rows], self.cov[:, :, rows])

    def followed_by(self, other: Moments) -> Moments:
        """Both, one after the other."""
        return Moments(
            np.concatenate([self.mass, other.mass]),
            np.concatenate([self.mean, other.mean], axis=1),
            np.concatenate([self.cov, other.cov], axis=2),
        )


def moments(x: F64) -> Moments:
    """Moments of the n Gaussians (D, n)."""
    log_scales = _bounded(x[_SCALE])
    root = matrices(x[4:7]) * np.exp(log_scales)
    cov = np.einsum("ikn,jkn->ijn", root, root)
    return Moments(_sigmoid(x[10]) * _cross_sections(log_scales), x[_POSITION].copy(), cov)


def merged(a: Moments, b: Moments) -> Moments:
    """Moments of the unions of a and b, one by one."""
    mass = a.mass + b.mass
    weight_a = np.divide(a.mass, mass, out=np.full_like(mass, 0.5), where=mass > 0)
    weight_b = 1 - weight_a
    d = a.mean - b.mean
    cov = weight_a * a.cov + weight_b * b.cov + weight_a * weight_b * (d[:, None] * d)
    return Moments(mass, b.mean + weight_a * d, cov)


def sizes(cov: F64) -> F64:
    """(n,) cross-section of the covariances (3, 3, n): root of the sum of the principal minors.

    With variances a, b, c this is sqrt(ab + ac + bc), whatever the axes: about the mean shadow.
    """
    minors = (
        cov[0, 0] * cov[1, 1]
        - cov[0, 1] ** 2
        + cov[0, 0] * cov[2, 2]
        - cov[0, 2] ** 2
        + cov[1, 1] * cov[2, 2]
        - cov[1, 2] ** 2
    )
    out: F64 = np.sqrt(np.maximum(minors, TINY))
    return out


def line_parents(c1: F64, c2: F64, target: Moments) -> tuple[F64, F64]:
    """Parents of the pairs c1, c2 (D, n), near what `target`, the moments of their leaves, asks.

    Returns:
        The parents (D, n) and alpha (5, n), of which rows 2 and 3 vary.
    """
    n = c1.shape[1]
    alpha = np.ones((len(GROUP_CHANNELS), n))
    parent = (c1 + c2) / 2
    alpha[1] = 0.0
    parent[_ROTATION] = c2[_ROTATION]

    axes = matrices(parent[4:7])
    variance = np.einsum("ikn,ijn,jkn->kn", axes, target.cov, axes, optimize=True)
    wanted = 0.5 * np.log(np.maximum(variance, TINY))
    alpha[2] = _best_alpha(c1[_SCALE], c2[_SCALE], wanted, ALPHAS_SCALE)
    parent[_SCALE] = _on_line(c1[_SCALE], c2[_SCALE], alpha[2])

    # The opacity that keeps the mass, given the size that the line allowed.
    size = _cross_sections(_bounded(parent[_SCALE]))
    opacity = np.clip(target.mass / np.maximum(size, TINY), 1e-12, MAX_OPACITY)
    wanted = np.log(opacity / (1 - opacity))[None]
    alpha[3] = _best_alpha(c1[_OPACITY], c2[_OPACITY], wanted, ALPHAS_OPACITY)
    parent[_OPACITY] = _on_line(c1[_OPACITY], c2[_OPACITY], alpha[3])
    return parent, alpha


def _best_alpha(c1: F64, c2: F64, wanted: F64, alphas: Sequence[float]) -> F64:
    """(n,) the alpha of the table whose parent is nearest to `wanted` (C, n) for its bits."""
    best = np.full(c1.shape[1], np.inf)
    out = np.ones(c1.shape[1])  # the midpoint, where every entry of the table goes too far
    for alpha in alphas:
        parent = _on_line(c1, c2, alpha)
        error = parent - wanted
        cost = (np.where(error > 0, TOO_LARGE, 1.0) * error**2).sum(axis=0)
        cost -= SCALE_PER_BIT * len(c1) * np.log2(1 + alpha)
        better = cost < best
        better &= np.abs(c1 - parent).max(axis=0) < MAX_PSI
        best[better] = cost[better]
        out[better] = alpha
    return out


def _on_line(c1: F64, c2: F64, alpha: F64 | float) -> F64:
    """The point P of the line with c2 = P - alpha (c1 - P)."""
    return (c2 + alpha * c1) / (1 + alpha)


def _cross_sections(log_scales: F64) -> F64:
    """(n,) `sizes` of Gaussians from their log-scales (3, n)."""
    a, b, c = np.exp(2 * log_scales)
    out: F64 = np.sqrt(a * b + a * c + b * c)
    return out


def _bounded(log_scales: F64) -> F64:
    return np.clip(log_scales, -MAX_LOG_SCALE, MAX_LOG_SCALE)


def _sigmoid(x: F64) -> F64:
    out: F64 = 1 / (1 + np.exp(-np.clip(x, -100, 100)))
    return out
