"""A procedural scene with the structure of a trained one, for demos and tests.

Other people's scenes cannot ship with the project. This one has what makes real scenes hard: thin
parts (wires, railings, grass), textured surfaces, leaves, haze, a far background, colours that
depend on the view, and the arbitrary axis orders, signs and norms that training leaves behind.

Letters: n splats of a part. World: x and y on the ground, z up, metres.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from evogs_codec.common.printable import MAX_LINE, shown
from evogs_codec.errors import InputError
from evogs_codec.io.files import SCENE, FileKind, check_target
from evogs_codec.io.makers import comment_of
from evogs_codec.io.ply import write_ply
from evogs_codec.model.splats import F64, SplatParams
from evogs_codec.render.camera import Camera, as_json, save_cameras

__all__ = ["demo_cameras", "main", "make_scene"]

SH_C0 = 0.28209479177387814  # colour = 0.5 + SH_C0 * coefficient 0
SUN = np.array([0.48, -0.36, 0.8])
UP = np.array([0.0, 0.0, 1.0])
# (eye, target), metres: over the railing into the yard, where nothing hides the objects. The orbit
# of `evogs render` also looks at the back of the wall.
VIEWS = (
    ((3.0, -9.5, 3.5), (0.5, 0.3, 0.8)),
    ((7.4, -7.3, 4.0), (0.0, 0.5, 0.7)),
    ((-5.5, -9.0, 3.4), (0.3, 0.6, 0.8)),
)
COMMAND = "python -m evogs_codec.render.demo_scene"
FIELD_OF_VIEW = math.radians(42)
Rng: TypeAlias = np.random.Generator


class Part(NamedTuple):
    """Splats of one kind of object.

    Attributes:
        means: (n, 3).
        axis: (n, 3) unit vectors along the third scale: a surface's normal, a needle's direction.
        scales: (n, 3) standard deviations, metres.
        colours: (n, 3) in 0..1.
        opacities: (n,) logits.
        gloss: (n,) strength of the highlight.
    """

    means: F64
    axis: F64
    scales: F64
    colours: F64
    opacities: F64
    gloss: F64


def make_scene(n: int = 40_000, seed: int = 0) -> SplatParams:
    """A scene of `n` splats, SH degree 3; the same numbers for the same arguments."""
    if n < 0:
        raise ValueError(f"n is {n}, expected 0 or more")
    rng = np.random.Generator(np.random.PCG64(seed))
    parts = [make(rng, m) for (make, _), m in zip(PARTS, _shares(n), strict=True)]
    part = Part(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    # Training leaves no order; neither does this.
    order = rng.permutation(n)
    return _trained(rng, Part(*(column[order] for column in part)))


def demo_cameras(width: int = 400, height: int = 300) -> list[Camera]:
    """Three cameras in front of the scene, of this many pixels."""
    return [
        Camera.look_at(eye, target, UP, width=width, height=height, fov_x=FIELD_OF_VIEW)
        for eye, target in VIEWS
    ]


def _has_demo_cameras(path: Path, _command: str) -> bool:
    """Whether a file has the cameras that are written, so that nothing is lost."""
    return path.read_bytes() == as_json(demo_cameras()).encode()


CAMERAS = FileKind("list of cameras", (b'{\n "cameras"',), made_by=_has_demo_cameras)


def main(argv: Sequence[str] | None = None) -> None:
    """Write the scene to a `.ply`, and cameras that show it to JSON."""
    parser = argparse.ArgumentParser(
        prog=COMMAND,
        description="Write a procedural 3DGS scene (SH degree 3).",
        epilog="example: python -m evogs_codec.render.demo_scene build/demo.ply --splats 40000",
    )
    parser.add_argument("out", metavar="OUT.ply", type=Path)
    parser.add_argument("--force", action="store_true", help="replace files of others too")
    parser.add_argument("--splats", type=int, default=40_000, metavar="N", help="default: 40000")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="default: 0")
    parser.add_argument(
        "--cameras",
        type=Path,
        metavar="FILE.json",
        help="also write three cameras, for --camera of `evogs render` and `evogs psnr`",
    )
    args = parser.parse_args(argv)
    if args.splats < 0 or args.seed < 0:
        parser.error("--splats and --seed must be 0 or more")
    try:
        check_target(args.out, SCENE, command=COMMAND, force=args.force)
        if args.cameras is not None:
            check_target(
                args.cameras, CAMERAS, command=COMMAND, sources=[args.out], force=args.force
            )
        comments = ["procedural scene of evogs", comment_of(COMMAND)]
        write_ply(args.out, make_scene(args.splats, args.seed), comments)
        if args.cameras is not None:
            save_cameras(args.cameras, demo_cameras())
    except OSError as error:
        parser.exit(1, shown(f"{args.out}: cannot be written: {error.strerror}", MAX_LINE) + "\n")
    except InputError as error:
        parser.exit(1, shown(error, MAX_LINE) + "\n")
    print(f"{shown(args.out)}: {args.splats} splats")


# ----------------------------------------------------------------------------------------- parts


def _ground(rng: Rng, n: int) -> Part:
    """Checkered floor, a few millimetres rough."""
    xy = rng.uniform(-6, 6, (n, 2))
    tiles = np.floor(xy).sum(1) % 2
    shade = 0.35 + 0.35 * tiles + 0.08 * _noise(xy[:, 0], xy[:, 1], 0 * tiles)
    colours = shade[:, None] * np.array([1.0, 0.96, 0.9])
    means = np.column_stack([xy, 0.004 * rng.standard_normal(n)])
    return _surface(rng, means, np.tile(UP, (n, 1)), colours, area=144.0, gloss=0.15)


def _wall(rng: Rng, n: int) -> Part:
    """Brick wall with recessed mortar."""
    x, z = rng.uniform(-6, 6, n), rng.uniform(0, 3, n)
    row = np.floor(z / 0.15)
    along = (x / 0.4 + 0.5 * (row % 2)) % 1
    mortar = (along < 0.06) | ((z / 0.15) % 1 < 0.12)
    tint = 0.1 * _noise(np.floor(x / 0.4 + 0.5 * (row % 2)), row, 0 * x)
    brick = np.array([0.62, 0.3, 0.22]) + tint[:, None]
    colours = np.where(mortar[:, None], 0.7, brick)
    y = 5.0 + 0.02 * mortar + 0.003 * rng.standard_normal(n)
    normals = np.tile([0.0, -1.0, 0.0], (n, 1))
    return _surface(rng, np.column_stack([x, y, z]), normals, colours, area=36.0, gloss=0.03)


def _balls(rng: Rng, n: int) -> Part:
    """Three glossy spheres with a marbled colour."""
    normals = _directions(rng, n)
    ball = rng.integers(0, 3, n)
    radii = np.array([0.9, 0.6, 0.4])[ball]
    centres = np.array([[-1.5, 0.5, 0.9], [0.6, -1.2, 0.6], [1.9, 1.0, 0.4]])[ball]
    means = centres + radii[:, None] * normals
    vein = 0.5 + 0.5 * np.sin(6 * means[:, 0] + 3 * _noise(*(2.5 * means.T)))
    base = np.array([[0.2, 0.45, 0.75], [0.8, 0.65, 0.2], [0.7, 0.2, 0.35]])[ball]
    colours = base * (0.5 + 0.5 * vein[:, None])
    return _surface(rng, means, normals, colours, area=5.6, gloss=0.8)


def _torus(rng: Rng, n: int) -> Part:
    """Striped ring standing on the floor."""
    u, v = rng.uniform(0, 2 * np.pi, (2, n))
    spoke = np.column_stack([np.cos(u), 0 * u, np.sin(u)])
    normals = np.cos(v)[:, None] * spoke + np.sin(v)[:, None] * np.array([0.0, 1.0, 0.0])
    means = np.array([3.0, -1.5, 1.0]) + 0.8 * spoke + 0.2 * normals
    stripe = (np.floor((u + v) * 6 / np.pi) % 2)[:, None]
    colours = stripe * np.array([0.85, 0.82, 0.78]) + (1 - stripe) * np.array([0.1, 0.35, 0.3])
    return _surface(rng, means, normals, colours, area=6.3, gloss=0.5)


def _wires(rng: Rng, n: int) -> Part:
    """Cables that sag between two masts."""
    t, cable = rng.uniform(-1, 1, n), rng.integers(0, 5, n)
    sag = 0.3 + 0.08 * cable
    z = 3.2 + 0.12 * cable + sag * (t**2 - 1)
    means = np.column_stack([5.5 * t, 3.5 + 0.25 * cable, z])
    axis = np.column_stack([np.full(n, 5.5), 0 * t, 2 * sag * t])
    return _needles(rng, means, axis, 0.004, 55.0 / max(n, 1), np.full((n, 3), 0.07))


def _railing(rng: Rng, n: int) -> Part:
    """Upright bars and two rails."""
    upright = rng.random(n) < 0.7
    bar = rng.integers(0, 60, n) * 0.2 - 6
    x = np.where(upright, bar, rng.uniform(-6, 6, n))
    z = np.where(upright, rng.uniform(0, 1, n), rng.choice([0.15, 1.0], n))
    axis = np.where(upright[:, None], UP, np.array([1.0, 0.0, 0.0]))
    means = np.column_stack([x, np.full(n, -5.0), z])
    colours = np.tile([0.22, 0.25, 0.28], (n, 1)) + 0.03 * rng.standard_normal((n, 1))
    return _needles(rng, means, axis, 0.008, 84.0 / max(n, 1), colours)


def _grass(rng: Rng, n: int) -> Part:
    """Blades in tufts, greener at the root."""
    tufts = rng.uniform([-6, -4.8], [6, -3.2], (max(n // 30, 1), 2))
    root = tufts[rng.integers(0, len(tufts), n)] + 0.05 * rng.standard_normal((n, 2))
    lean = np.column_stack([0.35 * rng.standard_normal((n, 2)), np.ones(n)])
    height = rng.uniform(0.02, 0.22, n)
    means = np.column_stack([root, np.zeros(n)]) + height[:, None] * lean
    dry = (height / 0.22)[:, None] * rng.uniform(0.2, 1, (n, 1))
    colours = (1 - dry) * np.array([0.13, 0.32, 0.07]) + dry * np.array([0.6, 0.58, 0.25])
    return _needles(rng, means, lean, 0.003, 0.05, colours)


def _bush(rng: Rng, n: int) -> Part:
    """Leaves in every direction, denser toward the outside."""
    out = _directions(rng, n)
    means = np.array([-3.8, 2.2, 0.9]) + out * (0.85 * rng.random((n, 1)) ** 0.2)
    means += 0.1 * _noise(*(4 * out.T))[:, None] * out
    normals = _unit(out + 0.8 * rng.standard_normal((n, 3)))
    colours = np.array([0.16, 0.36, 0.1]) * rng.uniform(0.5, 1.5, (n, 1))
    return _surface(rng, means, normals, colours, area=20.0, gloss=0.25)


def _haze(rng: Rng, n: int) -> Part:
    """Large faint blobs over the whole scene, and the floaters that training leaves."""
    means = rng.normal([0, 0, 1.5], [4, 4, 1], (n, 3))
    scales = np.exp(rng.normal(-0.9, 0.7, (n, 3)))
    colours = np.tile([0.72, 0.76, 0.82], (n, 1)) + 0.04 * rng.standard_normal((n, 3))
    opacities = rng.normal(-3.2, 0.6, n)
    return Part(means, _directions(rng, n), scales, colours, opacities, np.zeros(n))


def _dome(rng: Rng, n: int) -> Part:
    """Sky and hills far away, splats as large as the gaps between them."""
    out = _directions(rng, n)
    out[:, 2] = np.abs(out[:, 2])
    distance = np.exp(rng.normal(np.log(80), 0.25, n))
    means = distance[:, None] * out
    hill = 0.12 + 0.06 * _noise(*(3 * out.T)) > out[:, 2]
    sky = np.array([0.85, 0.9, 0.95]) - np.clip(out[:, 2:], 0, 1) * np.array([0.5, 0.35, 0.1])
    colours = np.where(hill[:, None], np.array([0.35, 0.42, 0.4]), sky)
    colours += 0.03 * _noise(*(8 * out.T))[:, None]
    part = _surface(rng, means, -out, colours, area=2 * np.pi, gloss=0.0)
    return part._replace(scales=part.scales * distance[:, None])


# Share of the splats that each part gets, in percent.
PARTS: tuple[tuple[Callable[[Rng, int], Part], int], ...] = (
    (_ground, 16),
    (_wall, 16),
    (_balls, 14),
    (_torus, 9),
    (_wires, 5),
    (_railing, 7),
    (_grass, 12),
    (_bush, 10),
    (_haze, 3),
    (_dome, 8),
)


def _shares(n: int) -> list[int]:
    """Splats of each part; they add up to `n`."""
    ends = [n * percent // 100 for percent in np.cumsum([share for _, share in PARTS])]
    return [int(m) for m in np.diff(ends, prepend=0)]


def _surface(
    rng: Rng, means: F64, normals: F64, colours: F64, *, area: float, gloss: float
) -> Part:
    """Flat splats that cover `area` m^2 between them."""
    n = len(means)
    gap = np.sqrt(area / max(n, 1))
    scales = gap * np.exp(rng.normal([-0.35, -0.35, -3.0], [0.35, 0.35, 0.6], (n, 3)))
    opacities = rng.normal(3.0, 2.2, n)
    return Part(means, normals, scales, colours, opacities, np.full(n, gloss))


def _needles(rng: Rng, means: F64, axis: F64, radius: float, length: float, colours: F64) -> Part:
    """Thin splats along `axis`."""
    n = len(means)
    middle = np.log([radius, radius, max(0.6 * length, 2 * radius)])
    scales = np.exp(rng.normal(middle, [0.25, 0.25, 0.4], (n, 3)))
    opacities = rng.normal(1.5, 2.0, n)
    return Part(means, _unit(axis), scales, colours, opacities, np.full(n, 0.1))


# ------------------------------------------------------------------------------- splat statistics


def _trained(rng: Rng, part: Part) -> SplatParams:
    """The parameters that a trainer would have left for `part`."""
    n = len(part.means)
    quats, log_scales = _shuffled_axes(rng, _turned(rng, part.axis), np.log(part.scales))
    norms = np.exp(rng.normal(0, 0.35, (n, 1))) * rng.choice([-1.0, 1.0], (n, 1))
    return SplatParams(
        means=part.means.astype(np.float32),
        quats=(norms * quats).astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        opacity_logits=np.clip(part.opacities, -4, 8).astype(np.float32),
        sh=_sh(rng, part).astype(np.float32),
    )


def _turned(rng: Rng, axis: F64) -> F64:
    """(n, 4) quaternions that take z to `axis` after any turn about z."""
    half = rng.uniform(0, np.pi, len(axis))
    spin = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    # Half-way between z and the axis; straight down has no half-way, so any half turn does.
    swing = np.column_stack([1 + axis[:, 2], -axis[:, 1], axis[:, 0], 0 * half])
    swing[axis[:, 2] < -1 + 1e-9] = [0, 1, 0, 0]
    return _product(_unit(swing), spin)


def _shuffled_axes(rng: Rng, quats: F64, log_scales: F64) -> tuple[F64, F64]:
    """The same ellipsoids with their axes in any order."""
    r = np.sqrt(0.5)
    quarter = [[1, 0, 0, 0], [r, r, 0, 0], [r, 0, r, 0], [r, 0, 0, r]]
    third = [[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5]]
    turns = np.array([*quarter, *third])
    # Axis i of the turned splat is axis orders[i] of the splat, up to its sign.
    orders = np.array([[0, 1, 2], [0, 2, 1], [2, 1, 0], [1, 0, 2], [1, 2, 0], [2, 0, 1]])
    which = rng.integers(0, len(turns), len(quats))
    return _product(quats, turns[which]), np.take_along_axis(log_scales, orders[which], 1)


def _sh(rng: Rng, part: Part) -> F64:
    """(n, 16, 3): shaded colour, a highlight around the mirrored sun, and training noise."""
    facing = part.axis @ SUN
    shaded = part.colours * (0.65 + 0.35 * np.abs(facing))[:, None]
    # A camera sees the sun mirrored when it looks along this direction.
    mirrored = SUN - 2 * facing[:, None] * part.axis
    falloff = np.repeat([0.0, 0.5, 0.3, 0.16], [1, 3, 5, 7])
    patchy = part.gloss * (0.7 + 0.3 * _noise(*part.means.T))
    lobe = patchy[:, None] * falloff * _sh_basis(mirrored)
    tint = 0.6 + 0.4 * part.colours
    noise = np.repeat([0.02, 0.03, 0.022, 0.018], [1, 3, 5, 7])[:, None]
    # Noise of trained scenes is mostly grey and has heavy tails.
    grey = rng.standard_t(4, (len(facing), 16, 1))
    coloured = rng.standard_normal((len(facing), 16, 3))
    sh = lobe[:, :, None] * tint[:, None, :] + noise * (0.8 * grey + 0.4 * coloured)
    sh[:, 0] += (shaded - 0.5) / SH_C0
    return np.asarray(sh, np.float64)


def _sh_basis(directions: F64) -> F64:
    """(n, 16) real spherical harmonics of unit vectors, with the signs of 3DGS."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    return np.column_stack(
        [
            np.full_like(x, SH_C0),
            *(0.4886025119029199 * f for f in (-y, z, -x)),
            *(1.0925484305920792 * f for f in (x * y, -y * z)),
            0.31539156525252005 * (2 * zz - xx - yy),
            *(1.0925484305920792 * f for f in (-x * z, 0.5 * (xx - yy))),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ]
    )


# ------------------------------------------------------------------------------------- arithmetic


def _noise(x: F64, y: F64, z: F64) -> F64:
    """Smooth pseudo-random values in about -1..1: waves at four octaves, bent by each other."""
    total = np.zeros_like(x)
    for octave in range(4):
        f = 1.9**octave
        bend = 0.7 * np.sin(f * (0.8 * z - 0.5 * x) + 1.3 * octave)
        total += np.sin(f * (x + 0.6 * y) + bend) * np.cos(f * (y - 0.4 * z) - bend) / 1.6**octave
    return total / 2


def _directions(rng: Rng, n: int) -> F64:
    return _unit(rng.standard_normal((n, 3)))


def _unit(v: F64) -> F64:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True), np.float64)


def _product(p: F64, q: F64) -> F64:
    """(n, 4) Hamilton products, w first."""
    pw, pv, qw, qv = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    w = pw * qw - (pv * qv).sum(1, keepdims=True)
    return np.column_stack([w, pw * qv + qw * pv + np.cross(pv, qv)])


if __name__ == "__main__":
    main()
