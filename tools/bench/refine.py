"""`evogs lift --refine`: levels before and after, over views that it has not seen, and bytes."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from evogs_codec import (
    PRESETS,
    Cut,
    EvolutionTree,
    SplatParams,
    choose_cut,
    decode,
    encode,
    extract,
    lift,
    read_directory,
    read_ply,
)
from evogs_codec.cli.options import DEFAULT_ITERATIONS
from evogs_codec.lifting.lift import N_LEVELS
from evogs_codec.render import cameras_around
from evogs_codec.render.demo_scene import make_scene
from evogs_codec.render.viewpoints import SIZE
from evogs_codec.render.views import Views
from reference_trainer.distil.refining import refine

__all__ = ["refined"]

Rows = list[dict[str, object]]
N_CROP = 30_000  # splats of a named scene: those nearest to its middle
FAR_PIXELS = SIZE // 4  # pixels, of pictures from afar


def refined(ply: Path | None, up: str) -> Rows:
    """Of the shipped scene, and of the middle of another if one is named.

    Refining has seen none of the views: its own are on other circles. Bytes are those of a stream
    up to the level, seconds those of refining, of the processor.
    """
    rows = _rows("shipped", make_scene(), "z")
    if ply is not None:
        scene = _middle(read_ply(ply), N_CROP)
        rows += _rows(f"{ply.stem}, {len(scene):,} splats", scene, up)
    return rows


def _rows(name: str, scene: SplatParams, up: str) -> Rows:
    lifted = lift(scene, N_LEVELS)
    start = time.process_time()
    better = refine(lifted, None, up, DEFAULT_ITERATIONS, lambda *_: None)
    seconds = time.process_time() - start
    views = [Views(lifted.leaves(), cameras_around(scene, up, size)) for size in (SIZE, FAR_PIXELS)]
    rows: Rows = []
    both = zip(_decoded(lifted, views), _decoded(better, views), strict=True)
    for level, ((n_bytes, large, small), (n_bytes_after, large_after, small_after)) in enumerate(
        both
    ):
        rows.append(
            {
                "scene": name,
                "level": level,
                "splats": len(lifted.leaves(level)),
                "lifted, dB": f"{large:.2f}",
                "refined, dB": f"{large_after:.2f}",
                f"lifted, dB, {FAR_PIXELS} pixels": f"{small:.2f}",
                f"refined, dB, {FAR_PIXELS} pixels": f"{small_after:.2f}",
                "lifted, bytes": n_bytes,
                "refined, bytes": n_bytes_after,
                "to lifted": f"{n_bytes_after / n_bytes:.3f}",
                "seconds": f"{seconds:.0f}",
            }
        )
    return rows


def _decoded(tree: EvolutionTree, views: list[Views]) -> list[tuple[int, float, float]]:
    """Of each level of the preset `scene`: bytes of the stream up to it, PSNR of each of views."""
    data = encode(tree, PRESETS["scene"])
    directory = read_directory(data)
    found = []
    for level in range(directory.n_levels):
        part = extract(data, choose_cut(directory, level=level))
        leaves = decode(data, Cut.of_level(directory, level)).leaves()
        large, small = (view.psnr(leaves) for view in views)
        found.append((len(part), large, small))
    return found


def _middle(scene: SplatParams, n: int) -> SplatParams:
    """The n splats nearest to the middle."""
    off = np.linalg.norm(scene.means - np.median(scene.means, axis=0), axis=1)
    return scene.take(np.sort(np.argsort(off, kind="stable")[:n]))
