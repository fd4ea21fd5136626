"""A trained tree looks as good as its trainer said: its conventions and ours are the same."""

import json

import numpy as np
import pytest

from evogs_codec import PRESETS, decode, encode, read_tree
from evogs_codec.render import Camera, psnr, render

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


@pytest.fixture(scope="module")
def decibels(held_out):
    """Mean PSNR of splats as a level, over the photographs held out."""
    views, fov_x = held_out

    def measure(splats, level):
        size = SIZES[level]
        results = []
        for pixels, frame in views:
            box = pixels.shape[0] // size
            target = pixels.reshape(size, box, size, box, 3).mean((1, 3))
            camera = Camera.from_blender(frame["transform_matrix"], fov_x, width=size, height=size)
            results.append(psnr(np.clip(render(splats, camera, (1, 1, 1)), 0, 1), target))
        return np.mean(results)

    return measure


@pytest.mark.parametrize(
    "level", [0, *(pytest.param(level, marks=pytest.mark.thorough) for level in (1, 2, 3))]
)
def test_a_trained_level_has_the_psnr_of_its_trainer(level, decibels, tree):
    assert decibels(tree.leaves(level), level) == pytest.approx(PSNR[level], abs=0.05)


@pytest.mark.slow
def test_an_eighth_of_the_bytes_loses_at_most_0_3_decibels(decibels, tree):
    raw = sum(step.psi.nbytes + step.alpha.nbytes + step.adds.nbytes for step in tree.steps)
    data = encode(tree, PRESETS["trained"])  # the default of `evogs encode` for a tree
    assert 8 * len(data) <= raw
    for level in range(4):
        splats = decode(data, level=level).leaves()
        assert decibels(splats, level) >= decibels(tree.leaves(level), level) - 0.3
