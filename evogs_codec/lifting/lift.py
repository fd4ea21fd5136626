"""Lifting: a tree under an existing splat set, without photographs or training.

Neighbours are paired, each pair gets a parent on the line through it, and the parents are paired
again, a round per level. Three passes (the geometry of each is in `orientations`, `pairing` and
`parents`):

1. up: who pairs with whom, each node written in the way that suits it and its own subtree;
2. down: the ways of writing made consistent, so that every leaf resembles its relatives;
3. up: with the leaves fixed, the parents that the tree will have.

A pass takes about 1.5 kB a splat, so large scenes are lifted in parts, which no pair crosses.

Letters: N splats, D channels, T nodes of all levels: first the leaves, then the parents by round.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from evogs_codec.common.morton import morton_order
from evogs_codec.common.parallel import parallel_blocks, parallel_map
from evogs_codec.common.progress import Progress, no_progress
from evogs_codec.lifting.concat import joined
from evogs_codec.lifting.orientations import (
    BLOCK,
    COMPOSE,
    Round,
    consistent_turns,
    largest_w,
    nearest_turns,
    unit_quats,
    write_shape,
)
from evogs_codec.lifting.pairing import N_NEIGHBOURS, features, match
from evogs_codec.lifting.parents import (
    N_SHAPE,
    Moments,
    line_parents,
    median_mass,
    merge_pairs,
    midpoints,
    moments,
)
from evogs_codec.lifting.splitting import split_nodes
from evogs_codec.model.channels import N_GEOMETRY, n_channels
from evogs_codec.model.splats import F32, F64, I64, SplatParams
from evogs_codec.model.tree import EvolutionTree, Step

__all__ = [
    "ALL_LEVELS_FROM",
    "N_LEVELS",
    "N_NEIGHBOURS",
    "Lifted",
    "default_levels",
    "largest_leaf_errors",
    "lift",
    "lift_with_order",
]

N_LEVELS = 5  # of a tree, if nothing else is asked for
# Streams of fewer splats have fewer levels, likewise, with so many splats in level 0 at least.
ALL_LEVELS_FROM, MIN_FIRST_LEVEL = 20_000, 2_000
N_PRICED = 14  # channels that decide who pairs: all but the higher SH bands
MAX_PART = 1 << 19  # splats that are lifted together at most


@dataclass(frozen=True, eq=False)
class Lifted:
    """A tree and where its leaves come from.

    Attributes:
        tree: its last level is the splat set.
        leaf_of: (N,) the index of the input splat that each leaf, in slot order, is equivalent to.
    """

    tree: EvolutionTree
    leaf_of: I64


def default_levels(n_splats: int) -> int:
    """How many levels a stream has: five, or fewer of less than 20,000 splats.

    Coarse levels of few splats cost more bytes than they show.
    """
    if n_splats >= ALL_LEVELS_FROM:
        return N_LEVELS
    return min(N_LEVELS, max(n_splats // MIN_FIRST_LEVEL, 1).bit_length())


def lift(
    splats: SplatParams,
    n_levels: int = N_LEVELS,
    *,
    n_neighbours: int = N_NEIGHBOURS,
    progress: Progress | None = None,
) -> EvolutionTree:
    """A tree of `n_levels` levels, each of about half the splats of the next, the last `splats`.

    Args:
        splats: N splats; the leaves are equivalent Gaussians in another order (`lift_with_order`).
        n_levels: at least 1; 1 gives a tree of adds only.
        n_neighbours: of a splat, among which one is found that it is paired with; fewer take less
            time.
        progress: called with the stage "lift" and the part that is done.

    Raises:
        ValueError: `n_levels` or `n_neighbours` is below 1, or a splat has a number that is not
            finite.
    """
    return lift_with_order(splats, n_levels, n_neighbours=n_neighbours, progress=progress).tree


def largest_leaf_errors(
    tree: EvolutionTree, splats: SplatParams, leaf_of: I64
) -> tuple[float, ...]:
    """(5,) largest error per group of the leaves of a lifted tree: its psi are float32.

    A leaf may have its axes in another order than its splat. So log-scales are compared in order
    of size, and the error of rotations is taken to be 0.

    Args:
        tree: of N leaves.
        splats: N splats that were lifted.
        leaf_of: (N,) the index of the splat that each leaf is.
    """
    leaves, right = tree.leaves(), splats.take(leaf_of)

    def most(a: F32, b: F32) -> float:
        return float(np.abs(a.astype(np.float64) - b).max(initial=0))

    return (
        most(leaves.means, right.means),
        0.0,
        most(np.sort(leaves.log_scales, axis=1), np.sort(right.log_scales, axis=1)),
        most(leaves.opacity_logits, right.opacity_logits),
        most(leaves.sh, right.sh),
    )


def lift_with_order(
    splats: SplatParams,
    n_levels: int = N_LEVELS,
    *,
    n_neighbours: int = N_NEIGHBOURS,
    progress: Progress | None = None,
) -> Lifted:
    """`lift`, and which splat each leaf is.

    Raises:
        ValueError: as `lift`.
    """
    if n_levels < 1:
        raise ValueError(f"n_levels is {n_levels}, expected at least 1")
    if n_neighbours < 1:
        raise ValueError(f"n_neighbours is {n_neighbours}, expected at least 1")
    n_bad = len(splats) - int(np.count_nonzero(splats.finite()))
    if n_bad:
        raise ValueError(f"{n_bad} of {len(splats)} splats have a number that is not finite")
    report = partial(progress or no_progress, "lift")
    if len(splats) <= MAX_PART:
        return _lift(splats, n_levels, n_neighbours, report)
    order = morton_order(splats.means.T)
    parts = np.array_split(order, -(-len(splats) // MAX_PART))
    lifted = []

    def lift_part(rows: I64) -> Lifted:
        return _lift(splats.take(rows), n_levels, n_neighbours, lambda _: None)

    for one in parallel_map(lift_part, parts):
        lifted.append(one)
        report(len(lifted) / len(parts))
    tree, slots = joined([one.tree for one in lifted])
    leaf_of = np.empty(len(splats), np.int64)
    for rows, one, places in zip(parts, lifted, slots, strict=True):
        leaf_of[places] = rows[one.leaf_of]
    return Lifted(tree, leaf_of)


def _lift(
    splats: SplatParams, n_levels: int, n_neighbours: int, report: Callable[[float], None]
) -> Lifted:
    """`lift_with_order` of splats that are finite."""
    # Of the leaves, and room for their parents: fewer than leaves.
    values = np.empty((n_channels(splats.sh_degree), 2 * len(splats)))
    x = values[:, : len(splats)]
    parallel_blocks(lambda part: splats.take(part).write_channels(x[:, part]), len(splats), BLOCK)
    quats = unit_quats(x[3:7])
    log_scales = x[7:10].copy()
    own_turn = largest_w(quats)
    write_shape(x, quats, log_scales, own_turn)

    rounds, shapes, roots = _pair_up(x, n_levels - 1, n_neighbours, report)
    turns = consistent_turns(rounds, shapes)[: len(splats)]
    write_shape(x, quats, log_scales, COMPOSE[own_turn, turns])
    report(0.85)
    alphas = _raise_parents(values, len(splats), rounds)
    report(0.95)
    roots = roots[morton_order(values[0:3, roots])]
    lifted = _grow(values, alphas, rounds, roots, splats.sh_degree)
    report(1.0)
    return lifted


def _pair_up(
    x: F64, n_rounds: int, n_neighbours: int, report: Callable[[float], None]
) -> tuple[list[Round], F64, I64]:
    """Pass 1 over the leaves (D, N).

    Returns:
        The rounds from the leaves up, the shapes (10, T) of all nodes as pass 1 wrote them, and the
        nodes that no round merged.
    """
    n = x.shape[1]
    now = x[:N_PRICED].copy()
    mass = moments(now)
    unit_mass = median_mass(mass)
    nodes = np.arange(n)
    unit = float(np.exp(np.clip(np.median(x[7:10].mean(axis=0)), -40, 40))) if n else 1.0
    shapes = [now[:N_SHAPE]]
    rounds: list[Round] = []
    total = n
    for k in range(n_rounds):
        i, j = nodes[:0], nodes[:0]
        if len(nodes) > 1:
            i, j = match(features(now, mass, unit), n_neighbours)
        larger = now[7:10, i].sum(axis=0) > now[7:10, j].sum(axis=0)
        c1, c2 = np.where(larger, j, i), np.where(larger, i, j)

        left, right = np.take(now, c1, axis=1), np.take(now, c2, axis=1)
        quats, log_scales = unit_quats(right[3:7]), right[7:10].copy()
        turn_c2 = nearest_turns(left[4:7], left[7:10], quats, log_scales)
        write_shape(right, quats, log_scales, turn_c2)
        mass_parents = Moments.empty(len(c1))
        merge_pairs(mass, c1, c2, mass_parents)
        parents, _ = line_parents(left, right, mass_parents, unit_mass)
        quats, log_scales = unit_quats(parents[3:7]), parents[7:10].copy()
        turn_parent = largest_w(quats)
        write_shape(parents, quats, log_scales, turn_parent)

        ids = total + np.arange(len(c1))
        total += len(c1)
        rounds.append(Round(nodes[c1], nodes[c2], ids, turn_c2, turn_parent))
        shapes.append(parents[:N_SHAPE])
        alone = np.ones(len(nodes), bool)
        alone[c1] = alone[c2] = False
        rows = np.flatnonzero(alone)
        now = np.concatenate([np.take(now, rows, axis=1), parents], axis=1)
        mass = mass.take(rows).followed_by(mass_parents)
        nodes = np.concatenate([nodes[rows], ids])
        # Each round has half the nodes of the one before.
        report(0.8 * (1 - 0.5 ** (k + 1)))
    return rounds, np.concatenate(shapes, axis=1), nodes


def _raise_parents(values: F64, n: int, rounds: list[Round]) -> list[F64]:
    """Pass 3: the channels (D, at least T) of n leaves become those of all nodes, in place.

    Returns:
        Alpha (5, R) of each round.
    """
    mass = moments(values[:, :n]).with_room(values.shape[1])
    unit_mass = median_mass(mass.part(0, n))
    alphas = []
    for r in rounds:
        # Parents are numbered in the order of the rounds.
        end = n + len(r.parent)
        own = mass.part(n, end)
        merge_pairs(mass, r.c1, r.c2, own)
        parents = values[:, n:end]
        c1, c2 = (np.take(values[:N_GEOMETRY], node, axis=1) for node in (r.c1, r.c2))
        parents[:N_GEOMETRY], alpha = line_parents(c1, c2, own, unit_mass)
        midpoints(values[N_GEOMETRY:], r.c1, r.c2, parents[N_GEOMETRY:])
        alphas.append(alpha)
        n = end
    return alphas


def _grow(
    values: F64, alphas: list[F64], rounds: list[Round], roots: I64, sh_degree: int
) -> Lifted:
    """The tree of the nodes (D, at least T), roots in the order given."""
    steps = [Step.of_adds(0, values[:, roots].astype(np.float32))]
    slot_of = np.full(values.shape[1], -1)
    slot_of[roots] = np.arange(len(roots))
    node_at = roots
    for level, (r, alpha) in enumerate(zip(reversed(rounds), reversed(alphas), strict=True), 1):
        order = np.argsort(slot_of[r.parent])
        c1, c2, parent = r.c1[order], r.c2[order], r.parent[order]
        slots = slot_of[parent]
        nodes = parent, c1, c2
        steps += split_nodes(level, slots, len(node_at), values, nodes, alpha[:, order])
        slot_of[c1] = slots
        slot_of[c2] = len(node_at) + np.arange(len(c2))
        node_at = np.concatenate([node_at, c2])
        node_at[slots] = c1
    return Lifted(EvolutionTree(sh_degree, tuple(steps)), node_at)
