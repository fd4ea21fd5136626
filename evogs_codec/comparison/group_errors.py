"""Errors per group of splats against others: of splats that correspond.

Letters: N splats that are compared, M splats of the reference, J candidates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evogs_codec.lifting.orientations import PERMUTE, TURNS, multiply, unit_quats
from evogs_codec.model.channels import GROUPS
from evogs_codec.model.splats import F64, I64, SplatParams

__all__ = ["GroupError", "GroupErrors", "group_errors"]

MAX_COMPARED = 200_000  # splats that are compared, evenly taken
N_TRIED = 1_000  # of them, which tell whether the order is the same
N_CANDIDATES = 8  # nearest positions, of which the splat that is most alike corresponds
SAME_ORDER = 4.0  # times the distance to the nearest: splats of one place in both are the same
UNITS = ("scene units", "degrees", "ln", "of 1", "coefficients")
MIN_DEGREES = 1e-5  # degrees, below which a cosine of 64 bits says nothing
CHUNK = 50_000  # splats whose 24 turns are in memory at a time


@dataclass(frozen=True)
class GroupError:
    """Of one group, over the splats that correspond.

    Attributes:
        group: its name.
        unit: of both numbers.
        rms: root mean square.
        largest: of all.
    """

    group: str
    unit: str
    rms: float
    largest: float


@dataclass(frozen=True)
class GroupErrors:
    """Of all groups.

    Attributes:
        matching: which splats were taken to correspond, for people.
        n_compared: splats.
        groups: in the order of `GROUPS`: distance of the positions; angle of the turn from one
            ellipsoid to the other, whatever their axes are called; logarithms of the scales;
            opacity after activation; SH coefficients, 0 where one has none.
    """

    matching: str
    n_compared: int
    groups: tuple[GroupError, ...]


def group_errors(splats: SplatParams, reference: SplatParams) -> GroupErrors | None:
    """Of splats against the reference; None if one of them has none that is finite."""
    splats = splats.take(splats.finite())
    reference = reference.take(reference.finite())
    if not len(splats) or not len(reference):
        return None
    tree = cKDTree(reference.means.astype(np.float64))
    chosen = np.arange(0, len(splats), max(1, -(-len(splats) // MAX_COMPARED)))
    if len(splats) == len(reference) and _has_order(splats, reference, tree):
        partners, matching = chosen, "same count and order"
    else:
        partners, matching = _nearest(splats.take(chosen), reference, tree), "nearest match"
    if len(chosen) < len(splats):
        matching += f", {len(chosen):,} of {len(splats):,} splats"
    found = _differences(splats.take(chosen), reference.take(partners))
    groups = tuple(
        GroupError(group, unit, math.sqrt(float(np.mean(np.square(part)))), float(np.max(part)))
        for group, unit, part in zip(GROUPS, UNITS, found, strict=True)
    )
    return GroupErrors(matching, len(chosen), groups)


# --- which correspond -----------------------------------------------------------------------------


def _has_order(splats: SplatParams, reference: SplatParams, tree: cKDTree) -> bool:
    """Whether splats are where the reference has those of the same place."""
    rows = np.arange(0, len(splats), max(1, -(-len(splats) // N_TRIED)))
    means = splats.means[rows].astype(np.float64)
    nearest = tree.query(means)[0]
    away = np.linalg.norm(means - reference.means[rows], axis=1)
    return bool(np.median(away) <= SAME_ORDER * np.median(nearest))


def _nearest(splats: SplatParams, reference: SplatParams, tree: cKDTree) -> I64:
    """(N,) of the nearest few positions, the splat of the reference that is most alike.

    A distance counts in standard deviations of the splat.
    """
    j = min(N_CANDIDATES, len(reference))
    distances, rows = tree.query(splats.means.astype(np.float64), k=j)
    distances, rows = distances.reshape(-1, j), rows.reshape(-1, j)
    sizes = np.exp(np.clip(splats.log_scales.max(axis=1).astype(np.float64), -50, 50))
    cost = np.square(distances / sizes[:, None])
    ours, theirs = _alike(splats), _alike(reference)
    for mine, other in zip(ours, theirs, strict=True):
        cost += np.square(mine[:, None] - other[rows])
    best = np.argmin(cost, axis=1)
    return np.take_along_axis(rows, best[:, None], axis=1)[:, 0].astype(np.int64)


def _alike(splats: SplatParams) -> F64:
    """(7, N) what corresponding splats have alike, whatever their axes are called."""
    scales = np.sort(splats.log_scales.astype(np.float64), axis=1)
    return np.vstack([scales.T, _opacities(splats), splats.sh[:, 0].T])


# --- how far they are -----------------------------------------------------------------------------


def _differences(splats: SplatParams, reference: SplatParams) -> list[F64]:
    """Per group, absolute differences of N pairs."""
    means = splats.means.astype(np.float64) - reference.means
    angles, scales = _ellipsoids(splats, reference)
    sh = np.zeros((len(splats), max(splats.sh.shape[1], reference.sh.shape[1]), 3))
    sh[:, : splats.sh.shape[1]] += splats.sh
    sh[:, : reference.sh.shape[1]] -= reference.sh
    opacity = np.abs(_opacities(splats) - _opacities(reference))
    return [np.linalg.norm(means, axis=1), angles, scales, opacity, np.abs(sh)]


def _ellipsoids(splats: SplatParams, reference: SplatParams) -> tuple[F64, F64]:
    """(N,) degrees, and (N, 3) differences of log-scales, by the turn that is least."""
    angles, scales = np.empty(len(splats)), np.empty((len(splats), 3))
    for start in range(0, len(splats), CHUNK):
        rows = slice(start, start + CHUNK)
        ours, theirs = (
            unit_quats(one.quats[rows].T.astype(np.float64)) for one in (splats, reference)
        )
        inverse = theirs * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
        between = multiply(inverse, ours)  # from one frame to the other, in that frame
        # Of half the angle, the real part of `between` after each of the 24 turns.
        real = np.abs(np.stack([multiply(between, turn[:, None])[0] for turn in TURNS], axis=1))
        turn = np.argmax(real, axis=1)
        angle = np.degrees(2 * np.arccos(np.clip(real.max(axis=1), 0, 1)))
        angles[rows] = np.where(angle < MIN_DEGREES, 0, angle)
        renamed = np.take_along_axis(splats.log_scales[rows], PERMUTE[turn], axis=1)
        scales[rows] = np.abs(renamed.astype(np.float64) - reference.log_scales[rows])
    return angles, scales


def _opacities(splats: SplatParams) -> F64:
    """(N,) after activation."""
    logits = np.clip(splats.opacity_logits.astype(np.float64), -50, 50)
    found: F64 = 1 / (1 + np.exp(-logits))
    return found
