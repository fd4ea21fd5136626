"""Where a scene is looked at from: values of the metadata keys `camera` and `cameras` (spec 8.4).

Whoever reads them takes a value of another form for none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

__all__ = [
    "CAMERA",
    "CAMERAS",
    "MAX_POSES",
    "Viewpoint",
    "default_viewpoint",
    "poses",
    "poses_text",
]

CAMERA, CAMERAS = "camera", "cameras"
MAX_POSES = 256
MAX_TEXT = (1 << 16) - 1  # bytes of a value
MAX_COORDINATE = 1e30  # of a coordinate

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Viewpoint:
    """A pinhole that looks at a point.

    Attributes:
        position: where it stands, in the coordinates of the stream.
        target: what is in the middle of the picture.
        fov_y: the vertical field of view, degrees.
        up: what is up in the picture; None: the up axis of the header.
    """

    position: Point
    target: Point
    fov_y: float
    up: Point | None = None

    def __str__(self) -> str:
        """The value of the metadata key."""
        return json.dumps(self.members(), separators=(",", ":"))

    def members(self) -> dict[str, object]:
        """The members of the JSON object, numbers with 7 digits."""
        up = {} if self.up is None else {"up": _rounded(self.up)}
        return {
            "position": _rounded(self.position),
            "target": _rounded(self.target),
            **up,
            "fov_y": float(f"{self.fov_y:.7g}"),
        }


def default_viewpoint(text: Mapping[str, str]) -> Viewpoint | None:
    """The default camera of metadata; None without one, or if it is malformed."""
    return _viewpoint(_parsed(text.get(CAMERA, "")))


def poses(text: Mapping[str, str]) -> list[Viewpoint]:
    """The camera poses of metadata; none if one of them is malformed, or they are too many."""
    rows = _parsed(text.get(CAMERAS, ""))
    if not isinstance(rows, list) or len(rows) > MAX_POSES:
        return []
    found = [one for one in map(_viewpoint, rows) if one is not None]
    return found if len(found) == len(rows) else []


def poses_text(viewpoints: list[Viewpoint]) -> str:
    """The value of `cameras`.

    Raises:
        ValueError: they are too many.
    """
    text = json.dumps([one.members() for one in viewpoints], separators=(",", ":"))
    if len(viewpoints) > MAX_POSES or len(text) > MAX_TEXT:
        raise ValueError(f"{len(viewpoints)} poses, at most {MAX_POSES} are stored")
    return text


def _rounded(point: Point) -> list[float]:
    return [float(f"{number:.7g}") for number in point]


def _parsed(value: str) -> object:
    if len(value) > MAX_TEXT:
        return None
    try:
        found: object = json.loads(value)
    except (ValueError, RecursionError):
        return None
    return found


def _viewpoint(row: object) -> Viewpoint | None:
    if not isinstance(row, dict):
        return None
    position, target = _point(row.get("position")), _point(row.get("target"))
    up, fov_y = row.get("up"), _number(row.get("fov_y"))
    above = _point(up)
    if position is None or target is None or fov_y is None or (above is None and "up" in row):
        return None
    ahead = [b - a for a, b in zip(position, target, strict=True)]
    if not 0 < fov_y < 180 or not _length(ahead) > 0:
        return None
    if above is not None and not _length(_cross(ahead, above)) > 1e-6 * _length(ahead) * _length(
        above
    ):
        return None
    return Viewpoint(position, target, fov_y, above)


def _number(value: object) -> float | None:
    if type(value) not in (int, float) or not abs(value) <= MAX_COORDINATE:  # type: ignore[arg-type]
        return None
    return float(value)  # type: ignore[arg-type]


def _point(value: object) -> Point | None:
    if not isinstance(value, list) or len(value) != 3:
        return None
    x, y, z = map(_number, value)
    return None if x is None or y is None or z is None else (x, y, z)


def _length(vector: Sequence[float]) -> float:
    return math.hypot(*vector)


def _cross(a: list[float], b: Point) -> list[float]:
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
