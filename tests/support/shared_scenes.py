"""Scenes whose splats share SH, and the trees of them."""

from dataclasses import replace

import numpy as np

from evogs_codec import lift_with_order, with_palette
from evogs_codec.render.demo_scene import make_scene


def shared_scene(n=1200, n_vectors=60, degree=2, seed=0):
    """A scene whose SH above band 0 are some of a few vectors, 0 among them."""
    splats = make_scene(n)
    rng = np.random.default_rng(seed)
    vectors = rng.normal(0, 0.1, (n_vectors, (degree + 1) ** 2 - 1, 3)).astype(np.float32)
    vectors[0] = 0
    rest = vectors[rng.integers(0, n_vectors, n)]
    return replace(splats, sh=np.concatenate([splats.sh[:, :1], rest], axis=1))


def shared_tree(splats, n_levels=4):
    lifted = lift_with_order(splats, n_levels)
    return lifted, with_palette(lifted, splats)
