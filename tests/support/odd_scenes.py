"""Small scenes of plain arithmetic, with odd orientations and numbers of all signs.

They are the same on every machine: files that other programs made of them are committed.
"""

import numpy as np

from evogs_codec import SplatParams
from evogs_codec.io.interchange.values import unit

GOLDEN = 0.6180339887498949


def spread(n, *shape, low=-1.0, high=1.0, start=1):
    """(n, *shape) numbers from low to high, far from each other and in no order."""
    count = n * int(np.prod(shape, dtype=int))
    parts = (np.arange(start, start + count) * GOLDEN) % 1.0
    return (low + (high - low) * parts).reshape(n, *shape)


def odd_scene(n=48, degree=3):
    """`n` splats; rotations are not normalised, and no axis is like another."""
    k = (degree + 1) ** 2
    sh = np.concatenate(
        [spread(n, 1, 3, low=-1.5, high=1.5), spread(n, k - 1, 3, low=-0.9, high=0.9, start=7)],
        axis=1,
    )
    means = spread(n, 3, low=-4, high=4, start=3) * [1, 0.7, 1.3] + [1.3, -0.7, 2.1]
    return SplatParams(
        means=means.astype(np.float32),
        quats=spread(n, 4, low=-2, high=2, start=11).astype(np.float32),
        log_scales=spread(n, 3, low=-4, high=-1, start=5).astype(np.float32),
        opacity_logits=spread(n, low=-4, high=5, start=2).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def covariances(splats):
    """(N, 3, 3) what orientations and scales mean, whatever the signs and the order of axes."""
    q = splats.quats.astype(float)
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    squares = np.exp(2 * splats.log_scales.astype(float))
    return np.einsum("ijn,nj,kjn->nik", rotation, squares, rotation)


def opacities(splats):
    """(N,) after activation."""
    return 1 / (1 + np.exp(-splats.opacity_logits.astype(float)))


def signed_alike(quats, like):
    """Unit quaternions, of q and -q that which is nearer."""
    one, other = unit(quats), unit(like)
    return one * np.where((one * other).sum(1) < 0, -1, 1)[:, None]


def far_scene(n=32, degree=3):
    """Like `odd_scene`, with numbers at the ends of what formats hold, and beyond some."""
    scene = odd_scene(n, degree)
    means = scene.means.copy()
    means[:4] = [[4000, -4000, 3], [1e-9, 0, -1e-9], [-5000, 5000, 1], [0.5, 0, 0]]
    log_scales = scene.log_scales.copy()
    log_scales[:4] = np.array([-9, 5.9, -10.5, 7])[:, None]
    logits = scene.opacity_logits.copy()
    logits[:6] = [80, -80, 17, -17, 0, 5]
    sh = scene.sh.copy()
    sh[:2, 0], sh[2, 1:], sh[3, 1:] = 9, 5, -5
    quats = scene.quats.copy()
    quats[:3] = [[1e-3, 0, 0, 0], [1e-3, 0, 0, -1e-3], [0, -1e3, 0, 0]]
    return SplatParams(means, quats, log_scales, logits, sh)
