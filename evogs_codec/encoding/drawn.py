"""What pictures tell of a tree: drawing them is most of the work of an encode.

It can be kept in a file, so that a tree that is weighed twice is drawn once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from evogs_codec.encoding.measured_gains import MeasuredGains
from evogs_codec.model.splats import F32, F64

__all__ = ["Drawn"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """Of arranged tiles.

    Attributes:
        cuts: of the last levels (`cuts_of`).
        gains: of packets, where that is drawn.
        factors: of estimates, as far as they are measured (`ErrorFactors.known`).
    """

    cuts: Sequence[Sequence[F32]]
    gains: MeasuredGains | None
    factors: dict[int, F64] = field(default_factory=dict)

    def arrays(self) -> dict[str, Any]:
        """As arrays by name."""
        arrays: dict[str, Any] = {
            f"cut-{level}-{tile}": part
            for level, cut in enumerate(self.cuts)
            for tile, part in enumerate(cut)
        }
        arrays |= {f"factors-{place}": factors for place, factors in self.factors.items()}
        if self.gains is not None:
            arrays |= {f"gains-{name}": row for name, row in vars(self.gains).items()}
        return arrays

    @staticmethod
    def of_arrays(found: Mapping[str, Any]) -> Drawn:
        """From what `arrays` gave.

        Raises:
            KeyError: it is not that.
        """
        names = [name.split("-", 1) for name in found]
        of_cuts = [tuple(map(int, rest.split("-"))) for kind, rest in names if kind == "cut"]
        cuts: list[list[F32]] = [[] for _ in range(1 + max(level for level, _ in of_cuts))]
        for level, tile in sorted(of_cuts):
            cuts[level].append(found[f"cut-{level}-{tile}"])
        factors = {int(rest): found[f"factors-{rest}"] for kind, rest in names if kind == "factors"}
        gains = {rest: found[f"gains-{rest}"] for kind, rest in names if kind == "gains"}
        return Drawn(cuts, MeasuredGains(**gains) if gains else None, factors)
