"""A small tileset, made without jobs: streams of a few splats, and the JSON around them."""

from functools import cache
from pathlib import Path

import numpy as np

from evogs_codec import SplatParams, decode_leaves, encode_scene
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.tileset.boxes import Box, covered
from evogs_codec.tileset.json_files import FOLDER, Frame, json_files
from evogs_codec.tileset.nodes import Node

ORIGINS = ((0.0, 0.0, 0.0), (-8.0, 0.0, 0.0), (8.0, 0.0, 0.0), (8.0, 8.0, 0.0), (8.0, -8.0, 0.0))
FAR = np.array([500_000.0, 5_400_000.0, 250.0])


def small_tileset(folder: Path, far=FAR, max_json=1 << 16) -> Node:
    """A root, a leaf and an inner node with two leaves, of 40 splats each, in a folder."""
    (folder / FOLDER).mkdir(parents=True)
    nodes = [
        Node(name, far + origin, None if name in ("root", "1") else k, 40)
        for k, (name, origin) in enumerate(
            zip(("root", "0", "1", "1-0", "1-1"), ORIGINS, strict=True)
        )
    ]
    root, left, right, *under = nodes
    root.children, right.children = [left, right], under
    for number, node in enumerate(nodes):
        data = stream(number)
        (folder / FOLDER / f"{node.name}.evogs").write_bytes(data)
        node.n_splats, node.n_bytes = 40, len(data)
        node.box = Box.around([covered(decode_leaves(data, level=k)) for k in (0, 1)])
    root.error, right.error = 2.0, 1.0
    for node in reversed(nodes):
        boxes = [child.box.moved(child.origin - node.origin) for child in node.children]
        node.box = Box.around([node.box, *boxes]).rounded()
    frame = Frame(np.eye(4), 1.0, {"evogs": {"splats": 120, "origin": root.origin.tolist()}})
    for name, text in json_files(root, frame, ".evogs", max_json).items():
        (folder / name).write_bytes(text)
    return root


@cache
def stream(number: int) -> bytes:
    """Of `near`, with two levels."""
    return encode_scene(
        near(number), levels=2, preset="scene", palette="never", effort=1, cameras=[]
    )


def near(number: int) -> SplatParams:
    """40 small splats within a unit of the origin."""
    scene = make_scene(40)
    rng = np.random.default_rng(number)
    means = rng.uniform(-1, 1, (40, 3)).astype(np.float32)
    return SplatParams(
        means, scene.quats, np.full((40, 3), -3, np.float32), scene.opacity_logits, scene.sh
    )
