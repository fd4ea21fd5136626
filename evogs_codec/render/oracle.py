"""The definition, read aloud: float64, one splat after the other over the whole picture, no tiles.

Sections are those of spec/rasterizer.md. Slow on purpose; tests compare the kernels with it. It
also says which pixels are too close to a threshold for two correct implementations to agree on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.render.camera import Camera
from evogs_codec.render.options import ALPHA_MIN, DEFAULT, T_MIN, Options
from evogs_codec.render.splats import Splats

__all__ = ["Picture", "Projected", "project_one", "render_exactly"]

F64 = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

CLOSE = 1e-5  # relative distance from a threshold, or between two depths
CLOSE_T = 2e-4  # from the threshold of transmittance, to which the errors of all alphas add up


@dataclass(frozen=True, eq=False)
class Picture:
    """What the definition gives.

    Attributes:
        image: (H, W, 3).
        doubtful: (H, W) pixels with a decision so close that it may go the other way.
        n_non_finite: splats left out because a number of them is not finite.
    """

    image: F64
    doubtful: Bools
    n_non_finite: int


@dataclass(frozen=True, eq=False)
class Projected:
    """A splat on the screen: centre and covariance in pixels, R G B, opacity, camera z."""

    center: F64
    covariance: F64
    determinant: float
    colour: F64
    opacity: float
    depth: float


def render_exactly(
    splats: Splats,
    camera: Camera,
    background: npt.ArrayLike = (0.0, 0.0, 0.0),
    *,
    options: Options = DEFAULT,
) -> Picture:
    """The picture of `splats` (arrays as `SplatParams` has them) by the definition."""
    projected: list[Projected] = []
    n_non_finite = 0
    for i in range(len(splats.means)):
        try:
            splat = project_one(splats, i, camera, options)
        except ArithmeticError:
            n_non_finite += 1
            continue
        if splat is not None:
            projected.append(splat)
    # "Splats are drawn in order of camera z, equal ones in order of index."
    projected.sort(key=lambda splat: splat.depth)

    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    image = np.zeros((camera.height, camera.width, 3))
    transmittance = np.ones((camera.height, camera.width))
    is_open = np.ones(transmittance.shape, bool)
    doubtful = np.zeros(transmittance.shape, bool)
    depth_before = np.full(transmittance.shape, -math.inf)
    for splat in projected:
        reached = splat.opacity * np.exp(-_sigma(splat, x, y))
        alpha = np.minimum(options.alpha_max, reached)
        counts = is_open & (alpha >= ALPHA_MIN)
        rest = transmittance * (1 - alpha)
        takes = counts & (rest >= T_MIN)

        doubtful |= is_open & (_close(reached, ALPHA_MIN) | (counts & _close(rest, T_MIN, CLOSE_T)))
        doubtful |= counts & _close(reached, options.alpha_max)
        behind = splat.depth - depth_before  # 0: index decides, in every arithmetic
        doubtful |= counts & (behind > 0) & (behind <= CLOSE * splat.depth)
        depth_before = np.where(counts, splat.depth, depth_before)

        image += np.where(takes, alpha * transmittance, 0.0)[..., None] * splat.colour
        transmittance = np.where(takes, rest, transmittance)
        is_open &= takes | ~counts
    image += transmittance[..., None] * np.asarray(background, np.float64)
    return Picture(image, doubtful, n_non_finite)


def project_one(splats: Splats, i: int, camera: Camera, options: Options) -> Projected | None:
    """Sections 2-4 for splat i; None where it is not drawn.

    Raises:
        FloatingPointError: a number of it is not finite.
    """
    mean, quat, log_scale, logit, sh = (
        np.asarray(array[i], np.float64)
        for array in (
            splats.means, splats.quats, splats.log_scales, splats.opacity_logits, splats.sh,
        )
    )  # fmt: skip
    if not all(np.isfinite(array).all() for array in (mean, quat, log_scale, logit, sh)):
        raise FloatingPointError(f"splat {i} has a parameter that is not finite")
    x, y, z = camera.rotation @ mean + camera.translation
    if not z > options.near:
        return None
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        u, v = _projection_matrix(camera, x, y, z) @ _rotation(quat) @ np.diag(np.exp(log_scale))
        flat = float(np.sum(np.cross(u, v) ** 2))
        e = options.dilation
        covariance = np.array([[u @ u + e, u @ v], [u @ v, v @ v + e]])
        # "det(U U^T + e I) = |u x v|^2 + e (|u|^2 + |v|^2) + e^2"
        determinant = flat + e * float(u @ u + v @ v) + e * e
        opacity = 1 / (1 + math.exp(-logit)) if logit > -700 else 0.0
        if options.antialiased:
            opacity *= math.sqrt(max(0.0, flat / determinant))
        center = np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
        return Projected(center, covariance, determinant, _colour(mean, sh, camera), opacity, z)


def _projection_matrix(camera: Camera, x: float, y: float, z: float) -> F64:
    """W = J R of section 4: how a small step in the world moves on the screen."""
    margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    left, right = -camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    top, bottom = -camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    tx = z * np.clip(x / z, left - margin_x, right + margin_x)
    ty = z * np.clip(y / z, top - margin_y, bottom + margin_y)
    jacobian = np.array(
        [
            [camera.fx / z, 0, -camera.fx * tx / z**2],
            [0, camera.fy / z, -camera.fy * ty / z**2],
        ]
    )
    return jacobian @ camera.rotation


def _rotation(quat: F64) -> F64:
    """The rotation of a quaternion w x y z; "the zero quaternion is the identity"."""
    norm = np.linalg.norm(quat)
    w, x, y, z = quat / norm if norm > 0 else (1.0, 0.0, 0.0, 0.0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _colour(mean: F64, sh: F64, camera: Camera) -> F64:
    """Section 3: the colour seen from the camera."""
    direction = mean - camera.position
    x, y, z = direction / np.linalg.norm(direction)
    xx, yy, zz = x * x, y * y, z * z
    basis = [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return np.maximum(0.0, np.array(basis[: len(sh)]) @ sh + 0.5)


def _sigma(splat: Projected, x: F64, y: F64) -> F64:
    """Half the squared Mahalanobis distance of every pixel, as a sum of squares."""
    dx, dy = x - splat.center[0], y - splat.center[1]
    (_, xy), (_, yy) = splat.covariance
    across = dx - xy / yy * dy
    with np.errstate(over="ignore", under="ignore"):
        sigma: F64 = 0.5 * (across * across * (yy / splat.determinant) + dy * dy / yy)
    return sigma


def _close(value: F64, threshold: float, distance: float = CLOSE) -> Bools:
    close: Bools = np.abs(value - threshold) <= distance * threshold
    return close
