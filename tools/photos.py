"""Photographs of the procedural scene, so that training needs nothing from elsewhere.

The cameras are exact, and what they see is the scene itself: a trainer that finds the scene again
reaches any PSNR that 8 bits a channel allow.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from evogs_codec import InputError, read_ply
from evogs_codec.model.splats import SplatParams
from evogs_codec.render import Camera, Options, draw
from evogs_codec.render.demo_scene import SH_C0, make_scene
from reference_trainer.data.distortion import undistort
from reference_trainer.data.pyramid import area_average
from tools.photo_formats import FORMATS, Cloud, Shot

__all__ = ["Framing", "cloud_of", "main", "photograph", "shooting_cameras"]

F32: TypeAlias = npt.NDArray[np.float32]
Real: TypeAlias = npt.NDArray[np.floating[Any]]
Distortion: TypeAlias = tuple[float, float, float, float]

ELEVATIONS = (0.4, 1.0)  # radians; over the wall, which is 3 m high
FOV_X = 0.85
TEST_EVERY = 8
N_POINTS = 4000  # of the cloud, at most
STRIDE = math.sqrt(2)  # of heights, in turns: every subset of views has all heights
FINE = 2  # samples a side of a pixel, behind a lens that distorts


class Framing(NamedTuple):
    """Where cameras look, and from how far, in the scene's units; z is up."""

    centre: tuple[float, float, float]
    radius: float

    @staticmethod
    def of(splats: SplatParams) -> Framing:
        """Around the bulk of any scene.

        Raises:
            ValueError: it has no splats.
        """
        if not len(splats):
            raise ValueError("no splats to photograph")
        low, high = np.percentile(splats.means.astype(np.float64), (20, 80), axis=0)
        x, y, z = ((low + high) / 2).tolist()
        return Framing((x, y, z), 2 * float(np.linalg.norm(high - low)))


# Outside the things of the procedural scene, inside its sky.
PROCEDURAL = Framing((0.0, 0.0, 0.8), 8.0)


def shooting_cameras(n: int, size: int, framing: Framing = PROCEDURAL) -> list[Camera]:
    """`n` cameras once around a scene at changing heights, square pictures."""
    cameras = []
    low, high = ELEVATIONS
    for i in range(n):
        turn = 2 * math.pi * i / n
        elevation = low + (high - low) * (i * STRIDE % 1)
        level = math.cos(elevation)
        out = [level * math.cos(turn), level * math.sin(turn), math.sin(elevation)]
        eye = np.array(framing.centre) + framing.radius * np.array(out)
        camera = Camera.look_at(eye, framing.centre, width=size, height=size, fov_x=FOV_X)
        cameras.append(camera)
    return cameras


def photograph(
    splats: SplatParams, camera: Camera, distortion: Distortion = (0.0, 0.0, 0.0, 0.0)
) -> npt.NDArray[np.uint8]:
    """(H, W, 4) picture with transparency, taken through a lens that distorts.

    Raises:
        ValueError: the lens folds the picture over itself.
    """
    rgba = _distorted(splats, camera, distortion) if any(distortion) else _rgba(splats, camera)
    alpha = rgba[..., 3:]
    colors = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    return _bytes(np.concatenate([colors, alpha], axis=2))


def cloud_of(splats: SplatParams, framing: Framing = PROCEDURAL, seed: int = 0) -> Cloud:
    """Some centres of opaque splats, as structure from motion would have found them."""
    near = np.linalg.norm(splats.means - np.array(framing.centre), axis=1) < framing.radius
    opaque = np.flatnonzero(near & (splats.opacity_logits > 1))
    rng = np.random.Generator(np.random.PCG64(seed))
    chosen = np.sort(rng.permutation(opaque)[:N_POINTS])
    colors = 0.5 + SH_C0 * splats.sh[chosen, 0]
    return Cloud(splats.means[chosen].astype(np.float64), _bytes(colors))


def main(argv: Sequence[str] | None = None) -> None:
    """Write a folder of photographs."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.photos",
        description="Write photographs of a scene, with their cameras.",
        epilog="example: python -m tools.photos build/photos --views 60 --size 200",
    )
    parser.add_argument("out", metavar="OUT_DIR", type=Path)
    parser.add_argument(
        "--scene", metavar="PLY", type=Path, help="z up; default: evogs_codec.render.demo_scene"
    )
    parser.add_argument(
        "--splats", type=int, default=10_000, metavar="N", help="of evogs_codec.render.demo_scene"
    )
    parser.add_argument("--views", type=int, default=60, metavar="N", help="default: 60")
    parser.add_argument("--size", type=int, default=200, metavar="PX", help="default: 200")
    parser.add_argument("--format", choices=FORMATS, default="blender", help="default: blender")
    parser.add_argument(
        "--distortion", type=float, nargs=4, metavar=("K1", "K2", "P1", "P2"),
        default=(0.0, 0.0, 0.0, 0.0), help="of the lens; not in the blender format",
    )  # fmt: skip
    args = parser.parse_args(argv)
    if args.views < 2 or args.size < 8 or args.splats < 1:
        parser.error("--views must be 2 or more, --size 8 or more, --splats 1 or more")
    if args.format == "blender" and any(args.distortion):
        parser.error("the blender format has no lens distortion: choose another --format")
    try:
        splats = make_scene(args.splats) if args.scene is None else read_ply(args.scene)
        framing = PROCEDURAL if args.scene is None else Framing.of(splats)
        cameras = shooting_cameras(args.views, args.size, framing)
        shots = _shoot(splats, cameras, tuple(args.distortion), args.format)
        args.out.mkdir(parents=True, exist_ok=True)
        FORMATS[args.format](args.out, shots, cloud_of(splats, framing))
    except (InputError, ValueError) as error:
        parser.exit(1, f"{error}\n")
    except OSError as error:
        parser.exit(1, f"{args.out}: cannot be written: {error.strerror}\n")
    print(f"{args.out}: {len(shots)} photographs of {len(splats):,} splats, {args.format}")


def _shoot(
    splats: SplatParams, cameras: Sequence[Camera], distortion: Distortion, kind: str
) -> list[Shot]:
    shots = []
    for i, camera in enumerate(cameras):
        pixels = photograph(splats, camera, distortion)
        if kind != "blender":  # the others come from cameras, which know no transparency
            pixels = _on_white(pixels)
        shots.append(Shot(camera, distortion, pixels, test=i % TEST_EVERY == 0))
    return shots


def _on_white(pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    values = pixels / 255
    alpha = values[..., 3:]
    return _bytes(values[..., :3] * alpha + 1 - alpha)


def _bytes(values: Real) -> npt.NDArray[np.uint8]:
    """0..1 as 0..255; others are clamped."""
    return np.asarray(np.rint(np.clip(values, 0, 1) * 255), np.uint8)


def _rgba(splats: SplatParams, camera: Camera, options: Options | None = None) -> F32:
    """(H, W, 4): colours times opacity, and opacity."""
    drawing = draw(splats, camera, options=options or Options())
    alpha = 1 - drawing.transmittance
    return np.concatenate([drawing.image, alpha[..., None]], axis=2).astype(np.float32)


def _distorted(splats: SplatParams, camera: Camera, distortion: Distortion) -> F32:
    """`_rgba` through a lens: a finer, wider picture of a pinhole, looked up along bent rays."""
    width, height = FINE * camera.width, FINE * camera.height
    fine = camera.resized(width, height)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = undistort((u - fine.cx) / fine.fx, (v - fine.cy) / fine.fy, distortion)
    at = np.stack([fine.fy * y, fine.fx * x])
    low, high = np.floor(at.min((1, 2))) - 2, np.ceil(at.max((1, 2))) + 2
    rows, columns = (int(n) for n in high - low)
    wide = Camera(
        columns, rows, fine.fx, fine.fy, -low[1], -low[0], camera.rotation, camera.translation
    )
    # A finer pixel blurs a splat less; the blur of a pixel of the photograph is wanted.
    options = Options(dilation=Options().dilation * FINE**2)
    picture = _rgba(splats, wide, options)
    index = at - low[:, None, None] - 0.5  # pixel centres are at halves, indices are whole
    channels = [map_coordinates(picture[..., c], index, order=3) for c in range(4)]
    return area_average(np.stack(channels, axis=-1), camera.width, camera.height)


if __name__ == "__main__":
    main()
