"""Pictures of prefixes of a stream by the project's rasterizer, for the tests of the viewer.

It writes CAMERA.json, and for each number of bytes a file of 8-bit RGB, row by row.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from evogs_codec.decoding.cut import Cut
from evogs_codec.decoding.decode import decode
from evogs_codec.format.directory import read_directory
from evogs_codec.render import Camera, render

WIDTH, HEIGHT = 320, 240


def main() -> None:
    """Write the camera and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stream", type=Path)
    parser.add_argument("cameras", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("sizes", type=int, nargs="+")
    args = parser.parse_args()
    data = args.stream.read_bytes()
    directory = read_directory(data)
    entry = json.loads(args.cameras.read_text())["cameras"][0]
    rotation, translation = np.array(entry["rotation"]), np.array(entry["translation"])
    width, height, fx, fy, cx, cy = (
        entry[key] for key in ("width", "height", "fx", "fy", "cx", "cy")
    )
    camera = Camera(width, height, fx, fy, cx, cy, rotation, translation).resized(WIDTH, HEIGHT)
    pose = {
        "eye": camera.position.tolist(),
        "rotation": [rotation[0].tolist(), (-rotation[1]).tolist(), (-rotation[2]).tolist()],
        "fovY": 2 * math.atan(HEIGHT / 2 / camera.fy),
        "near": 0.2,
        "far": 1000,
    }
    args.folder.mkdir(parents=True, exist_ok=True)
    (args.folder / "camera.json").write_text(json.dumps(pose))
    for size in args.sizes:
        splats = decode(data, Cut.of_prefix(directory, size), directory=directory).leaves()
        picture = np.clip(render(splats, camera, (0.0, 0.0, 0.0)), 0, 1)
        (args.folder / f"{size}.rgb").write_bytes(np.rint(255 * picture).astype(np.uint8).tobytes())


if __name__ == "__main__":
    main()
