"""The choices that the definition leaves open (spec/rasterizer.md, section 7)."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ALPHA_MIN", "DEFAULT", "T_MIN", "Options"]

ALPHA_MIN = 1.0 / 255.0  # a contribution below this is skipped
T_MIN = 1e-4  # a pixel stops before its transmittance would fall below this


@dataclass(frozen=True)
class Options:
    """Choices of a rendering.

    Attributes:
        near: splats with camera z at or below it are not drawn, scene units.
        alpha_max: largest alpha of one splat at one pixel.
        dilation: added to the variance of the footprint along both axes, square pixels.
        antialiased: multiply opacity by what the dilation added in area.
        max_intersections: refuse a picture with more (splat, tile) pairs than this.
    """

    near: float = 0.2
    alpha_max: float = 0.99
    dilation: float = 0.3
    antialiased: bool = False
    max_intersections: int = 1 << 32

    def __post_init__(self) -> None:
        if not 0 < self.near < float("inf"):
            raise ValueError(f"near is {self.near}, expected a positive number")
        if not ALPHA_MIN <= self.alpha_max < 1:
            raise ValueError(f"alpha_max is {self.alpha_max}, expected 1/255 <= alpha_max < 1")
        if not 0 < self.dilation < float("inf"):
            raise ValueError(f"dilation is {self.dilation}, expected a positive number")


DEFAULT = Options()
