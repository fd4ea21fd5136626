"""Levels drawn at the size of the next one, before it is there: what they lose, and to what.

A footprint is dilated by 0.3 square pixels, whatever the size of the picture (spec, rasterizer). At
twice the size, that is a quarter of what the splats of a level were trained with.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import zoom

from evogs_codec import EvolutionTree
from evogs_codec.model.splats import F32
from evogs_codec.render import psnr
from evogs_codec.render.options import DEFAULT
from reference_trainer.evaluate import leaves_drawn
from tools.bench.paper.runs import Views

__all__ = ["at_the_next_size"]


def at_the_next_size(tree: EvolutionTree, views: Views) -> list[dict[str, Any]]:
    """A row for each level but the last, in dB.

    `own` and `next`: of the level at its own size and at the next one; `wide`: at the next one, the
    footprints dilated as much of the scene as at its own; `above`: of the level after it there;
    `enlarged`: photographs of its own size, enlarged (bicubic).
    """
    rows = []
    for level in range(len(views.pyramid) - 1):
        splats, _ = leaves_drawn(tree, level)
        small, large = (views.held_out(k) for k in (level, level + 1))
        times = large[0].camera.width / small[0].camera.width
        wide = replace(DEFAULT, dilation=DEFAULT.dilation * times**2)
        enlarged = [
            psnr(_enlarged(a.image, b.image.shape), b.image)
            for a, b in zip(small, large, strict=True)
        ]
        rows.append(
            {
                "level": level,
                "own": views.psnr(splats, level),
                "next": views.psnr(splats, level + 1),
                "wide": views.psnr(splats, level + 1, options=wide),
                "above": views.psnr(leaves_drawn(tree, level + 1)[0], level + 1),
                "enlarged": float(np.mean(enlarged)),
            }
        )
    return rows


def _enlarged(image: F32, shape: tuple[int, ...]) -> F32:
    """The picture at another size, of three channels."""
    times = [n / m for n, m in zip(shape, image.shape, strict=True)]
    found: F32 = zoom(image, times, order=3, mode="nearest", grid_mode=True)
    return found.clip(0.0, 1.0)
