"""What a tree is worth, level by level: quality, storage, footprint, transparent splats."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from evogs_codec import EvolutionTree, SplatParams
from evogs_codec.model.channels import GROUP_CHANNELS, n_channels
from evogs_codec.model.tree import Kind, Step
from evogs_codec.render import psnr, render, ssim
from evogs_codec.render.png import write_png

if TYPE_CHECKING:
    from reference_trainer.data import Dataset

__all__ = ["evaluate", "leaves_drawn", "storage"]

MIN_OPACITY = 0.005  # opacity, as the paper has it
BYTES_OF_NUMBER = 4  # of a number, uncompressed


def evaluate(
    tree: EvolutionTree,
    method: str,
    pyramid: tuple[Dataset, ...],
    pictures: Path | None = None,
    *,
    made_by: str = "",
) -> list[dict[str, Any]]:
    """A row per level, as JSON takes it.

    Args:
        tree: of any method.
        method: its name; models that are not layered count their storage otherwise.
        pyramid: the data at the resolution of each level; held-out views are measured.
        pictures: folder for the first held-out view of each level, as it is and as rendered.
        made_by: the command that these name as their maker.
    """
    rows = []
    for level, data in enumerate(pyramid):
        splats, born = leaves_drawn(tree, level)
        views = data.test or data.train
        images = [render(splats, v.camera, data.background).clip(0.0, 1.0) for v in views]
        pairs = list(zip(images, views, strict=True))
        opacity = 1 / (1 + np.exp(-splats.opacity_logits.astype(np.float64)))
        clear = opacity < MIN_OPACITY
        rows.append(
            {
                "level": level,
                "width": views[0].camera.width,
                "height": views[0].camera.height,
                "psnr": float(np.mean([psnr(image, v.image) for image, v in pairs])),
                "ssim": float(np.mean([ssim(image, v.image) for image, v in pairs])),
                "splats": len(splats),
                "storage_bytes": storage(tree, method, level),
                "footprint_bytes": BYTES_OF_NUMBER * n_channels(tree.sh_degree) * len(splats),
                "transparent": float(clear.mean()) if len(clear) else 0.0,
                "transparent_by_layer": _by_layer(clear, born),
            }
        )
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            write_png(pictures / f"L{level}.png", images[0], made_by=made_by)
            write_png(pictures / f"L{level}-photograph.png", views[0].image, made_by=made_by)
    return rows


def leaves_drawn(tree: EvolutionTree, level: int) -> tuple[SplatParams, npt.NDArray[np.int64]]:
    """The N leaves at a level, or at the last one if there are fewer, and (N,) their layers.

    The layer of a leaf is the level at which its slot was made.
    """
    level = min(level, tree.n_levels - 1)
    steps = [step for step in tree.steps if step.level <= level]
    state = next(islice(tree.states(), len(steps) - 1, None))
    born = np.concatenate([np.full(step.n_new, step.level, np.int64) for step in steps])
    return state.splats(), born[state.live]


def storage(tree: EvolutionTree, method: str, level: int) -> int:
    """Bytes that a client must have for `level`, as the paper counts: numbers times four.

    A root, an add or an independent child has D numbers, a split D, and five where alpha is
    learned; a refine has those of the groups that it changes. Slots and kinds are not counted, nor
    are numbers that are the same for a whole level. Monolithic stores a level alone, Single is one
    model.
    """
    steps = [step for step in tree.steps if step.level <= level or method == "single"]
    if method == "mono":
        steps = [step for step in steps if step.level == level]
    learned = {step.level for step in steps if _learned(step)}
    return BYTES_OF_NUMBER * sum(_numbers(step, step.level in learned) for step in steps)


def _learned(step: Step) -> bool:
    """Whether the splits of a step differ in alpha."""
    return bool(step.alpha.size and np.ptp(step.alpha, axis=1).any())


def _numbers(step: Step, learned_alpha: bool) -> int:
    d = len(step.psi)
    split = step.kinds[step.kinds != Kind.DROP] == Kind.SPLIT
    n_splits, n_refines = int(split.sum()), int((~split).sum())
    changed = sum(
        np.arange(d)[channels].size
        for channels in GROUP_CHANNELS
        if np.any(step.psi[channels][:, ~split])
    )
    per_split = d + len(step.alpha) if learned_alpha else d
    return d * step.n_adds + per_split * n_splits + changed * n_refines


def _by_layer(clear: npt.NDArray[np.bool_], born: npt.NDArray[np.int64]) -> dict[str, float]:
    return {str(k): float(clear[born == k].mean()) for k in np.unique(born)}
