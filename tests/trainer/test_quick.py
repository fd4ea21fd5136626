"""`--preset quick` on the photographs that ship with the project."""

import time
from dataclasses import replace

import numpy as np
import pytest

from evogs_codec.render import orbit
from reference_trainer.cli import pyramid_of
from reference_trainer.config import PRESETS
from reference_trainer.data import Dataset, View, load_views
from reference_trainer.data.seeding import first_splats
from reference_trainer.evaluate import evaluate
from reference_trainer.held_out import at_full_size
from reference_trainer.models.backends import backend_for
from reference_trainer.run import run
from tools import photos


def around(radius, fov_x=0.6911):
    cameras = orbit(12, radius=radius, width=8, height=8, fov_x=fov_x)
    views = tuple(View(str(i), c, np.zeros((8, 8, 3), np.float32)) for i, c in enumerate(cameras))
    return Dataset("none", views, (), None, None, (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("radius", "half_side"), [(1, 1.3), (4.0311, 1.3), (8.0622, 2.6), (80.622, 26)]
)
def test_random_points_fill_what_the_cameras_show(radius, half_side):
    points = first_splats(around(radius), 5000, 0, (0,)).means
    assert np.abs(points).max() == pytest.approx(half_side, rel=0.01)


def trained(folder, n_levels, size):
    """PSNR of each level at its own size, then of each at the size of the last."""
    quick = PRESETS["quick"]
    config = replace(
        quick, iterations=quick.iterations[:n_levels], max_splats=quick.max_splats[:n_levels]
    )
    pyramid = pyramid_of(load_views(folder, size=size), n_levels)
    tree = run(config, pyramid, backend_for("cpu"))
    rows = evaluate(tree, config.method, pyramid)
    return [row["psnr"] for row in rows], at_full_size(tree, pyramid[-1], n_levels)


@pytest.mark.parametrize(("kind", "least"), [("blender", 22), ("colmap", 25)])
def test_the_coarsest_level_of_the_shipped_photographs_is_learned(tmp_path, kind, least):
    photos.main([str(tmp_path), "--size", "25", "--format", kind])
    (psnr,), _ = trained(tmp_path, 1, 25)
    assert psnr > least


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "least"), [("blender", 23.5), ("colmap", 26.5)])
def test_every_level_of_the_shipped_photographs_is_learned(tmp_path, kind, least):
    photos.main([str(tmp_path), "--format", kind])
    before = time.process_time()
    found, at_last = trained(tmp_path, 4, 200)
    assert time.process_time() - before < 180
    assert min(found) > least
    assert found[-1] == max(found)
    assert min(np.diff(at_last)) > 1
