"""A procedural landscape: an object on the ground, trees around it, and the sky far away."""

import numpy as np
import numpy.typing as npt

from evogs_codec import SplatParams
from evogs_codec.render.harmonics import C0

OBJECT, TREES, SKY = 1.5, 18.0, 100.0  # width of the object; distances


def landscape(n: int, seed: int = 0) -> SplatParams:
    """About n splats of SH degree 1, z up, as trainers make them: the farther, the larger."""
    rng = np.random.default_rng(seed)
    thing = _directions(4 * n // 10, rng)
    thing *= OBJECT / 2 * (1 + 0.15 * np.sin(9 * thing[:, :1]) * np.cos(7 * thing[:, 2:]))
    turn, away = rng.uniform(0, 2 * np.pi, n), np.sqrt(rng.random(n))
    round_about = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(n)])
    ground = (10 * away[:, None] * round_about)[-(3 * n // 10) :] - [0, 0, OBJECT / 2]
    trees = (TREES * round_about)[: 2 * n // 10] + rng.normal((0, 0, 2), 2, (2 * n // 10, 3))
    sky = SKY * _directions(n // 10, rng) * [1, 1, 0.5] + [0, 0, 20]
    means = np.concatenate([thing, ground, trees, sky])
    sizes = 0.008 * (1 + np.linalg.norm(means, axis=1))
    colours = 0.5 + 0.4 * np.sin(means * [9, 11, 8] / (1 + np.linalg.norm(means, axis=1))[:, None])
    sh = np.zeros((len(means), 4, 3), np.float32)
    sh[:, 0], sh[:, 1:] = (colours - 0.5) / C0, rng.normal(0, 0.03, (len(means), 3, 3))
    return SplatParams(
        means=means.astype(np.float32),
        quats=rng.normal(size=(len(means), 4)).astype(np.float32),
        log_scales=(np.log(sizes)[:, None] + rng.normal(0, 0.4, means.shape)).astype(np.float32),
        opacity_logits=rng.normal(2, 2, len(means)).astype(np.float32),
        sh=sh,
    )


def _directions(n: int, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """(n, 3) of length 1."""
    found: npt.NDArray[np.float64] = rng.normal(size=(n, 3))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found
