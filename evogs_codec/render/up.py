"""Which way is up: as a file says, as cameras were held, or as the splats show.

Letters: N splats, C cameras.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from evogs_codec._generated import registry
from evogs_codec.model.scene_info import SceneInfo
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.render.camera import Camera, Vector
from evogs_codec.render.framing import bulk_of, weighted_quantiles, worth

__all__ = ["AXES", "Direction", "Up", "direction", "said_by", "shown_by", "up_of", "up_of_cameras"]

AXES = ("x", "y", "z", "-x", "-y", "-z")
Direction: TypeAlias = "str | Vector"  # one of `AXES`, or (3,)

# The ground is the layer of flat splats facing one way that has the most of the scene.
MAX_SPLATS = 60_000  # splats that are looked at
MIN_SPLATS, MIN_IN_LAYER = 200, 20  # a few splats show nothing
CONES = (math.radians(35), math.radians(20), math.radians(15))  # around a normal, more each turn
SNAP = math.radians(8)  # a direction so near to an axis is the axis
LAYERS = 64  # bins of the height; the ground is three of them
ENDS = (0.02, 0.98)  # of the weights, by height, are between the lowest and the highest layer
MIN_OF_GROUND = 0.05  # of all weight is in the ground
CLEARLY_MORE = 1.5  # times what is in the next best layer that faces another way
OTHER_DIRECTION = math.radians(25)  # directions so far apart are others
LOPSIDED = 0.25  # of the weight beyond the ground is more on one side of it than on the other
SPREAD = 1e-3  # variance of the right sides, below which cameras look one way
# Cameras are held level if their right sides vary along up by so little of the rest.
HELD_LEVEL = 0.25


@dataclass(frozen=True)
class Up:
    """A direction, and who says that it is up.

    Attributes:
        vector: (3,) of length 1.
        source: for people.
    """

    vector: tuple[float, float, float]
    source: str

    @staticmethod
    def of(vector: Direction, source: str) -> Up:
        """From an axis or a vector of any length."""
        x, y, z = (float(number) + 0.0 for number in direction(vector))  # no -0.0
        return Up((x, y, z), source)

    def __str__(self) -> str:
        return f"up is {self.name} ({self.source})"

    @property
    def name(self) -> str:
        """One of `AXES`, or three numbers."""
        for axis in AXES:
            if np.array_equal(direction(axis), self.vector):
                return axis
        return " ".join(f"{number:.2f}" for number in self.vector)


def direction(of: Direction) -> F64:
    """(3,) of length 1: of an axis x, y or z, perhaps with a sign, or of a vector.

    Raises:
        ValueError: it is neither.
    """
    if isinstance(of, str):
        name = of.removeprefix("+")
        if name not in AXES:
            raise ValueError(f"up is {of!r}, expected one of {', '.join(AXES)}")
        return np.asarray((-1.0 if name[0] == "-" else 1.0) * np.eye(3)["xyz".index(name[-1])])
    vector = np.asarray(of, np.float64)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
    if not 0 < length < math.inf:
        raise ValueError("up is no direction of three numbers")
    return vector / length


def up_of(scene: SplatParams, info: SceneInfo | None = None, cameras: Sequence[Camera] = ()) -> Up:
    """What a file says, or else cameras, or else the splats; z if none of them knows.

    Args:
        scene: N splats.
        info: what the file says of them.
        cameras: C of them, which look at the scene.
    """
    if info is not None and (axis := said_by(info)):
        return Up.of(axis, "as the file says")
    if len(cameras):
        return Up.of(up_of_cameras(cameras), "as the cameras were held")
    return shown_by(scene) or Up.of("z", "a guess, as nothing shows it: --up names another")


def shown_by(scene: SplatParams) -> Up | None:
    """What the ground of a scene shows, if it has one that is clear."""
    ground = _ground(scene)
    return None if ground is None else Up.of(ground, "estimated from the splats")


def said_by(info: SceneInfo) -> str | None:
    """The axis that a file names, if it does."""
    name = registry.name(registry.UP_AXES, info.up_axis)
    return None if name == registry.UP_AXES[0] else name.removeprefix("+")


def up_of_cameras(cameras: Sequence[Camera]) -> F64:
    """(3,) the direction that the right side of no picture has, or else the mean of their tops."""
    rights = np.array([camera.rotation[0] for camera in cameras])
    mean = -np.array([camera.rotation[1] for camera in cameras]).mean(axis=0)
    values, vectors = np.linalg.eigh(rights.T @ rights / len(rights))
    level = vectors[:, 0] * (1.0 if vectors[:, 0] @ mean >= 0 else -1.0)
    is_clear = (
        values[1] > SPREAD and values[0] <= HELD_LEVEL * values[1] and abs(level @ mean) > 0.1
    )
    if is_clear:
        return _snapped(level)
    return _snapped(mean) if np.linalg.norm(mean) > 1e-6 else direction("z")


# --- from splats ----------------------------------------------------------------------------------


def _ground(scene: SplatParams) -> F64 | None:
    """(3,) up from the ground of a scene; None if it shows none."""
    scene = scene.take(slice(None, None, max(1, -(-len(scene) // MAX_SPLATS))))
    if not np.isfinite(scene.means).all(axis=1).any():
        return None
    bulk = bulk_of(scene)
    weights = worth(scene, bulk) if 0 < bulk.size < math.inf else np.zeros(len(scene))
    near = weights > 0
    if np.count_nonzero(near) < MIN_SPLATS:
        return None
    scene, weights = scene.take(near), weights[near]
    normals, flat = _normals(scene)
    points = scene.means.astype(np.float64) - bulk.middle
    found = [_layer(points, weights, normals, weights * flat, start) for start in _starts()]
    best = max(found, key=lambda one: abs(one[0]))  # the first of equals: axes come first
    others = [
        abs(share) for share, normal in found if abs(normal @ best[1]) < math.cos(OTHER_DIRECTION)
    ]
    share, normal = best
    if abs(share) < MIN_OF_GROUND or abs(share) < CLEARLY_MORE * max(others, default=0.0):
        return None
    return _snapped(normal * np.sign(share))


def _starts() -> list[F64]:
    """Directions to begin at: axes, then diagonals of faces, then of the cube."""
    corners = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    half = [tuple(c) for c in corners.tolist() if tuple(c) > (0, 0, 0)]
    return [direction(c) for c in sorted(half, key=lambda c: sum(map(abs, c)))]


def _normals(scene: SplatParams) -> tuple[F64, F64]:
    """(N, 3) the shortest axes, and (N,) how flat the splats are: 0 round, 1 without thickness."""
    quats = scene.quats.astype(np.float64)
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    quats = np.where(lengths > 0, quats / np.where(lengths > 0, lengths, 1), [1.0, 0, 0, 0])
    shortest = np.argmin(scene.log_scales, axis=1)
    unit, (w, v) = np.eye(3)[shortest], (quats[:, :1], quats[:, 1:])
    normals = unit + 2 * np.cross(v, np.cross(v, unit) + w * unit)
    axes = np.sort(scene.log_scales.astype(np.float64), axis=1)
    return normals, 1 - np.exp(np.maximum(axes[:, 0] - axes[:, 1], -300))


def _layer(points: F64, weights: F64, normals: F64, flat: F64, start: F64) -> tuple[float, F64]:
    """The heaviest layer of flat splats that face about this way.

    Args:
        points: (N, 3).
        weights: (N,) of all splats.
        normals: (N, 3).
        flat: (N,) weights as far as splats are flat.
        start: (3,) the direction to begin with.

    Returns:
        The share of all flat weight in it, negative if the scene is behind the normal, 0 if it is
        on both sides; and the normal.
    """
    normal, total = start, float(flat.sum())
    faces = np.zeros(len(points))
    for cone in CONES:
        along = normals @ normal
        faces = np.where(np.abs(along) > math.cos(cone), flat, 0.0)
        mean = (faces * np.sign(along)) @ normals
        if not np.linalg.norm(mean) > 0:
            return 0.0, start
        normal = mean / np.linalg.norm(mean)
    normal = _snapped(normal)
    heights = points @ normal
    low, high = weighted_quantiles(heights, weights, ENDS)
    if not high > low:
        return 0.0, normal
    places = np.clip(((heights - low) / (high - low) * LAYERS).astype(np.int64), 0, LAYERS - 1)
    threes = np.convolve(np.bincount(places, faces, LAYERS), np.ones(3), "same")
    at = int(np.argmax(threes))
    above, below = (float(weights[side].sum()) for side in (places > at + 1, places < at - 1))
    n_in_it = np.count_nonzero((np.abs(places - at) <= 1) & (faces > 0))
    if abs(above - below) <= LOPSIDED * (above + below) or n_in_it < MIN_IN_LAYER:
        return 0.0, normal
    return float(threes[at]) / total * float(np.sign(above - below)), normal


def _snapped(vector: F64) -> F64:
    """The direction, or the axis that it nearly has."""
    unit = vector / np.linalg.norm(vector)
    axis = int(np.argmax(np.abs(unit)))
    if abs(unit[axis]) < math.cos(SNAP):
        return np.asarray(unit)
    return np.asarray(np.eye(3)[axis] * np.sign(unit[axis]))
