"""What `--refine` does (entry point of `evogs.refiners`): cameras around the scene, and `distil`.

The rasterizer needs numba, an extra: it is imported when the command runs, so that all others work
without.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from evogs_codec import EvolutionTree, InputError
from evogs_codec.common.progress import Progress

if TYPE_CHECKING:
    from evogs_codec.render.up import Direction

__all__ = ["refine"]


def refine(
    tree: EvolutionTree,
    camera: Path | None,
    up: Direction | None,
    iterations: int,
    progress: Progress,
) -> EvolutionTree:
    """A lifted tree with coarse levels that look more like its last one; says so, level by level.

    Args:
        tree: as `lift` makes them.
        camera: file of cameras, or None for `rings`.
        up: what is up for the rings, as of `camera_rings`.
        iterations: of each level.
        progress: called with the stage "refine" and the part that is done.

    Raises:
        InputError: numba is not installed, or there are too few cameras.
    """
    if find_spec("numba") is None:
        raise InputError("--refine renders views: pip install -e '.[render]'")
    from evogs_codec.common.heap import keep_freed_memory
    from evogs_codec.render import camera_rings, load_cameras
    from evogs_codec.render.views import HELD_OUT
    from reference_trainer.distil.coarse_levels import distil

    keep_freed_memory()
    if not tree.n_leaves:
        return tree
    cameras = camera_rings(tree.leaves(), up) if camera is None else load_cameras(camera)
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
