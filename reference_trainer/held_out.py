"""Held-out views as a user looks at them: every level at full size, beside the photograph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from evogs_codec import EvolutionTree
from evogs_codec.render import psnr, render
from evogs_codec.render.png import contact_sheet, write_png
from reference_trainer.evaluate import leaves_drawn

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["at_full_size", "write_sheet"]

N_SHOWN = 2  # views of a sheet


def at_full_size(tree: EvolutionTree, data: Dataset, n_levels: int) -> list[float]:
    """Mean PSNR in dB of each level on the held-out views, drawn at the size of `data`."""
    views = data.test or data.train
    found = []
    for level in range(n_levels):
        splats, _ = leaves_drawn(tree, level)
        pairs = [(render(splats, v.camera, data.background), v.image) for v in views]
        found.append(float(np.mean([psnr(image.clip(0, 1), right) for image, right in pairs])))
    return found


def write_sheet(
    path: Path, tree: EvolutionTree, data: Dataset, n_levels: int, *, made_by: str = ""
) -> None:
    """A row for each of a few held-out views: the photograph, then each level at its size."""
    views = data.test or data.train
    chosen = [views[i] for i in sorted({0, len(views) // 2})][:N_SHOWN]
    rows, labels = [], []
    for view in chosen:
        drawn = [
            render(leaves_drawn(tree, level)[0], view.camera, data.background).clip(0, 1)
            for level in range(n_levels)
        ]
        rows.append([view.image, *drawn])
        worth = ", ".join(f"{psnr(image, view.image):.1f}" for image in drawn)
        labels.append(f"photograph, then levels: {worth} dB")
    write_png(path, contact_sheet(rows, labels=labels), made_by=made_by)
