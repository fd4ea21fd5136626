"""Pictures: levels of a lifted scene against it, presets of a trained tree on photographs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from evogs_codec import (
    PRESETS,
    Cut,
    EvolutionTree,
    SplatParams,
    decode,
    encode,
    lift_with_order,
    read_directory,
    with_palette,
)
from evogs_codec.encoding.settings import TREE_PSNR
from evogs_codec.lifting.lift import N_LEVELS
from evogs_codec.render import cameras_around, psnr, render
from evogs_codec.render.views import Views
from tools.bench.free_parents import free_levels
from tools.bench.photographs import held_out
from tools.bench.subjects import aim_of

__all__ = ["levels", "photographs"]

Rows = list[dict[str, object]]
WHITE = (1.0, 1.0, 1.0)
TARGET = 50.5  # dB against the tree's own pictures: about 0.1 dB against photographs
PYRAMID = (8, 4, 2, 1)  # pixels of a photograph, to a side, in one of each level


def levels(splats: SplatParams, scene: str, up: str) -> Rows:
    """PSNR of each level against the scene, over the cameras of `cameras_around`.

    Columns:
        decoded: the level of a stream of the preset `scene`, with all that its tree loses.
        with palette: the floats of that tree, whose coarse splats show entries of a palette made
            for them. Empty if the scene has no palette; then the tree is the lifted one.
        lifted: the floats of the lifted tree, each splat with SH of its own.
        free parents: the same pairs, with parents that no tree can keep. What "lifted" lacks of it
            is the price of the tree.
        random subset: as many splats of the scene, drawn.
    """
    cameras = cameras_around(splats, up, 400)
    pictures = [render(splats, camera, WHITE) for camera in cameras]

    def decibels(some: SplatParams) -> str:
        found = [
            psnr(render(some, camera, WHITE), picture)
            for camera, picture in zip(cameras, pictures, strict=True)
        ]
        return f"{np.mean(found):.2f}"

    whole = lift_with_order(splats, N_LEVELS)
    free = free_levels(whole.tree)
    shared = with_palette(whole, splats)
    data = encode(shared or whole.tree, PRESETS["scene"])
    directory = read_directory(data)
    rng = np.random.default_rng(0)
    rows: Rows = []
    for level in range(N_LEVELS):
        lifted = whole.tree.leaves(level)
        subset = np.sort(rng.choice(len(splats), len(lifted), replace=False))
        rows.append(
            {
                "scene": scene,
                "level": level,
                "splats": len(lifted),
                "share": f"{len(lifted) / max(len(splats), 1):.3f}",
                "decoded, dB": decibels(decode(data, Cut.of_level(directory, level)).leaves()),
                "with palette, dB": "" if shared is None else decibels(shared.leaves(level)),
                "lifted, dB": decibels(lifted),
                "free parents, dB": decibels(free[level]),
                "random subset, dB": decibels(splats.take(subset)),
            }
        )
    return rows


def photographs(tree: EvolutionTree, folder: Path) -> Rows:
    """PSNR of the levels of a tree on every 8th photograph of a NeRF-synthetic folder."""
    views = held_out(folder)
    side = len(views[0].pixels) // 2  # trained at half the size of the photographs
    raw = sum(step.psi.nbytes + step.alpha.nbytes + step.adds.nbytes for step in tree.steps)

    def row(name: str, n_bytes: int | None, leaves: Callable[[int], SplatParams]) -> None:
        found: dict[str, object] = {"tree": name}
        found["bytes a leaf"] = "" if n_bytes is None else f"{n_bytes / tree.n_leaves:.2f}"
        found["raw float32 to it"] = "" if n_bytes is None else f"{raw / n_bytes:.1f}"
        for level, part in enumerate(PYRAMID):
            results = []
            for camera, target in (view.at(side // part) for view in views):
                picture = np.clip(render(leaves(level), camera, WHITE), 0, 1)
                results.append(psnr(picture, target))
            found[f"L{level}, dB"] = f"{np.mean(results):.2f}"
        rows.append(found)

    rows: Rows = []
    row("float32", None, tree.leaves)
    aim = aim_of(
        tree, PRESETS["trained"], Views(tree.leaves(), cameras_around(tree.leaves(), "z", 400))
    )
    streams = {preset: encode(tree, PRESETS[preset]) for preset in ("trained", "paper")}
    for target in (TREE_PSNR, TARGET):
        streams[f"--target-psnr {target:g}"] = aim.at_psnr(target)
    for name, data in streams.items():
        drawn = [decode(data, level=k).leaves() for k in range(tree.n_levels)]
        row(name, len(data), drawn.__getitem__)
    return rows
