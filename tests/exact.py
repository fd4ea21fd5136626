"""Trees evaluated exactly, with fractions, to measure decoded integers against."""

from collections.abc import Iterator
from fractions import Fraction

from evogs_codec.splats import n_channels
from evogs_codec.tree import EvolutionTree, Kind

GROUP_OF = (0,) * 3 + (1,) * 4 + (2,) * 3 + (3,) + (4,) * 48


def exact_states(tree: EvolutionTree) -> Iterator[tuple[list[list[Fraction]], list[bool]]]:
    """([channel][slot], live) after each step; the lists change from one step to the next."""
    x: list[list[Fraction]] = [[] for _ in range(n_channels(tree.sh_degree))]
    live: list[bool] = []
    for step in tree.steps:
        kinds = [Kind(kind) for kind in step.kinds.tolist()]
        for channel, values in enumerate(x):
            psi = iter(step.psi[channel].tolist())
            alpha = iter(step.alpha[GROUP_OF[channel]].tolist())
            seconds = []
            for slot, kind in zip(step.slots.tolist(), kinds, strict=True):
                if kind == Kind.DROP:
                    values[slot] = Fraction(0)
                    continue
                p, change = values[slot], Fraction(next(psi))
                values[slot] = p + change
                if kind == Kind.SPLIT:
                    seconds.append(p - Fraction(next(alpha)) * change)
            values += seconds
            values += [Fraction(v) for v in step.adds[channel].tolist()]
        for slot, kind in zip(step.slots.tolist(), kinds, strict=True):
            live[slot] = kind != Kind.DROP
        live += [True] * step.n_new
        yield x, live


def largest_error(
    x: list[list[Fraction]],
    live: list[bool],
    decoded: list[list[int]],
    origin: tuple[int, ...],
    exponents: tuple[int, ...],
) -> list[Fraction]:
    """Per channel the largest error of a live splat, in grid units."""
    out = []
    for channel, values in enumerate(x):
        shift = Fraction(2) ** exponents[GROUP_OF[channel]]
        o = origin[channel] if channel < 3 else 0
        errors = [
            abs(value * shift - o - got)
            for value, got, is_live in zip(values, decoded[channel], live, strict=True)
            if is_live
        ]
        out.append(max(errors, default=Fraction(0)))
    return out
