"""A trained tree looks as good as its trainer said: its conventions and ours are the same."""

import json

import numpy as np
import pytest

from conformance.rasterizer import Camera, psnr, render
from evogs_codec import read_tree

SIZES = (50, 100, 200, 400)
PSNR = (29.43, 30.99, 30.72, 31.91)  # ../shared/data/README.md


@pytest.fixture(scope="module")
def held_out(shared):
    """(pixels on white, camera matrix) of every 8th photograph, and the field of view."""
    pillow = pytest.importorskip("PIL.Image")
    folder = shared / "data" / "lego"
    scene = json.loads((folder / "transforms_train.json").read_text())
    views = []
    for frame in scene["frames"][::8]:
        with pillow.open(folder / f"{frame['file_path']}.png") as file:
            pixels = np.asarray(file, np.float64) / 255
        views.append((pixels[..., :3] * pixels[..., 3:] + 1 - pixels[..., 3:], frame))
    return views, scene["camera_angle_x"]


@pytest.fixture(scope="module")
def tree(shared):
    return read_tree(shared / "data" / "trees" / "lego400.tree.npz")


@pytest.mark.parametrize("level", range(4))
def test_a_trained_level_has_the_psnr_of_its_trainer(level, held_out, tree):
    views, fov_x = held_out
    size, splats = SIZES[level], tree.leaves(level)
    results = []
    for pixels, frame in views:
        box = pixels.shape[0] // size
        target = pixels.reshape(size, box, size, box, 3).mean((1, 3))
        camera = Camera.from_blender(frame["transform_matrix"], fov_x, width=size, height=size)
        results.append(psnr(np.clip(render(splats, camera, (1, 1, 1)), 0, 1), target))
    assert np.mean(results) == pytest.approx(PSNR[level], abs=0.05)
