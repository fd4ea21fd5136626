"""Trees evaluated exactly, to measure decoded integers against.

The numbers of a tree are binary32, that is multiples of 2**-149, and the products of two are
multiples of 2**-298: as multiples of 2**-SCALE all are Python integers, and nothing is rounded.
"""

from collections.abc import Iterator
from fractions import Fraction

from evogs_codec.model.channels import n_channels
from evogs_codec.model.tree import EvolutionTree, Kind

SCALE = 300
LEAST_EXPONENT = -16
GROUP_OF = (0,) * 3 + (1,) * 4 + (2,) * 3 + (3,) + (4,) * 48


def exact(value: float, scale: int = SCALE) -> int:
    """A binary32 number as a multiple of 2**-scale."""
    numerator, denominator = value.as_integer_ratio()
    assert (1 << scale) % denominator == 0
    return numerator * ((1 << scale) // denominator)


def exact_states(tree: EvolutionTree) -> Iterator[tuple[list[list[int]], list[bool]]]:
    """([channel][slot], live) after each step; the lists change from one step to the next."""
    x: list[list[int]] = [[] for _ in range(n_channels(tree.sh_degree))]
    live: list[bool] = []
    for step in tree.steps:
        kinds = [Kind(kind) for kind in step.kinds.tolist()]
        slots = step.slots.tolist()
        for channel, values in enumerate(x):
            psi = iter(step.psi[channel].tolist())
            alpha = iter(step.alpha[GROUP_OF[channel]].tolist())
            seconds = []
            for slot, kind in zip(slots, kinds, strict=True):
                if kind == Kind.DROP:
                    values[slot] = 0
                    continue
                p, change = values[slot], next(psi)
                values[slot] = p + exact(change)
                if kind == Kind.SPLIT:
                    seconds.append(p - exact(next(alpha), 149) * exact(change, SCALE - 149))
            values += seconds
            values += [exact(v) for v in step.adds[channel].tolist()]
        for slot, kind in zip(slots, kinds, strict=True):
            live[slot] = kind != Kind.DROP
        live += [True] * step.n_new
        yield x, live


def largest_errors(
    x: list[list[int]],
    live: list[bool],
    decoded: list[list[int]],
    origin: tuple[int, ...],
    exponents: tuple[int, ...],
) -> list[Fraction]:
    """Per channel the largest error of a live splat, in grid units."""
    unit = SCALE - LEAST_EXPONENT
    out = []
    for channel, values in enumerate(x):
        shift = exponents[GROUP_OF[channel]] - LEAST_EXPONENT
        o = origin[channel] if channel < 3 else 0
        errors = [
            abs((value << shift) - ((o + got) << unit))
            for value, got, is_live in zip(values, decoded[channel], live, strict=True)
            if is_live
        ]
        out.append(Fraction(max(errors, default=0), 1 << unit))
    return out
