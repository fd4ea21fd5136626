"""What a stream says about the scene as a whole, beside its splats (spec 5.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["SceneInfo"]


@dataclass(frozen=True)
class SceneInfo:
    """What a stream says of its scene; the numbers are those of `spec/registry.csv`."""

    coordinate_system: int = 0
    up_axis: int = 0
    unit: int = 0
    colour_space: int = 0
    antialiased: bool = False
    text: Mapping[str, str] = field(default_factory=dict)
