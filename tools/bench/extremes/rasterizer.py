"""Rows of the rasterizer: projections and pictures against decimals of 50 digits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from decimal import Decimal
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams
from evogs_codec.render import Camera, Options, render, render_counted
from evogs_codec.render import projection as p
from evogs_codec.render.activated import Activated
from evogs_codec.render.forward import prepare
from evogs_codec.render.options import ALPHA_MIN, T_MIN
from evogs_codec.render.oracle import render_exactly
from evogs_codec.render.screen import LOG2E
from tools.bench.extremes import decimals
from tools.bench.extremes.decimals import Footprint
from tools.bench.extremes.row import Row, attempted, outcome
from tools.bench.extremes.views import VIEWS, ball, facing, row

__all__ = ["BACKGROUND", "footprints", "large_pictures", "pictures", "piles", "projections", "rims"]

OPTIONS = Options()
BACKGROUND = (0.2, 0.5, 1.0)
U = 2.0**-53
AGREEMENT = 1e-5  # spec/rasterizer.md 6, times the largest colour where that is above 1
N_PIXELS = 24  # of a picture, in decimals


def projections(n: int) -> Iterator[Row]:
    """Centre, covariance and determinant of the kernels, of n splats a view."""
    for name, make in VIEWS.items():
        splats, camera = make(n)
        tiles, status = prepare(Activated.of(splats), camera, OPTIONS)
        worst = 0.0
        largest = dict.fromkeys(("centre", "determinant"), 0.0)
        for i in np.flatnonzero(status == p.DRAWN):
            f = decimals.project(splats, int(i), camera, OPTIONS)
            assert f is not None
            errors = _projection_errors(tiles.records[i], f)
            bounds = _projection_bounds(splats.means[i], splats.log_scales[i], camera, f)
            worst = max([worst, *(errors[what] / bounds[what] for what in errors)])
            largest = {what: max(error, errors[what]) for what, error in largest.items()}
        observed = f"centre {largest['centre']:.2g} px, determinant {largest['determinant']:.2g}"
        yield Row(name, "rounding (section 4)", observed, worst, "")


def pictures(n: int) -> Iterator[Row]:
    """Float32 pictures of n splats a view, against the oracle and against decimals."""
    for name, make in VIEWS.items():
        splats, camera = make(n)
        yield attempted(name, "1e-5", partial(_picture, name, splats, camera))
    yield _beyond_float32()


def piles(n: int) -> Iterator[Row]:
    """N equal splats in the one pixel of a picture."""
    for logit in (-5.53, -4.0, 0.0, 40.0):
        splats = row(np.tile([0.0, 0.0, 3.0], (n, 1)), log_scales=(-9, -9, -9), logit=logit)
        camera = facing(1, 1)
        f = decimals.project(splats, 0, camera, OPTIONS)
        assert f is not None
        wanted, doubtful = decimals.pixel([f] * min(n, 5000), 0.5, 0.5, BACKGROUND, OPTIONS)
        image, counts = render_counted(splats, camera, BACKGROUND)
        error = float(np.abs(image[0, 0] - wanted).max())
        bound = _flip(f.color) if doubtful else AGREEMENT
        yield Row(
            f"{n:,} splats in one pixel, logit {logit:g}",
            f"{bound:.3g}",
            f"{error:.3g}",
            error / bound if counts.n_drawn == n else np.inf,
            f"with `max_intersections`: {outcome(partial(_bounded, splats))}",
        )


def rims(n: int) -> Iterator[Row]:
    """N piles of equal splats with their rims across a row of pixels, where roundings agree."""
    rng = np.random.default_rng(0)
    worst, camera = 0.0, facing(16, 1)
    for _ in range(n):
        height = int(rng.integers(100, 400))
        place = [3 * (rng.uniform(8, 14) / 16 - 0.5), rng.uniform(-0.2, 0.2), 3.0]
        error, is_sure = _of_pile(place, float(rng.uniform(0, 9)), height, camera)
        worst = max(worst, error if is_sure else 0.0)
    bound = f"{AGREEMENT:g}"
    name = f"{n:,} piles of 100 to 400 equal splats, seen at their rims"
    yield Row(name, bound, f"{worst:.3g}", worst / AGREEMENT, "")
    # Found among 200,000 of these: T passes 1e-4 one splat earlier, as errors of all alphas add up.
    place = [0.9123234152793884, -0.09882139414548874, 3.0]
    error, is_sure = _of_pile(place, 4.599388122558594, 225, camera)
    name = "225 equal splats at their rim, T at 1e-4"
    yield Row(name, bound, f"{error:.3g}", error / AGREEMENT if is_sure else 0.0, "")


def large_pictures(side: int) -> Iterator[Row]:
    """A picture of side x side pixels, some of its pixels in decimals."""
    camera = facing(side, side)
    splats = ball(200)
    image, counts = render_counted(splats, camera, BACKGROUND)
    on_screen = footprints(splats, camera)
    rng = np.random.default_rng(7)
    places = rng.integers(0, side, (8 * N_PIXELS, 2)).tolist()
    part, error, n_sure = _of_pixels(image, on_screen, places)
    finite = all(np.isfinite(image[y]).all() for y in range(0, side, max(1, side // 64)))
    wide = 1 << 15
    beyond = outcome(lambda: str(facing(wide + 1, 1)))
    yield Row(
        f"a picture of {side} x {side}: {n_sure} pixels of it",
        f"{AGREEMENT:g}",
        f"{error:.3g}",
        part if finite and counts.n_drawn else np.inf,
        f"{wide + 1} pixels: {beyond}",
    )


def _projection_errors(record: npt.NDArray[np.float64], f: Footprint) -> dict[str, float]:
    """By what a record holds: the error, in pixels for the centre, else relative."""
    x, y, weight, slope, curve = (
        Decimal(float(record[k])) for k in (p.X, p.Y, p.WEIGHT, p.SLOPE, p.CURVE)
    )
    half = Decimal(LOG2E) / 2  # as the kernel has it
    c = half / curve
    found = {"covariance yy": (c, f.c), "determinant": (half * c / weight**2, f.determinant)}
    errors = {what: float(abs(got - exact) / exact) for what, (got, exact) in found.items()}
    errors["centre"] = float(max(abs(x - f.x), abs(y - f.y)))
    # xy relative to the root of xx yy, which it cannot exceed
    errors["covariance xy"] = float(abs(slope * c - f.b) / (f.a * f.c).sqrt())
    return errors


def _projection_bounds(
    mean: npt.NDArray[Any], log_scale: npt.NDArray[Any], camera: Camera, f: Footprint
) -> dict[str, float]:
    """What roundings of float64 may do to each, to first order and doubled (section 4)."""
    sums = np.abs(camera.rotation) @ np.abs(mean.astype(np.float64)) + np.abs(camera.translation)
    place = camera.rotation @ mean.astype(np.float64) + camera.translation
    z = float(f.depth)
    moved = 4 * U * sums  # of x, y, z
    slope = np.abs(place[:2]) / z
    of_slope = (moved[:2] + slope * moved[2]) / z + U * slope
    focal = np.array([camera.fx, camera.fy])
    middle = np.abs([camera.cx, camera.cy])
    centre = float((focal * (of_slope + 3 * U * slope) + U * (middle + focal * slope)).max())

    u, v = (np.array([float(n) for n in axis]) for axis in (f.u, f.v))
    rho = moved[2] / z + float(of_slope.max()) + 42 * U
    clamped = np.array([camera.width / camera.fx, camera.height / camera.fy]) * 1.3 + 1
    lengths = focal / z * np.hypot(1, np.minimum(slope, clamped))
    du, dv = (rho * length * np.exp(log_scale.astype(np.float64)) for length in lengths)
    a, b, c, e = float(f.a), abs(float(f.b)), float(f.c), OPTIONS.dilation
    of_a = float((2 * np.abs(u) * du + du * du).sum()) + 4 * U * a
    of_c = float((2 * np.abs(v) * dv + dv * dv).sum()) + 4 * U * c
    of_b = float((np.abs(u) * dv + np.abs(v) * du + du * dv).sum()) + 4 * U * np.sqrt(a * c)
    turn = [1, 2, 0], [2, 0, 1]
    cross = np.abs(np.cross(u, v))
    of_cross = sum(
        np.abs(u[i]) * dv[j] + np.abs(v[j]) * du[i] + du[i] * dv[j] + 2 * U * np.abs(u[i] * v[j])
        for i, j in (turn, turn[::-1])
    )
    of_flat = float((2 * cross * of_cross + of_cross**2).sum())
    determinant = float(f.determinant)
    of_determinant = of_flat + e * (of_a + of_c) + 6 * U * determinant
    relative_c = of_c / c + 4 * U
    return {
        "centre": 2 * centre,
        "covariance yy": 2 * relative_c,
        "covariance xy": 2 * (of_b / np.sqrt(a * c) + b / np.sqrt(a * c) * relative_c + 4 * U),
        "determinant": 2 * (of_determinant / determinant + relative_c + 8 * U),
    }


def _picture(name: str, splats: SplatParams, camera: Camera) -> Row:
    image, counts = render_counted(splats, camera, BACKGROUND)
    picture = render_exactly(splats, camera, BACKGROUND)
    on_screen = footprints(splats, camera)
    brightest = max([1.0, *(float(max(f.color)) for f in on_screen)])
    difference = np.abs(image - picture.image).max(axis=2)
    sure = ~picture.doubtful
    error = float(difference[sure].max(initial=0))
    flips = float(difference[~sure].max(initial=0)) / (_flip([Decimal(brightest)]) + AGREEMENT)
    order = np.argsort(-np.where(sure, difference, -1), axis=None)[: N_PIXELS // 2]
    order = np.append(order, np.linspace(0, difference.size - 1, N_PIXELS // 2).astype(int))
    places = [(int(k) // camera.width, int(k) % camera.width) for k in order]
    part, of_decimals, _ = _of_pixels(image, on_screen, places)
    same = counts.n_non_finite == picture.n_non_finite and np.isfinite(image).all()
    bound = AGREEMENT * brightest
    left_out = f"{counts.n_invisible} invisible, {counts.n_non_finite} not finite"
    return Row(
        name,
        f"{bound:.3g}",
        f"{max(error, of_decimals):.3g}; {np.mean(sure):.0%} of pixels sure",
        max(error / bound, part, flips) if same else np.inf,
        f"{left_out} of {len(splats)}",
    )


def _of_pile(place: list[float], logit: float, n: int, camera: Camera) -> tuple[float, bool]:
    """The error of float32 at the pixel where it is furthest from float64; whether that is sure."""
    splats = row(np.tile(place, (n, 1)), log_scales=(-9, -9, -9), logit=logit, color=1.7)
    image, exact = (render(splats, camera, dtype=t)[0] for t in (np.float32, np.float64))
    x = int(np.abs(image - exact).max(axis=1).argmax())
    f = decimals.project(splats, 0, camera, OPTIONS)
    assert f is not None
    wanted, doubtful = decimals.pixel([f] * n, x + 0.5, 0.5, (0, 0, 0), OPTIONS)
    return float(np.abs(image[x] - wanted).max()), not doubtful


def _of_pixels(
    image: npt.NDArray[Any], on_screen: list[Footprint], places: Iterable[tuple[int, int]]
) -> tuple[float, float, int]:
    """Part of the bound and largest error of those that are not doubtful, and how many are not."""
    brightest = max([1.0, *(float(max(f.color)) for f in on_screen)])
    error, n_sure = 0.0, 0
    for y, x in places:
        wanted, doubtful = decimals.pixel(on_screen, x + 0.5, y + 0.5, BACKGROUND, OPTIONS)
        if not doubtful:
            error = max(error, float(np.abs(image[y, x] - wanted).max()))
            n_sure += 1
    return error / (AGREEMENT * brightest), error, n_sure


def footprints(splats: SplatParams, camera: Camera) -> list[Footprint]:
    """Those that are in front of the camera, in order of depth."""
    found = (decimals.project(splats, i, camera, OPTIONS) for i in range(len(splats)))
    return sorted((f for f in found if f is not None), key=lambda f: f.depth)


def _flip(color: Any) -> float:  # noqa: ANN401 - of decimals
    """What one decision that goes the other way changes: a splat at 1/255, or the last ones."""
    brightest = max(*map(float, color), *BACKGROUND)
    return brightest * max(ALPHA_MIN, T_MIN / (1 - OPTIONS.alpha_max)) * 1.0001


def _bounded(splats: SplatParams) -> str:
    few = Options(max_intersections=len(splats) - 1)
    render_counted(splats, facing(1, 1), options=few)
    return "drawn"


def _beyond_float32() -> Row:
    """A scale of e**400 is not finite: its splat is invisible and counted, the others are drawn."""
    splats, camera = ball(20), facing()
    scales = splats.log_scales.copy()
    scales[0] = 400
    with_it, counts = render_counted(replace(splats, log_scales=scales), camera, BACKGROUND)
    without, _ = render_counted(splats.take(np.arange(1, 20)), camera, BACKGROUND)
    n = int(np.count_nonzero(with_it != without)) + abs(counts.n_non_finite - 1)
    return Row.exact("a scale of e^400 beside others", n, with_it.size, "1 not finite of 20")
