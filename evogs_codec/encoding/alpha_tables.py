"""Alpha tables: which alphas a level and group can use, and which of them a split does (spec 5.4).

Letters: S splits, C channels of a group.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.encoding.grids import MAX_EXACT
from evogs_codec.encoding.settings import Settings
from evogs_codec.model.arithmetic import MAX_PRODUCT, AlphaTable
from evogs_codec.model.channels import GROUP_CHANNELS, N_GROUPS
from evogs_codec.model.coded_tree import CodedStep, CodedTree
from evogs_codec.model.splats import F64, U8
from evogs_codec.model.tree import EvolutionTree, Kind, Step

__all__ = [
    "alpha_tables",
    "cheapest_alphas",
    "joint_delta",
    "nearest",
    "serving_both",
    "serving_second",
    "tables_of",
    "weighted_alphas",
    "with_used_entries",
]

Bools: TypeAlias = npt.NDArray[np.bool_]

FEW_ALPHAS = 64  # of which each has an entry, if there are shifts that hold them
FEW_ALPHA_BITS = 9  # K of a table that has an entry for every alpha of the tree
N_INDICES = 256  # an index is a byte
KEPT = 1 << 21  # costs of alphas that are kept from pass to pass; more are found again in each
ALPHA_RATE = 0.2  # error, in squared steps, that a bit of an alpha index is worth


def alpha_tables(
    tiles: Sequence[EvolutionTree], settings: Settings
) -> dict[tuple[int, int], AlphaTable]:
    """Tables per (level, group); none where alpha is 1."""
    return tables_of(weighted_alphas(tiles), settings)


def weighted_alphas(tiles: Sequence[EvolutionTree]) -> dict[tuple[int, int], tuple[F64, F64]]:
    """(n,) alphas and (n,) what each weighs, above 0, per (level, group)."""
    found = {}
    for level in sorted({step.level for tile in tiles for step in tile.steps}):
        steps = [step for tile in tiles for step in tile.steps if step.level == level]
        for group, part in enumerate(GROUP_CHANNELS):
            alphas = np.concatenate([np.empty(0), *(step.alpha[group] for step in steps)])
            weights = np.concatenate([np.empty(0), *(_psi_energy(step, part) for step in steps)])
            found[level, group] = alphas[weights > 0], weights[weights > 0]
    return found


def tables_of(
    weighted: Mapping[tuple[int, int], tuple[F64, F64]], settings: Settings
) -> dict[tuple[int, int], AlphaTable]:
    """`alpha_tables` of what `weighted_alphas` found."""
    tables = {place: _alpha_table(*found, settings) for place, found in weighted.items()}
    return {place: table for place, table in tables.items() if table is not None}


def _psi_energy(step: Step, part: slice) -> F64:
    """(S,) squared length of psi of the splits, in a group."""
    is_split = step.kinds[step.kinds != Kind.DROP] == Kind.SPLIT
    energy: F64 = np.square(step.psi[part][:, is_split], dtype=np.float64).sum(0)
    return energy


def _alpha_table(alphas: F64, weights: F64, settings: Settings) -> AlphaTable | None:
    """The table of some alphas: exact if they are few, fitted otherwise; None if all are 1."""
    values, counts = np.unique(alphas, return_counts=True)
    if len(values) == 0 or (len(values) == 1 and values[0] == 1.0):
        return None
    if len(values) <= max(FEW_ALPHAS, settings.n_alpha):
        for shift in range(13):
            scaled = values * (1 << shift)
            if np.all(scaled == np.rint(scaled)) and np.abs(scaled).max() < 1 << 15:
                order = np.argsort(-counts, kind="stable")  # the frequent ones first
                exact = [int(a) for a in scaled[order]]
                if settings.is_near_lossless and _may_overflow(exact):
                    exact.append(0)  # a refine corrects the second child
                return AlphaTable(shift, tuple(exact))
    shift = settings.alpha_bits
    if len(values) <= settings.n_alpha and not settings.is_near_lossless:
        shift = max(shift, FEW_ALPHA_BITS)  # entries of their own: to be precise costs nothing
    largest = ((1 << 15) - 1) / (1 << shift)
    clipped = np.clip(
        alphas, -largest, largest
    )  # a choice of table, not of values: see serving_both
    if not settings.closed_loop:  # uniform, as the psi
        centres = np.linspace(clipped.min(), clipped.max(), 256)
    else:
        centres = _lloyd(clipped, weights, settings.n_alpha)
    entries = np.unique(np.rint(centres * (1 << shift)).astype(np.int64))
    if settings.is_near_lossless:
        entries = np.unique(np.concatenate([[0], entries[:255]]))
    return AlphaTable(shift, tuple(int(a) for a in entries))


def _may_overflow(entries: Sequence[int]) -> bool:
    """Whether products with psi of some values are too large, and no entry is 0."""
    has_room = 0 not in entries and len(entries) < N_INDICES
    return has_room and max(map(abs, entries)) * 2 * MAX_EXACT > MAX_PRODUCT


def _lloyd(values: F64, weights: F64, n: int) -> F64:
    """Up to n centres of weighted values (Lloyd's algorithm from quantiles)."""
    order = np.argsort(values, kind="stable")
    x, w = values[order], np.sqrt(weights[order])
    w = np.minimum(w, np.quantile(w, 0.9))  # a few huge psi must not take all entries
    total = np.cumsum(w)
    centres = np.unique(np.interp((np.arange(n) + 0.5) / n * total[-1], total, x))
    sums = np.concatenate([[0.0], np.cumsum(w * x)])
    masses = np.concatenate([[0.0], total])
    for _ in range(20):
        edges = np.searchsorted(x, (centres[1:] + centres[:-1]) / 2)
        edges = np.concatenate([[0], edges, [len(x)]])
        mass = np.diff(masses[edges])
        some = mass > 0
        centres = np.diff(sums[edges])[some] / mass[some]
    return centres


def nearest(table: AlphaTable, alpha: F64) -> U8:
    """(S,) index of the entry nearest to each alpha."""
    values = table.values
    order = np.argsort(values)
    middles = (values[order][1:] + values[order][:-1]) / 2
    return order[np.searchsorted(middles, alpha)].astype(np.uint8)


def serving_second(u: F64, v: F64, table: AlphaTable) -> U8:
    """(S,) index of the alpha with the least error of C2, where C1 is exact.

    Args:
        u: (C, S) C1 - P in steps of the channel.
        v: (C, S) C2 - P in steps of the channel.
        table: the alphas.
    """
    uu, uv, vv = (u * u).sum(0), (u * v).sum(0), (v * v).sum(0)
    cost = [vv + 2 * a * uv + a * a * uu for a in table.values]
    indices: U8 = np.argmin(cost, axis=0).astype(np.uint8)
    return indices


def serving_both(u: F64, v: F64, table: AlphaTable) -> U8:
    """(S,) index of the alpha that serves both children best, its bits counted in.

    With the best Delta, the joint squared error of C1 and C2 is |v + alpha u|^2 / (1 + alpha^2);
    rounding adds (1 + alpha^2) / 12 of a squared step per channel. Arguments as `serving_second`.
    """
    uu, uv, vv = (u * u).sum(0), (u * v).sum(0), (v * v).sum(0)
    rounding = len(u) / 12.0

    def cost(a: float) -> F64:
        total: F64 = (vv + 2 * a * uv + a * a * uu) / (1 + a * a) + (1 + a * a) * rounding
        return total

    return cheapest_alphas(table, u.shape[1], cost, ALPHA_RATE, passes=2)


def joint_delta(u: F64, v: F64, alpha: F64, bounded: npt.NDArray[np.bool_]) -> F64:
    """(C, S) Delta that serves both children, C1 = P + u and C2 = P + v, best.

    The least squared error. For a positive alpha that can be 1.2 times the error of the parent in
    one child, which grows along a chain; so where `bounded`, the least largest error instead, which
    is no more than the parent's (it has to go somewhere: C1 and C2 stay on a line through P).
    """
    least_squares = (u - alpha * v) / (1.0 + alpha * alpha)
    least_largest = (u - v) / (1.0 + np.maximum(alpha, 0.0))
    return np.where(bounded & (alpha > 0), least_largest, least_squares)


def cheapest_alphas(
    table: AlphaTable, n_splits: int, cost: Callable[[float], F64], bit: float, *, passes: int
) -> U8:
    """(S,) index of the alpha that costs least, its own bits counted in.

    Args:
        table: the alphas.
        n_splits: S.
        cost: (S,) of an alpha.
        bit: cost of a bit of an index.
        passes: the first knows no bits, each other those of an order-0 code for the one before.
    """
    values = table.values
    bits = np.zeros(len(values))
    index = np.zeros(n_splits, np.uint8)
    kept = [cost(a) for a in values] if len(values) * n_splits <= KEPT else []
    for _ in range(passes):
        best = np.full(n_splits, np.inf)
        for k, own in enumerate(kept or map(cost, values)):
            total = own + bit * bits[k]
            better = total < best
            np.copyto(best, total, where=better)
            np.copyto(index, np.uint8(k), where=better)
        counts = np.bincount(index, minlength=len(values))
        bits = -np.log2((counts + 0.5) / (counts.sum() + 0.5 * len(values)))
    return index


def with_used_entries(tree: CodedTree) -> CodedTree:
    """The same splats, with tables of the entries that they need, in the same order.

    An entry that no split needs takes two bytes, and may make all indices wider. A split whose psi
    of a group are 0 needs none, and has the most frequent one of its step.
    """
    moves = [[_moves(step) for step in tile.steps] for tile in tree.tiles]
    steps = [
        (step, own)
        for tile, of_tile in zip(tree.tiles, moves, strict=True)
        for step, own in zip(tile.steps, of_tile, strict=True)
    ]
    needed = {place: _needed(steps, place) for place in tree.alpha}
    tables = {
        place: AlphaTable(
            tree.alpha[place].shift, tuple(tree.alpha[place].entries[k] for k in kept)
        )
        for place, kept in needed.items()
    }
    tables = {k: t for k, t in tables.items() if t.values.tolist() not in ([], [1.0])}
    tiles = [
        replace(
            tile,
            steps=tuple(
                _with_indices(step, own, needed)
                for step, own in zip(tile.steps, of_tile, strict=True)
            ),
        )
        for tile, of_tile in zip(tree.tiles, moves, strict=True)
    ]
    return replace(tree, alpha=tables, tiles=tuple(tiles))


def _needed(steps: Sequence[tuple[CodedStep, Bools]], place: tuple[int, int]) -> list[int]:
    """The entries of a table that splits need, of steps with their `_moves`."""
    level, group = place
    rows = [step.alpha[group][moves[group]] for step, moves in steps if step.level == level]
    counts = np.bincount(np.concatenate([np.empty(0, np.uint8), *rows]))
    found: list[int] = np.flatnonzero(counts).tolist()
    return found


def _with_indices(
    step: CodedStep, moves: Bools, needed: Mapping[tuple[int, int], list[int]]
) -> CodedStep:
    """The step with the places that its entries have in tables of those that are needed."""
    alpha = step.alpha.copy()
    for group, row in enumerate(alpha):
        kept = needed.get((step.level, group), [])
        places = np.zeros(N_INDICES, np.uint8)
        places[kept] = np.arange(len(kept))
        frequent = np.bincount(places[row[moves[group]]], minlength=1).argmax()
        row[:] = np.where(moves[group], places[row], frequent)
    return replace(step, alpha=alpha)


def _moves(step: CodedStep) -> Bools:
    """(5, S) splits that have a psi of a group other than 0."""
    n_splits = step.alpha.shape[1]
    if not n_splits:
        return np.zeros((N_GROUPS, 0), bool)
    is_split = step.kinds[step.kinds != Kind.DROP] == Kind.SPLIT
    psi = step.psi if is_split.all() else step.psi[:, is_split]
    return np.array([np.any(psi[part], axis=0) for part in GROUP_CHANNELS])
