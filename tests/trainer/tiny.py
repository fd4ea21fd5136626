"""A scene that trains in a second: a few coloured splats, photographed from a circle."""

from dataclasses import replace
from functools import cache

import numpy as np

from evogs_codec import SplatParams
from evogs_codec.render import orbit, render
from reference_trainer.cli import pyramid_of
from reference_trainer.config import CloudGrowth, Config, FrontierGrowth
from reference_trainer.data import Dataset, View

WHITE = (1.0, 1.0, 1.0)


@cache
def dataset(size=32, n_views=12, n_splats=40):
    rng = np.random.default_rng(7)
    splats = random_splats(rng, n_splats)
    cameras = orbit(n_views, radius=4.0, elevation=0.4, width=size, height=size, fov_x=0.7)
    views = [
        View(f"v{i}", camera, render(splats, camera, WHITE).clip(0, 1))
        for i, camera in enumerate(cameras)
    ]
    points = splats.means[::2].copy()
    return Dataset("tiny", tuple(views[1:]), (views[0],), points, None, WHITE)


def random_splats(rng, n, degree=1, dtype=np.float32):
    return SplatParams(
        rng.normal(0, 0.5, (n, 3)).astype(dtype),
        rng.normal(0, 1, (n, 4)).astype(dtype),
        rng.uniform(-2.5, -1.2, (n, 3)).astype(dtype),
        rng.normal(1, 1, n).astype(dtype),
        rng.normal(0, 0.5, (n, (degree + 1) ** 2, 3)).astype(dtype),
    )


def pyramid(n_levels=2):
    return pyramid_of(dataset(), n_levels)


def config(**changes):
    base = Config(
        sh_degree=1,
        iterations=(40, 40),
        max_splats=(30, 70),
        cloud=CloudGrowth(start=10, every=5, n_random=20, sh_every=10),
        frontier=FrontierGrowth(start=12, rounds=3, threshold=0.0),
        checkpoint_every=10,
    )
    return replace(base, **changes)


@cache
def trained(**changes):
    """The tree of a run with these changes of `config`, trained once a process: only read it."""
    from reference_trainer.models.backends import backend_for  # these need torch
    from reference_trainer.run import run

    return run(config(**changes), pyramid(), backend_for("cpu"))
