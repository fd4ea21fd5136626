"""What `--refine` does (entry point of `evogs.refiners`): cameras around the scene, and `distil`.

The rasterizer needs numba, an extra: it is imported when the command runs, so that all others work
without.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from conformance.cli import SIZE, around
from evogs_codec import EvolutionTree, InputError, SplatParams

if TYPE_CHECKING:
    from conformance.rasterizer import Camera

__all__ = ["refine", "rings"]

# Number, elevation and distance of the cameras of a circle, as of `around`; on none that it has.
RINGS = ((9, 0.05, 1.7), (11, 0.2, 2.4), (11, 0.5, 1.9), (9, 0.8, 2.2))
HELD_OUT = 5  # every 5th camera


def refine(
    tree: EvolutionTree,
    camera: Path | None,
    up: str,
    iterations: int,
    progress: Callable[[float], None],
) -> EvolutionTree:
    """A lifted tree with coarse levels that look more like its last one; says so, level by level.

    Args:
        tree: as `lift` makes them.
        camera: file of cameras, or None for `rings`.
        up: axis of the rings, perhaps with a sign.
        iterations: of each level.
        progress: called with the share of the work done, 0 to 1.

    Raises:
        InputError: numba is not installed, or there are too few cameras.
    """
    if find_spec("numba") is None:
        raise InputError("--refine draws pictures: pip install 'evogs[render]'")
    from conformance.rasterizer import load_cameras
    from reference_trainer.distil import distil
    from reference_trainer.memory import keep_freed_memory

    keep_freed_memory()
    if not tree.n_leaves:
        return tree
    cameras = rings(tree.leaves(), up) if camera is None else load_cameras(camera)
    held_out = cameras[::HELD_OUT]
    others = [other for k, other in enumerate(cameras) if k % HELD_OUT]
    if not others:
        raise InputError(f"{camera}: {len(cameras)} cameras, expected at least 2")
    distilled = distil(tree, others, held_out, iterations=iterations, progress=progress)
    for change in distilled.changes:
        kept = "" if change.gains else ", not taken"
        text = f"level {change.level}: {change.before:.2f} dB, refined {change.found:.2f} dB{kept}"
        print(f"evogs: {text}", file=sys.stderr)
    return distilled.tree


def rings(scene: SplatParams, up: str) -> list[Camera]:
    """40 cameras around the bulk of a scene, at four heights and distances."""
    return [
        camera
        for n, elevation, distance in RINGS
        for camera in around(scene, up, SIZE, n=n, elevation=elevation, distance=distance)
    ]
