"""The foveal case: a tile at the last level, the rest at level 1, from one stream."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec import PRESETS, Cut, Decoded, SplatParams, decode, encode, extract, read_directory
from evogs_codec.render import Camera, render
from tools.bench.paper.measured import Bench
from tools.bench.paper.report import Rows, Section, Table
from tools.bench.paper.runs import BUDGETS, TITLES, Run, Views

__all__ = ["foveal", "section"]

N_TILES = 8
PERIPHERY = 1  # level of the rest
SH_WHITE = 0.5 / 0.28209479177387814  # coefficient of band 0 that makes a splat white
Mask = npt.NDArray[np.bool_]


def section(bench: Bench) -> Section:
    """The first seed of EvoGS, of every budget."""
    rows: Rows = []
    for budget in BUDGETS:
        run = bench.first(budget, "evogs")
        if run is None or len(bench.views.pyramid) <= PERIPHERY + 1:
            continue
        found = bench.measure(run, "foveal", partial(foveal, bench.views), PRESETS["trained"])
        rows += [{"budget": budget, "method": TITLES["evogs"]} | row for row in found]
    text = (
        f"A stream of {N_TILES} tiles, in the integers of the tree if it was trained in them, else "
        "with `--preset trained`. The fovea is the tile that makes most pixels in the middle of "
        "the views; inside are those that it makes more than half of at the last level, drawn at "
        "full size on all held-out views. Bytes are those of the stream of exactly these packets."
    )
    if not rows:
        return Section("The foveal case", f"{text}\n\nNo run of EvoGS with enough levels yet.")
    return Section("The foveal case", text, [Table("foveal", "Mixed levels", rows)])


def foveal(views: Views, run: Run) -> list[dict[str, Any]]:
    """Bytes, splats and dB inside and outside, of the rest, of the mixture, and of all."""
    tree = run.tree()
    data = encode(tree, None if tree.quanta else PRESETS["trained"], n_tiles=N_TILES)
    directory = read_directory(data)
    last = directory.n_levels - 1
    low, high = (Cut.of_level(directory, level) for level in (PERIPHERY, last))
    fovea, inside = _fovea(decode(data, high), views)
    mixed = Cut(np.where(fovea[:, None], high.steps, low.steps), high.palette)
    rows = []
    for name, cut in (
        (f"all at L{PERIPHERY}", low),
        (f"fovea at L{last}, rest at L{PERIPHERY}", mixed),
        (f"all at L{last}", high),
    ):
        leaves = decode(data, cut).leaves()
        quality = _psnr(leaves, inside, views)
        rows.append(
            {
                "levels": name,
                "bytes": len(extract(data, cut)),
                "splats": len(leaves),
                "inside, dB": quality[0],
                "outside, dB": quality[1],
                "whole, dB": quality[2],
                "pixels inside, %": 100 * float(np.mean([mask.mean() for mask in inside])),
            }
        )
    return rows


def _fovea(scene: Decoded, views: Views) -> tuple[Mask, list[Mask]]:
    """(n_tiles,) the tile that makes most pixels in the middle of the views; its pixels in all."""
    last = len(views.pyramid) - 1
    n_live = [int(np.count_nonzero(tile.live[: tile.n_slots])) for tile in scene.tiles]
    tile_of = np.repeat(np.arange(len(n_live)), n_live)
    leaves = scene.leaves()

    def of_tile(tile: int, most: int | None) -> list[Mask]:
        cameras = [view.camera for view in views.held_out(last, most)]
        return [_made_by(leaves, tile_of == tile, camera) for camera in cameras]

    counts = [
        sum(int(_middle(mask).sum()) for mask in of_tile(tile, views.most))
        for tile in range(len(n_live))
    ]
    fovea = int(np.argmax(counts))
    return np.arange(len(n_live)) == fovea, of_tile(fovea, None)


def _made_by(splats: SplatParams, some: Mask, camera: Camera) -> Mask:
    """(H, W) where `some` of the splats make more than half of a pixel."""
    white = splats.channels()[:14]
    white[11:14] = SH_WHITE * np.where(some, 1, -1)
    found: Mask = render(SplatParams.from_channels(white), camera)[..., 0] > 0.5
    return found


def _middle(mask: Mask) -> Mask:
    """The half of each side in the middle."""
    h, w = (n // 4 for n in mask.shape)
    return mask[h : mask.shape[0] - h, w : mask.shape[1] - w]


def _psnr(splats: SplatParams, inside: list[Mask], views: Views) -> tuple[float, float, float]:
    """Mean dB over views inside, outside and everywhere; views without such pixels are left out."""
    quality: tuple[list[float], list[float], list[float]] = ([], [], [])
    for view, mask in zip(views.held_out(len(views.pyramid) - 1), inside, strict=True):
        image = render(splats, view.camera, views.background).clip(0.0, 1.0)
        squares = np.square(image.astype(np.float64) - view.image).mean(-1)
        for found, part in zip(quality, (mask, ~mask, np.ones_like(mask)), strict=True):
            if part.any():
                found.append(-10 * float(np.log10(max(squares[part].mean(), 1e-12))))
    inner, outer, whole = (float(np.mean(found)) if found else float("nan") for found in quality)
    return inner, outer, whole
