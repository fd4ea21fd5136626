"""Which side of a scene to show where nobody says: the one with the most detail.

Streams do not depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evogs_codec.model.splats import SplatParams
from evogs_codec.render.camera import Camera
from evogs_codec.render.forward import Colour, render
from evogs_codec.render.framing import background_for, options_for

__all__ = ["most_detailed"]

SIDE = 48  # pixels
EVERY = 2  # of the cameras is tried
MAX_SPLATS = 40_000


def most_detailed(
    scene: SplatParams, cameras: Sequence[Camera], background: Colour | None = None
) -> int:
    """The number of the camera whose picture has the most detail, of every second one.

    Detail is how much neighbouring pixels differ in a small picture of the splats that cover most.

    Args:
        scene: N splats.
        cameras: at least one.
        background: behind the splats; by default as `background_for` says.
    """
    options, shown = options_for(scene), _largest(scene)
    behind = background_for(scene) if background is None else background
    found = []
    for camera in cameras[::EVERY]:
        part = SIDE / max(camera.width, camera.height)
        width, height = (max(2, round(part * side)) for side in (camera.width, camera.height))
        picture = render(shown, camera.resized(width, height), behind, options=options)
        found.append(sum(float(np.abs(np.diff(picture, axis=axis)).sum()) for axis in (0, 1)))
    return EVERY * int(np.argmax(found))


def _largest(scene: SplatParams) -> SplatParams:
    """Those whose opacity times area is largest, in their order."""
    if len(scene) <= MAX_SPLATS:
        return scene
    area = scene.log_scales.sum(1) - scene.log_scales.min(1)
    cover = area - np.logaddexp(0, -scene.opacity_logits)
    rows = np.argpartition(-cover, MAX_SPLATS)[:MAX_SPLATS]
    return scene.take(np.sort(rows))
