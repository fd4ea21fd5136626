"""The definition of pictures (spec/rasterizer.md 1 to 5) in decimals of 50 digits.

Parameters, cameras and options are taken as the exact numbers that they are; square roots,
exponentials and quotients are right to 50 digits. One splat and one pixel at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from evogs_codec.render import Camera, Options
from evogs_codec.render.splats import Splats

__all__ = ["Footprint", "covariance", "pixel", "project"]

P = ParamSpec("P")
R = TypeVar("R")
Vector = Sequence[Decimal]
DIGITS = 50
ALPHA_MIN_INVERSE, T_MIN = Decimal(255), Decimal("1e-4")
CLOSE = Decimal("1e-5")  # relative distance from a threshold that makes a pixel doubtful
CLOSE_T = Decimal("2e-4")  # that from the threshold of transmittance


@dataclass(frozen=True)
class Footprint:
    """A splat on the screen.

    Attributes:
        x, y: centre, pixels.
        u, v: rows of U, (3,).
        a, b, c: covariance, dilated.
        determinant: of it.
        color: (3,).
        opacity, depth: as blended and ordered by.
    """

    x: Decimal
    y: Decimal
    u: Vector
    v: Vector
    a: Decimal
    b: Decimal
    c: Decimal
    determinant: Decimal
    color: Vector
    opacity: Decimal
    depth: Decimal


def _precise(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with 50 digits and exponents without practical bounds."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with localcontext(prec=DIGITS, Emax=10**9, Emin=-(10**9)):
            return function(*args, **kwargs)

    return run


@_precise
def project(splats: Splats, i: int, camera: Camera, options: Options) -> Footprint | None:
    """Sections 2 to 4 for splat i; None where it is not in front of the near plane."""
    mean, quat, scales = (
        _decimals(rows[i]) for rows in (splats.means, splats.quats, splats.log_scales)
    )
    rotation = [_decimals(row) for row in camera.rotation]
    offset = _decimals(camera.translation)
    x, y, z = (_dot(row, mean) + t for row, t in zip(rotation, offset, strict=True))
    if not z > Decimal(options.near):
        return None
    fx, fy, cx, cy = (Decimal(n) for n in (camera.fx, camera.fy, camera.cx, camera.cy))
    slope_x, slope_y = _clamped(x / z, camera.width, fx, cx), _clamped(y / z, camera.height, fy, cy)
    to_u = [fx / z * (a - slope_x * b) for a, b in zip(rotation[0], rotation[2], strict=True)]
    to_v = [fy / z * (a - slope_y * b) for a, b in zip(rotation[1], rotation[2], strict=True)]
    turn = _matrix(quat)
    columns = [[row[j] for row in turn] for j in range(3)]
    deviations = [s.exp() for s in scales]
    u, v = (
        [_dot(w, column) * s for column, s in zip(columns, deviations, strict=True)]
        for w in (to_u, to_v)
    )
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    uu, vv, e, flat = _dot(u, u), _dot(v, v), Decimal(options.dilation), _dot(cross, cross)
    determinant = flat + e * (uu + vv) + e * e
    opacity = 1 / (1 + (-Decimal(float(splats.opacity_logits[i]))).exp())
    if options.antialiased:
        opacity *= (flat / determinant).sqrt()
    back = [-_dot([row[k] for row in rotation], offset) for k in range(3)]  # the camera's place
    color = _color([m - p for m, p in zip(mean, back, strict=True)], splats.sh[i])
    centre = fx * x / z + cx, fy * y / z + cy
    a, b, c = uu + e, _dot(u, v), vv + e
    return Footprint(*centre, u, v, a, b, c, determinant, color, opacity, z)


@_precise
def covariance(splats: Splats, i: int) -> list[Decimal]:
    """(9,) of splat i in the world, R diag(s**2) R^T, row by row."""
    turn = _matrix(_decimals(splats.quats[i]))
    squares = [(2 * s).exp() for s in _decimals(splats.log_scales[i])]
    scaled = [[t * s for t, s in zip(row, squares, strict=True)] for row in turn]
    return [_dot(a, b) for a in scaled for b in turn]


@_precise
def pixel(
    footprints: Iterable[Footprint],
    x: float,
    y: float,
    background: Sequence[float],
    options: Options,
) -> tuple[list[float], bool]:
    """Section 5 at a pixel centre, of footprints in order of depth; and whether it is doubtful."""
    color, rest = [Decimal(0)] * 3, Decimal(1)
    doubtful, depth = False, Decimal("-Infinity")
    largest = Decimal(options.alpha_max)
    for f in footprints:
        dx, dy = Decimal(x) - f.x, Decimal(y) - f.y
        sigma = ((dx - f.b / f.c * dy) ** 2 * f.c / f.determinant + dy * dy / f.c) / 2
        reached = f.opacity * (-sigma).exp()
        alpha = min(largest, reached)
        doubtful |= _is_close(reached * ALPHA_MIN_INVERSE, Decimal(1))
        if alpha * ALPHA_MIN_INVERSE < 1:
            continue
        after = rest * (1 - alpha)
        doubtful |= _is_close(after, T_MIN, CLOSE_T) or _is_close(reached, largest)
        doubtful |= 0 < f.depth - depth <= CLOSE * f.depth
        depth = f.depth
        if after < T_MIN:
            break
        color = [c + alpha * rest * own for c, own in zip(color, f.color, strict=True)]
        rest = after
    behind = [Decimal(b) for b in background]
    return [float(c + rest * b) for c, b in zip(color, behind, strict=True)], doubtful


def _decimals(values: Any) -> list[Decimal]:  # noqa: ANN401 - an array of any float type
    return [Decimal(float(v)) for v in values]


def _dot(a: Vector, b: Vector) -> Decimal:
    return sum((x * y for x, y in zip(a, b, strict=True)), Decimal(0))


def _clamped(slope: Decimal, size: int, focal: Decimal, middle: Decimal) -> Decimal:
    margin = Decimal("0.15") * size / focal
    return min(max(slope, -middle / focal - margin), (size - middle) / focal + margin)


def _matrix(quat: Vector) -> list[list[Decimal]]:
    """The rotation of a quaternion of any length; zero is the identity."""
    square = _dot(quat, quat)
    if not square:
        return [[Decimal(int(i == j)) for j in range(3)] for i in range(3)]
    w, x, y, z = quat
    n = 2 / square
    return [
        [1 - n * (y * y + z * z), n * (x * y - w * z), n * (x * z + w * y)],
        [n * (x * y + w * z), 1 - n * (x * x + z * z), n * (y * z - w * x)],
        [n * (x * z - w * y), n * (y * z + w * x), 1 - n * (x * x + y * y)],
    ]


def _color(direction: Vector, sh: Any) -> list[Decimal]:  # noqa: ANN401 - as above
    """Section 3."""
    length = _dot(direction, direction).sqrt()
    x, y, z = (d / length for d in direction)
    xx, yy, zz = x * x, y * y, z * z
    functions = (
        ("0.28209479177387814", Decimal(1)),
        ("-0.4886025119029199", y),
        ("0.4886025119029199", z),
        ("-0.4886025119029199", x),
        ("1.0925484305920792", x * y),
        ("-1.0925484305920792", y * z),
        ("0.31539156525252005", 2 * zz - xx - yy),
        ("-1.0925484305920792", x * z),
        ("0.5462742152960396", xx - yy),
        ("-0.5900435899266435", y * (3 * xx - yy)),
        ("2.890611442640554", x * y * z),
        ("-0.4570457994644658", y * (4 * zz - xx - yy)),
        ("0.3731763325901154", z * (2 * zz - 3 * xx - 3 * yy)),
        ("-0.4570457994644658", x * (4 * zz - xx - yy)),
        ("1.445305721320277", z * (xx - yy)),
        ("-0.5900435899266435", x * (xx - 3 * yy)),
    )
    basis = [Decimal(factor) * value for factor, value in functions[: len(sh)]]
    return [
        max(Decimal(0), Decimal("0.5") + _dot(basis, _decimals(sh[:, channel])))
        for channel in range(3)
    ]


def _is_close(value: Decimal, threshold: Decimal, distance: Decimal = CLOSE) -> bool:
    return abs(value - threshold) <= distance * threshold
