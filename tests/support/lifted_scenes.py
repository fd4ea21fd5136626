"""Scenes to lift, and what the leaves of every lifted tree must be."""

from __future__ import annotations

import numpy as np

from evogs_codec.lifting.lift import lift_with_order
from evogs_codec.lifting.orientations import multiply
from evogs_codec.model.splats import F64, SplatParams


def surface(n: int, sh_degree: int = 1, seed: int = 0) -> SplatParams:
    """Flat splats that lie in a sphere of radius 1, turned at random in it, as large as spaced."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # The turn of z to the normal is (1 + n_z, z x normal); before it, a turn about z.
    tilt = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(n)])
    about = rng.uniform(0, np.pi, n)
    spin = np.stack([np.cos(about), np.zeros(n), np.zeros(n), np.sin(about)])
    spacing = np.log(2 / np.sqrt(max(n, 1)))
    k = (sh_degree + 1) ** 2
    return SplatParams(
        normals.astype(np.float32),
        (multiply(tilt, spin) * rng.uniform(0.5, 2, n)).T.astype(np.float32),
        (spacing + rng.normal(size=(n, 3)) * 0.4 - [0, 0, 1.5]).astype(np.float32),
        (rng.normal(size=n) * 2).astype(np.float32),
        (rng.normal(size=(n, k, 3)) * 0.3).astype(np.float32),
    )


def with_channels(splats: SplatParams, **changed: object) -> SplatParams:
    """`splats` with some attributes replaced; scalars and rows are repeated for every splat."""
    arrays = {name: getattr(splats, name) for name in vars(splats)}
    for name, value in changed.items():
        arrays[name] = np.broadcast_to(np.asarray(value, np.float32), arrays[name].shape)
    return SplatParams(**arrays)


def covariances(splats: SplatParams) -> F64:
    """(N, 3, 3) float64, a zero quaternion meaning identity: an oracle apart from `axes`."""
    q = splats.quats.astype(np.float64)
    q[(q == 0).all(1)] = [1, 0, 0, 0]
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    root = np.array(rows).transpose(2, 0, 1) * np.exp(splats.log_scales.astype(np.float64))[:, None]
    out: F64 = root @ root.transpose(0, 2, 1)
    return out


def assert_leaves_are(splats: SplatParams, n_levels: int = 5) -> None:
    """The leaves of the lifted tree are the same Gaussians up to rounding to float32."""
    lifted = lift_with_order(splats, n_levels)
    leaves = lifted.tree.leaves()
    assert lifted.tree.n_levels == n_levels
    assert sorted(lifted.leaf_of) == list(range(len(splats)))
    source = splats.take(lifted.leaf_of)
    if not len(splats):
        return
    # Each generation rounds once, relative to the largest number of its channel.
    for name, ulps in (("means", 16), ("opacity_logits", 64), ("sh", 16)):
        given, got = getattr(source, name), getattr(leaves, name)
        tolerance = ulps * 2.0**-23 * max(1e-30, float(np.abs(given).max()))
        np.testing.assert_allclose(got, given, rtol=0, atol=tolerance, err_msg=name)
    given, got = covariances(source), covariances(leaves)
    size = np.trace(given, axis1=1, axis2=2)
    assert (np.abs(got - given).max((1, 2)) / size).max() < 2e-4
    np.testing.assert_allclose(
        np.sort(leaves.log_scales, 1), np.sort(source.log_scales, 1), atol=1e-4, rtol=1e-5
    )
