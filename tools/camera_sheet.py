"""The picture of docs/cameras.md: scenes from the cameras that nobody named, in every convention.

    python -m tools.camera_sheet docs/figures/cameras.jpg --ply playbot.ply --tree lego400.tree.npz

Each row is a scene; its label says what was taken for up, and who says so.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from evogs_codec import SplatParams, read_scene, read_tree
from evogs_codec.io.interchange.frames import transformed
from evogs_codec.model.splats import F64
from evogs_codec.render import cameras_around, render, up_of
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.jpeg import write_jpeg
from evogs_codec.render.png import contact_sheet
from evogs_codec.render.up import AXES, Direction, direction

__all__ = ["main", "turning_z_to", "with_outliers"]

COMMAND = "python -m tools.camera_sheet"
VIEWS = (0, 4, 8, 12, 16, 20)  # of 24
PIXELS = 116
QUALITY = 80  # of the JPEG, as Pillow counts it
N_SPLATS = 40_000
OUTLIERS = 0.01  # of the splats
WHITE = (1.0, 1.0, 1.0)
TILTED = (0.3, -0.8, 0.4)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the picture."""
    args = _parsed(arguments)
    rows, labels = [], []
    for name, scene in _scenes(args):
        up = up_of(scene)
        cameras = cameras_around(scene, up.vector, PIXELS)
        rows.append([render(scene, cameras[view], WHITE) for view in VIEWS])
        labels.append(f"{name}: {up}".lower().replace("(", "- ").replace(")", ""))
        print(labels[-1])
    write_jpeg(args.output, contact_sheet(rows, labels=labels), made_by=COMMAND, quality=QUALITY)
    print(f"{args.output}: {args.output.stat().st_size:,} bytes")


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__.split("\n")[0])
    parser.add_argument("output", type=Path, metavar="OUT.jpg")
    parser.add_argument("--ply", type=Path, action="append", default=[], help="another scene")
    parser.add_argument("--tree", type=Path, action="append", default=[], help="a trained tree")
    parser.add_argument(
        "--splats", type=int, default=N_SPLATS, help=f"of the shipped scene (default: {N_SPLATS})"
    )
    return parser.parse_args(arguments)


def _scenes(args: argparse.Namespace) -> Iterator[tuple[str, SplatParams]]:
    scene = make_scene(args.splats)
    yield "shipped", scene
    for path in args.ply:
        yield path.name.partition(".")[0], read_scene(path).splats
    for path in args.tree:
        yield path.name.partition(".")[0], read_tree(path).leaves()
    for axis in AXES:
        turned = transformed(scene, turning_z_to(axis))
        yield f"turned to {axis}, 1 % far", with_outliers(turned, OUTLIERS)
    yield "tilted", transformed(scene, turning_z_to(TILTED))


def turning_z_to(up: Direction) -> F64:
    """(3, 3) a rotation that takes z to a direction."""
    top = direction(up)
    side = np.cross(top, np.eye(3)[int(np.argmin(np.abs(top)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(top, side), top], axis=1)


def with_outliers(scene: SplatParams, part: float) -> SplatParams:
    """The scene and, far around it, more on one side, so large a part of large opaque splats."""
    rng = np.random.default_rng(0)
    n = round(part * len(scene))
    far = np.zeros((len(scene.channels()), n))
    far[:3] = rng.normal(size=(3, n)) * [[3000], [500], [1000]] + [[2000], [0], [500]]
    far[3:7] = rng.normal(size=(4, n))
    far[7:10] = rng.normal(1, 1, (3, n))
    far[10] = 6.0
    both = np.concatenate([scene.channels(), far], axis=1)
    return SplatParams.from_channels(both[:, rng.permutation(len(scene) + n)])


if __name__ == "__main__":
    main()
