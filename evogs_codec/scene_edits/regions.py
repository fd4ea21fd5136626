"""Parts of space, which hold splats by their positions; N splats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import SplatParams

__all__ = ["Box", "Region", "Sphere"]


class Region(Protocol):
    """A part of space."""

    def holds(self, splats: SplatParams) -> npt.NDArray[np.bool_]:
        """(N,) True for the splats whose positions are in it, its border included."""


@dataclass(frozen=True)
class Box:
    """From one corner to the opposite one, each x y z, scene units; the order does not matter."""

    corner: tuple[float, float, float]
    opposite: tuple[float, float, float]

    def holds(self, splats: SplatParams) -> npt.NDArray[np.bool_]:
        """(N,) True for the splats in it."""
        low, high = np.sort(np.array([self.corner, self.opposite], np.float64), axis=0)
        means = splats.means.astype(np.float64)
        inside: npt.NDArray[np.bool_] = ((means >= low) & (means <= high)).all(1)
        return inside

    def __str__(self) -> str:
        return "the box"


@dataclass(frozen=True)
class Sphere:
    """All that is at most `radius` from `centre`, scene units."""

    centre: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        if not self.radius >= 0:
            raise ValueError(f"a sphere has no radius of {self.radius:g}")

    def holds(self, splats: SplatParams) -> npt.NDArray[np.bool_]:
        """(N,) True for the splats in it."""
        away = splats.means.astype(np.float64) - np.array(self.centre, np.float64)
        # `hypot` of huge coordinates does not overflow.
        inside: npt.NDArray[np.bool_] = (
            np.hypot(np.hypot(away[:, 0], away[:, 1]), away[:, 2]) <= self.radius
        )
        return inside

    def __str__(self) -> str:
        return "the sphere"
