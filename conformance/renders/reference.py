"""Our renderer behind the command of a renderer under test: decode, rasterize, 16-bit PNG."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from conformance.renders.png import Pixels, encode_png

__all__ = ["add_options", "run_reference", "to_pixels"]


def run_reference(args: argparse.Namespace) -> int:
    """`reference`."""
    # numba, an extra, is needed here and not for judging.
    from evogs_codec import Cut, decode, read_directory
    from evogs_codec.render import Options, load_cameras, render

    data = args.input.read_bytes()
    cut = Cut.of_level(read_directory(data), args.level)
    splats = decode(data, cut).leaves()
    (camera,) = load_cameras(args.camera)
    options = Options(antialiased=args.antialiased)
    image = render(splats, camera, args.background, options=options)
    args.out.write_bytes(encode_png(to_pixels(image, np.uint16)))
    return 0


def to_pixels(
    image: npt.NDArray[np.floating], dtype: type[np.uint8] | type[np.uint16] = np.uint8
) -> Pixels:
    """A picture whose white is 1, clamped and rounded to the nearest step."""
    pixels: Pixels = np.rint(np.clip(image, 0, 1) * np.iinfo(dtype).max).astype(dtype)
    return pixels


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of a renderer under test."""
    parser.add_argument("--in", dest="input", type=Path, required=True, metavar="FILE.evogs")
    parser.add_argument("--camera", type=Path, required=True, metavar="FILE.json")
    parser.add_argument("--level", type=int, required=True, metavar="K")
    parser.add_argument("--background", type=float, nargs=3, required=True, metavar=("R", "G", "B"))
    parser.add_argument("--antialiased", action="store_true")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT.png")
