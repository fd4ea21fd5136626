"""Trees and streams in exact arithmetic: Python integers, nothing is ever rounded.

The numbers of a tree are binary32, multiples of 2**-149; products of two are multiples of 2**-298.
Here every number is an integer count of 2**-UNIT. Letters: D channels, n slots, S splits.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.model.channels import GROUP_CHANNELS, channel_class, n_channels
from evogs_codec.model.coded_tree import CodedTile, CodedTree
from evogs_codec.model.splats import F32, F64
from evogs_codec.model.tree import EvolutionTree, Kind

__all__ = ["Integers", "errors", "float32_of", "slots_of_coded", "slots_of_tree"]

Integers: TypeAlias = npt.NDArray[Any]  # of Python integers
UNIT = 298
HALF = UNIT // 2  # of binary32


def slots_of_tree(tree: EvolutionTree) -> Integers:
    """(D, n) state after the last step, in 2**-UNIT; dropped slots hold 0."""
    d = n_channels(tree.sh_degree)
    x = np.zeros((d, 0), object)
    for step in tree.steps:
        has_psi = step.kinds != Kind.DROP
        targets = step.slots[has_psi]
        is_split = step.kinds[has_psi] == Kind.SPLIT
        alpha = np.zeros((d, int(is_split.sum())), object)
        for group, part in enumerate(GROUP_CHANNELS):
            alpha[part] = _integers(step.alpha[group])
        psi, parents = _integers(step.psi), x[:, targets]
        x[:, targets] = parents + (psi << HALF)
        seconds = parents[:, is_split] - alpha * psi[:, is_split]
        x = np.concatenate([x, seconds, _integers(step.adds) << HALF], axis=1)
        x[:, step.slots[~has_psi]] = 0
    return x


def slots_of_coded(tree: CodedTree, tile: CodedTile) -> Integers:
    """(D, n) X after the last step, by the formulas of spec 7.3 and 7.4."""
    d = n_channels(tree.sh_degree)
    kinds = [channel_class(c) for c in range(d)]
    x = np.zeros((d, 0), object)
    for step in tile.steps:
        has_psi = step.kinds != Kind.DROP
        targets = step.slots[has_psi]
        is_split = step.kinds[has_psi] == Kind.SPLIT
        seconds = np.zeros((d, int(is_split.sum())), object)
        adds = np.zeros(step.adds.shape, object)
        parents = x[:, targets]
        for c, kind in enumerate(kinds):
            of_adds, of_psi = tree.quantisers[0][kind], tree.quantisers[1 + step.level][kind]
            delta = step.psi[c].astype(object) * of_psi.step
            table = tree.alpha_table(step.level, min(kind, 4))
            a = np.array(table.entries, object)[step.alpha[min(kind, 4)]]
            half = (1 << table.shift) >> 1
            seconds[c] = parents[c, is_split] - ((a * delta[is_split] + half) >> table.shift)
            x[c, targets] = parents[c] + delta
            adds[c] = step.adds[c].astype(object) * of_adds.step
        x = np.concatenate([x, seconds, adds], axis=1)
        x[:, step.slots[~has_psi]] = 0
    return x


def errors(
    wanted: Integers, got: Integers, origin: tuple[int, ...], exponents: tuple[int, ...]
) -> F64:
    """(D, n) |wanted - decoded| in grid units; rounded once, at the end.

    Args:
        wanted: of `slots_of_tree`.
        got: (D, n) decoded X.
        origin: O of the tile.
        exponents: G per group.
    """
    out = np.empty(wanted.shape)
    for channel, (row, x) in enumerate(zip(wanted, got, strict=True)):
        exponent = exponents[min(channel_class(channel), 4)]
        unit = 1 << (UNIT - exponent)
        o = origin[channel] if channel < 3 else 0
        out[channel] = [
            float(Fraction(abs(w - (o + int(g)) * unit), unit)) for w, g in zip(row, x, strict=True)
        ]
    return out


def float32_of(numerator: int, exponent: int) -> F32:
    """The binary32 number nearest to numerator * 2**-exponent, ties to even, by integers alone."""
    magnitude, shift = abs(numerator), 0
    excess = magnitude.bit_length() - 24
    if excess > 0:
        kept, rest, half = magnitude >> excess, magnitude & ((1 << excess) - 1), 1 << (excess - 1)
        magnitude = kept + (rest > half or (rest == half and kept & 1))
        shift = excess
    value = np.ldexp(np.float64(magnitude), shift - exponent)
    return np.float32(-value if numerator < 0 else value)  # type: ignore[return-value]


def _integers(x: F32) -> Integers:
    """Binary32 numbers as counts of 2**-149."""
    out = np.empty(x.shape, object)
    for place in np.ndindex(x.shape):
        numerator, denominator = float(x[place]).as_integer_ratio()
        out[place] = numerator * ((1 << HALF) // denominator)
    return out
