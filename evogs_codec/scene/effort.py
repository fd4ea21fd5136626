"""Effort: how much work an encode is, by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from evogs_codec.lifting.lift import N_NEIGHBOURS

if TYPE_CHECKING:
    from evogs_codec.render import Views

__all__ = ["EFFORTS", "MAX_ZSTD_LEVEL", "Effort"]

MAX_ZSTD_LEVEL = 22


@dataclass(frozen=True)
class Effort:
    """What an encode may spend.

    Attributes:
        zstd_level: of packets, 1 to 22.
        n_neighbours: of a splat, among which one is found that it is paired with.
        n_views: views by which errors are weighed, at most, where there is no target.
        pixels: of the longer side of views by which errors are weighed, at most; None: as they are.
        all_round: of these views some stand below the scene and far above it.
        price: factor of `SCENE_PRICE`: smaller views show less of an error of small splats.
        n_ordering_views: views by which packets are put in order, at most.
        ordering_pixels: of the longer side of these, at most.
        by_leaves: only the last level is drawn: what numbers of the others are worth follows from
            it, and estimates put packets in order.
        looks: look at prefixes: their PSNR is stored, and none looks worse than a shorter one.
    """

    zstd_level: int = 18
    n_neighbours: int = N_NEIGHBOURS
    n_views: int = 12
    pixels: int | None = 320
    all_round: bool = True
    price: float = 0.78
    n_ordering_views: int = 2
    ordering_pixels: int | None = 200
    by_leaves: bool = False
    looks: bool = True

    def ordering_views(self, views: Views) -> Views:
        """Those of the views by which packets are put in order."""
        return views.fewer(self.n_ordering_views).within(self.ordering_pixels)

    @staticmethod
    def of(asked: str | int | None) -> Effort:
        """By its name in `EFFORTS`, or the default with a level of Zstandard; None: the default.

        Raises:
            ValueError: there is no such effort.
        """
        if asked is None or isinstance(asked, str):
            name = "default" if asked is None else asked
            if name not in EFFORTS:
                known = ", ".join(EFFORTS)
                raise ValueError(f"effort is {name!r}, expected {known} or 1..{MAX_ZSTD_LEVEL}")
            return EFFORTS[name]
        if not 1 <= asked <= MAX_ZSTD_LEVEL:
            raise ValueError(f"effort is {asked}, expected 1..{MAX_ZSTD_LEVEL}")
        return replace(EFFORTS["default"], zstd_level=asked)


EFFORTS = {
    # Zstandard 16 is the first level that weighs matches by what they cost: below, 7 % are lost.
    "fast": Effort(
        zstd_level=16,
        n_neighbours=4,
        n_views=6,
        pixels=300,
        all_round=False,
        price=1.0,
        by_leaves=True,
        looks=False,
    ),
    "default": Effort(),
    # More or larger views that weigh errors gain nothing: what each of them tells is exact.
    "best": Effort(zstd_level=22, n_ordering_views=3, ordering_pixels=None),
}
