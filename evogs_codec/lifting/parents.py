"""Parents: Gaussian moments, and the point of the line through two children that suits them best.

A parent lies on the line through its children in every group: P = C1 - psi = C2 + alpha psi, so
psi = (C1 - C2) / (1 + alpha). Position and SH take the midpoint, alpha = 1: a constant alpha is
free, the midpoint's psi is the shortest, and mass-weighted positions won 0.1 dB for 0.2 bytes per
splat. Rotation takes that of C2, alpha = 0: a mean of two rotations fits neither child, and C1 then
corrects the error of its parent instead of inheriting it.
Scale and opacity choose from a small table, since a parent should cover both children, which often
lies beyond the larger child: alpha < 0. C2 is the larger of the two, so that alpha stays in
(-1, 1], and an error of psi is nowhere amplified.
The line cannot enlarge children that are alike. Where that would be seen, the parent has the shape
that the moments ask for, on no line: it is split into itself and a splat that is not seen
(`splitting`), and a refine makes them the children (`OFF_LINE`).

Letters: n Gaussians or pairs, D channels (`splats`) with rotations as (1, g) (`orientations`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from evogs_codec.common.parallel import parallel_blocks, parallel_map
from evogs_codec.lifting.compiled.dispatch import compiled_for
from evogs_codec.lifting.orientations import BLOCK, matrices, nearest_turns, turned
from evogs_codec.model.channels import GROUP_CHANNELS
from evogs_codec.model.splats import F64, I64

__all__ = [
    "ALPHAS_OPACITY",
    "ALPHAS_SCALE",
    "N_SHAPE",
    "OFF_LINE",
    "Moments",
    "cross_sections",
    "line_parents",
    "median_mass",
    "merge_pairs",
    "merged",
    "midpoints",
    "moments",
]

# Near -1 the line is stretched by 1 / (1 + alpha), and so is what it costs: none closer than 1 / 8.
# No scale between the children's (alpha > 0): cheaper, but it loses mass at every generation.
ALPHAS_SCALE = (-0.875, -0.75, -0.5, -0.25, 0.0)
ALPHAS_OPACITY = (-0.75, -0.25, 0.0, 0.25, 1.0)

# A parent too large smears over its surroundings, one too small only leaves a gap.
TOO_LARGE = 2.0
# Squared error of a log-scale that is worth a bit where the mass is that of the median splat; and
# what one of an opacity logit counts beside it.
ALPHA_PRICE = 0.03
OPACITY_WEIGHT = 0.01
N_PRICE_ROUNDS = 3  # an alpha is cheap if many take it, and many take it if it is cheap
MAX_WEIGHT = 1e6  # in masses of the median splat
# Alpha of the scale, and of the opacity, where children are on no line with their parent: a refine
# follows, and until then one child is the parent. And the misfit from which on it pays.
OFF_LINE = -1.0
CORRECTION_COST = 1000.0
MAX_OPACITY = 0.99
N_SHAPE = 10  # channels: position, rotation, log-scale
# A psi above this is no extrapolation but an odd file: such children take the midpoint.
MAX_PSI = 1e4
# Beyond, exp of twice a log-scale leaves float64 or means nothing.
MAX_LOG_SCALE = 40.0
TINY = 1e-300

_POSITION, _ROTATION, _SCALE, _OPACITY, _ = GROUP_CHANNELS


@dataclass(frozen=True, eq=False)
class Moments:
    """Mass, mean and covariance of sets of Gaussians.

    Attributes:
        mass: (n,) opacity times cross-section (`cross_sections`): how much of its background a set
            hides.
        mean: (3, n) scene units.
        cov: (3, 3, n) squared scene units.
    """

    mass: F64
    mean: F64
    cov: F64

    @staticmethod
    def empty(n: int) -> Moments:
        """Of n sets, yet to be written."""
        return Moments(np.empty(n), np.empty((3, n)), np.empty((3, 3, n)))

    def take(self, rows: I64) -> Moments:
        """The moments of `rows`."""
        mean, cov = np.take(self.mean, rows, axis=1), np.take(self.cov, rows, axis=2)
        return Moments(self.mass[rows], mean, cov)

    def part(self, begin: int, end: int) -> Moments:
        """A view of those from `begin` to `end`."""
        return Moments(self.mass[begin:end], self.mean[:, begin:end], self.cov[:, :, begin:end])

    def with_room(self, n: int) -> Moments:
        """These, and as many more as make n, which are yet to be written."""
        out = Moments.empty(n)
        own = out.part(0, len(self.mass))
        own.mass[:], own.mean[:], own.cov[:] = self.mass, self.mean, self.cov
        return out

    def followed_by(self, other: Moments) -> Moments:
        """Both, one after the other."""
        return Moments(
            np.concatenate([self.mass, other.mass]),
            np.concatenate([self.mean, other.mean], axis=1),
            np.concatenate([self.cov, other.cov], axis=2),
        )


def moments(x: F64) -> Moments:
    """Moments of the n Gaussians (D, n)."""
    found = Moments.empty(x.shape[1])

    def fill(block: slice) -> None:
        part, own = found.part(block.start, block.stop), _moments(x[:, block])
        part.mass[:], part.mean[:], part.cov[:] = own.mass, own.mean, own.cov

    parallel_blocks(fill, x.shape[1], BLOCK)
    return found


def _moments(x: F64) -> Moments:
    log_scales = _bounded(x[_SCALE])
    root = matrices(x[4:7]) * np.exp(log_scales)
    cov = np.einsum("ikn,jkn->ijn", root, root)
    return Moments(
        _sigmoid(x[10]) * _cross_sections_of_scales(log_scales), x[_POSITION].copy(), cov
    )


def merged(a: Moments, b: Moments) -> Moments:
    """Moments of the unions of a and b, one by one."""
    mass = a.mass + b.mass
    weight_a = np.divide(a.mass, mass, out=np.full_like(mass, 0.5), where=mass > 0)
    weight_b = 1 - weight_a
    d = a.mean - b.mean
    cov = weight_a * a.cov + weight_b * b.cov + weight_a * weight_b * (d[:, None] * d)
    return Moments(mass, b.mean + weight_a * d, cov)


def merge_pairs(m: Moments, a: I64, b: I64, out: Moments) -> None:
    """Write `merged` of the sets a and b of `m`."""
    loops = compiled_for(len(a))
    if loops is not None:

        def fill(block: slice) -> None:
            to = out.part(block.start, block.stop)
            loops.raising.merge(m.mass, m.mean, m.cov, a[block], b[block], to.mass, to.mean, to.cov)

        parallel_blocks(fill, len(a), BLOCK)
        return
    both = merged(m.take(a), m.take(b))
    out.mass[:], out.mean[:], out.cov[:] = both.mass, both.mean, both.cov


def median_mass(m: Moments) -> float:
    """Of the sets of Gaussians, at least `TINY`; 1 if there are none."""
    return max(float(np.median(m.mass)), TINY) if len(m.mass) else 1.0


def cross_sections(cov: F64) -> F64:
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


def line_parents(c1: F64, c2: F64, target: Moments, unit_mass: float) -> tuple[F64, F64]:
    """Parents of the pairs c1, c2 (D, n), near what `target`, the moments of their leaves, asks.

    Args:
        c1: smaller children.
        c2: larger children.
        target: n moments.
        unit_mass: of the median splat: how much is seen of what.

    Returns:
        The parents (D, n) and alpha (5, n), of which rows 2 and 3 vary. Where both are `OFF_LINE`,
        the shape of the parent is on no line, and the children are put right after the split.
    """
    n = c1.shape[1]
    alpha = np.ones((len(GROUP_CHANNELS), n))
    parent = (c1 + c2) / 2
    alpha[1] = 0.0
    parent[_ROTATION] = c2[_ROTATION]
    weight = np.minimum(target.mass / unit_mass, MAX_WEIGHT)

    variance = _variances(parent[4:7], target.cov)
    wanted = 0.5 * np.log(np.maximum(variance, TINY))
    alpha[2], cost = _best_alpha(c1[_SCALE], c2[_SCALE], wanted, ALPHAS_SCALE, weight)
    parent[_SCALE] = _on_line(c1[_SCALE], c2[_SCALE], alpha[2])

    rows = np.flatnonzero(cost > CORRECTION_COST)
    shapes = _shapes(target.take(rows), c2[:, rows])
    near = np.abs(shapes - c1[:N_SHAPE, rows]).max(axis=0, initial=0) < MAX_PSI
    alpha[2, rows[near]] = OFF_LINE
    parent[:N_SHAPE, rows[near]] = shapes[:, near]

    # The opacity that keeps the mass, given the size that the parent has.
    size = _cross_sections_of_scales(_bounded(parent[_SCALE]))
    opacity = np.clip(target.mass / np.maximum(size, TINY), 1e-12, MAX_OPACITY)
    wanted = np.log(opacity / (1 - opacity))[None]
    weight *= OPACITY_WEIGHT
    alpha[3], _ = _best_alpha(c1[_OPACITY], c2[_OPACITY], wanted, ALPHAS_OPACITY, weight)
    parent[_OPACITY] = _on_line(c1[_OPACITY], c2[_OPACITY], alpha[3])
    alpha[3, alpha[2] == OFF_LINE] = OFF_LINE
    return parent, alpha


def midpoints(values: F64, c1: I64, c2: I64, parents: F64) -> None:
    """Parents (D, n) of pairs whose channels take the midpoint, out; see `line_parents`.

    Args:
        values: (D, T) channels of nodes.
        c1: (n,) nodes.
        c2: (n,) nodes.
        parents: written.
    """
    loops = compiled_for(len(c1))
    if loops is not None:

        def fill(channel: int) -> None:
            rows = slice(channel, channel + 1)
            loops.raising.midpoints(values[rows], c1, c2, parents[rows])

        for _ in parallel_map(fill, range(len(values)), n_splats=len(c1)):
            pass
        return
    for row, to in zip(values, parents, strict=True):
        to[:] = (row[c1] + row[c2]) / 2


def _best_alpha(
    c1: F64, c2: F64, wanted: F64, alphas: Sequence[float], weight: F64
) -> tuple[F64, F64]:
    """(n,) alphas of the table, by how near the parent is to `wanted` (C, n) and by their bits.

    Returns:
        The alphas, and (n,) what they cost: misfit times `weight` (n,), bits times `ALPHA_PRICE`.
    """
    n = c1.shape[1]
    bits = np.zeros(len(alphas))
    table = np.array(alphas)
    loops = compiled_for(n)
    choose = _choose if loops is None else loops.raising.choose
    misfits_of = _misfits if loops is None else loops.raising.misfits
    misfits = np.empty((len(alphas), n))
    misfits_of(c1, c2, wanted, table, weight, TOO_LARGE, MAX_PSI, misfits)
    for _ in range(N_PRICE_ROUNDS):
        best, index = np.empty(n), np.empty(n, np.int64)
        found = np.zeros(len(alphas) + 1, np.int64)
        choose(misfits, ALPHA_PRICE * (bits - len(c1) * np.log2(1 + table)), index, best, found)
        counts = found[: len(alphas)] + 0.5
        bits = np.log2(counts.sum() / counts)
    return np.append(table, 1.0)[index], best


def _misfits(
    c1: F64, c2: F64, wanted: F64, alphas: F64, weight: F64, too_large: float, most: float, out: F64
) -> None:
    """`raising.misfits` in numpy: a squared error counts more where the parent is too large."""
    for alpha, to in zip(alphas, out, strict=True):
        parent = _on_line(c1, c2, alpha)
        error = parent - wanted
        to[:] = weight * (np.where(error > 0, too_large, 1.0) * error**2).sum(axis=0)
        to[np.abs(c1 - parent).max(axis=0) >= most] = np.inf


def _choose(misfits: F64, prices: F64, index: I64, best: F64, counts: I64) -> None:
    """`raising.choose` in numpy; `len(prices)` is the midpoint, where every entry goes too far."""
    best[:], index[:] = np.inf, len(prices)
    for k, (price, misfit) in enumerate(zip(prices, misfits, strict=True)):
        cost = misfit + price
        better = cost < best
        best[better], index[better] = cost[better], k
    counts += np.bincount(index, minlength=len(counts))


def _on_line(c1: F64, c2: F64, alpha: F64 | float) -> F64:
    """The point P of the line with c2 = P - alpha (c1 - P)."""
    return (c2 + alpha * c1) / (1 + alpha)


def _variances(g: F64, cov: F64) -> F64:
    """(3, n) variances of covariances (3, 3, n) along the axes of the rotations g (3, n)."""
    out = np.zeros((3, cov.shape[2]))
    loops = compiled_for(cov.shape[2])
    if loops is not None:
        loops.shapes.variances(g, cov, out)
        return out
    axes = matrices(g)
    for i in range(3):
        along = cov[i, 0] * axes[0] + cov[i, 1] * axes[1] + cov[i, 2] * axes[2]
        out += axes[i] * along
    return out


def _shapes(m: Moments, like: F64) -> F64:
    """(10, n) shapes of the Gaussians with these moments, written like those of `like` (D, n)."""
    variances, axes = np.linalg.eigh(m.cov.transpose(2, 0, 1))
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]  # turned, not mirrored
    quats = scipy.spatial.transform.Rotation.from_matrix(axes).as_quat(scalar_first=True).T
    log_scales = 0.5 * np.log(np.maximum(variances.T, TINY))
    turn = nearest_turns(like[4:7], like[_SCALE], quats, log_scales)
    _, g, log_scales = turned(quats, log_scales, turn)
    return np.concatenate([m.mean, np.ones((1, len(turn))), g, log_scales])


def _cross_sections_of_scales(log_scales: F64) -> F64:
    """(n,) `cross_sections` of Gaussians from their log-scales (3, n)."""
    a, b, c = np.exp(2 * log_scales)
    out: F64 = np.sqrt(a * b + a * c + b * c)
    return out


def _bounded(log_scales: F64) -> F64:
    return np.clip(log_scales, -MAX_LOG_SCALE, MAX_LOG_SCALE)


def _sigmoid(x: F64) -> F64:
    out: F64 = 1 / (1 + np.exp(-np.clip(x, -100, 100)))
    return out
