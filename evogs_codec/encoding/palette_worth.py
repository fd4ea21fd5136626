"""What a palette saves, estimated: so that only one of two trees needs to be encoded.

Both trees have the same splats; they differ in the SH above band 0, which one has as psi and the
other as picks of entries. Here both are quantised from a sample, in bits: those of an order-0 code,
and the error by what a bit is worth. Nothing is written or drawn.

Letters: C SH channels above band 0, K classes (spec 3.2), N leaves, P numbers of a sample.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evogs_codec.encoding.rate_distortion import cheapest
from evogs_codec.encoding.sensitivity import SQUARED_STEPS_PER_BIT, Importance
from evogs_codec.format.planes import entropy, zigzag
from evogs_codec.model.channels import N_CORE, N_GROUPS, channel_class
from evogs_codec.model.splats import F32, I64
from evogs_codec.model.tree import EvolutionTree, Kind

__all__ = ["bits_of_entries", "bits_of_palette", "bits_of_picks", "bits_of_psi", "stored_bits"]

N_SAMPLED = 1 << 14  # numbers of a level and channel that are quantised


def bits_of_psi(tree: EvolutionTree, importance: Importance, price: float) -> float:
    """Bits of the SH above band 0 of a tree without a palette.

    Args:
        tree: its psi are those numbers.
        importance: of its leaves, in any order: what a splat is worth says little of its SH.
        price: mean squared error that a bit is worth.
    """
    worth = np.concatenate(importance.leaves, axis=1)[N_GROUPS:]
    rng = np.random.default_rng(0)
    found = 0.0
    for level, values in _by_level(tree):
        if not values.shape[1]:
            continue
        # An error of a number is one of all leaves below.
        below = _leaves_below(tree, level)
        some = values[:, :: max(1, values.shape[1] // N_SAMPLED)]
        weights = worth[:, rng.integers(0, worth.shape[1], some.shape[1])] * np.float32(below)
        q, errors = _quantised(some, weights, price)
        found += (errors + _entropy(q)) * values.shape[1] / some.shape[1]
    return found


def bits_of_palette(tree: EvolutionTree, importance: Importance, price: float) -> float:
    """Bits of the entries and the picks of a tree with a palette; arguments as `bits_of_psi`."""
    bits, errors = _of_palette(tree, importance, price)
    return bits + errors


def stored_bits(tree: EvolutionTree, importance: Importance, price: float) -> float:
    """`bits_of_palette` without those that errors cost."""
    return _of_palette(tree, importance, price)[0]


def _of_palette(tree: EvolutionTree, importance: Importance, price: float) -> tuple[float, float]:
    """Bits of the entries and the picks, and those that the errors of the entries cost."""
    palette = tree.palette
    assert palette is not None, "the tree has a palette"
    assert importance.entries is not None, "so has its importance"
    bits, errors, number = bits_of_entries(palette.entries, importance.entries, price)
    return bits + bits_of_picks(tree, number), errors


def bits_of_entries(entries: F32, weights: F32, price: float) -> tuple[float, float, I64]:
    """Bits of entries (C, n) of these weights (degree, n), and those that their errors cost.

    Also the number of each pick (1 + n,): entries that have become equal are stored once, and
    picked as one.
    """
    q, errors = _quantised(entries, weights, price)
    factors = np.random.default_rng(0).integers(1 << 62, size=len(q)) * 2 + 1
    keys = np.append(0, factors @ q)
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    kept = q[:, first[first > 0] - 1]
    return _entropy(kept), errors, number


def bits_of_picks(tree: EvolutionTree, number: I64) -> float:
    """Bits of the picks of a tree, each by this number."""
    picks = np.concatenate([np.concatenate([s.picks, s.changed_picks]) for s in tree.steps])
    return entropy(number[picks])


def _by_level(tree: EvolutionTree) -> Iterator[tuple[int, F32]]:
    """The adds, as level -1, and the psi of each level: (C, P) of the channels above band 0."""
    yield -1, np.concatenate([step.adds[N_CORE:] for step in tree.steps], axis=1)
    for level in range(tree.n_levels):
        own = [step.psi[N_CORE:] for step in tree.steps if step.level == level]
        yield level, np.concatenate([np.empty((len(own[0]) if own else 0, 0)), *own], axis=1)


def _leaves_below(tree: EvolutionTree, level: int) -> float:
    """Leaves that a number of a level reaches, on the average: of both children of a split."""
    steps = [step for step in tree.steps if step.level <= max(level, 0)]
    n = sum(step.n_new - int(np.count_nonzero(step.kinds == Kind.DROP)) for step in steps)
    return tree.n_leaves / max(n, 1) * (1 if level < 0 else 2)


def _quantised(values: F32, weights: F32, price: float) -> tuple[I64, float]:
    """Integers of values (C, P) with weights (degree, P), and the bits that their errors cost."""
    kinds = np.array([channel_class(N_CORE + c) for c in range(len(values))]) - N_GROUPS
    means = np.maximum(weights.mean(axis=1, dtype=np.float64), 1e-300)
    steps = np.sqrt(SQUARED_STEPS_PER_BIT * price / means)[kinds, None]
    u = values / steps
    worth = weights[kinds] * (np.square(steps) / price)
    q = cheapest(u, worth)
    return q.astype(np.int64), float((worth * np.square(q - u)).sum())


def _entropy(q: I64) -> float:
    """Bits of integers (C, P), row by row."""
    return sum(entropy(zigzag(row)) for row in q)
