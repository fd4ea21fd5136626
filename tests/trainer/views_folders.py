"""Small folders of photographs with known cameras, for the tests of `reference_trainer.data`."""

import json

import numpy as np

from evogs_codec.render import Camera
from tools.photo_formats import FORMATS, Cloud, Shot

LENS = (-0.2, 0.05, 0.002, -0.001)
PINHOLE = (0.0, 0.0, 0.0, 0.0)
WIDTH, HEIGHT = 20, 12


def shots_of(n=10, distortion=PINHOLE, channels=3, *, centred=False, seed=0):
    """`n` photographs of noise, every 4th held out."""
    rng = np.random.Generator(np.random.PCG64(seed))
    shots = []
    for i in range(n):
        eye = rng.normal([6, 0, 2], 1)
        camera = Camera.look_at(eye, rng.normal(0, 0.3, 3), width=WIDTH, height=HEIGHT, fov_x=0.9)
        if not centred:
            r, t = camera.rotation, camera.translation
            camera = Camera(WIDTH, HEIGHT, 21.5, 22.25, 9.125, 6.5, r, t)
        pixels = rng.integers(0, 256, (HEIGHT, WIDTH, channels), np.uint8)
        shots.append(Shot(camera, distortion, pixels, test=i % 4 == 0))
    return shots


def cloud_of(n=7):
    rng = np.random.Generator(np.random.PCG64(1))
    points = rng.normal(0, 1, (n, 3)).astype(np.float32).astype(np.float64)
    return Cloud(points, rng.integers(0, 256, (n, 3), np.uint8))


def folder_of(path, kind, **options):
    """Write a folder; returns it."""
    options = {"centred": kind == "blender", **options}
    path.mkdir(parents=True, exist_ok=True)
    FORMATS[kind](path, shots_of(**options), cloud_of())
    return path


def edit_json(path, change):
    """Pass what a file holds through `change`, which may alter it."""
    top = json.loads(path.read_text())
    change(top)
    path.write_text(json.dumps(top))
