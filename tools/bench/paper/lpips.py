"""LPIPS, where its package and its weights are on this machine; nothing is fetched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from evogs_codec.render import render
from reference_trainer.evaluate import leaves_drawn
from tools.bench.paper.measured import Bench
from tools.bench.paper.runs import Run

__all__ = ["Lpips", "find_lpips"]

Image = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Lpips:
    """A measure of pictures, or the reason that there is none.

    Attributes:
        says: a sentence for the report.
        measure: two pictures (H, W, 3) in 0..1 to their distance.
    """

    says: str
    measure: Callable[[Image, Image], float] | None = None

    def of(self, bench: Bench, run: Run) -> list[float]:
        """The mean over held-out views, for each level of a run."""
        measure, views = self.measure, bench.views
        assert measure is not None

        def levels(run: Run) -> list[float]:
            tree, out = run.tree(), []
            for level in range(len(views.pyramid)):
                splats, _ = leaves_drawn(tree, level)
                found = [
                    measure(render(splats, v.camera, views.background).clip(0, 1), v.image)
                    for v in views.held_out(level)
                ]
                out.append(float(np.mean(found)))
            return out

        found: list[float] = bench.measure(run, "lpips", levels)
        return found


def find_lpips() -> Lpips:
    """With the VGG network, as 3DGS uses it."""
    for package in ("lpips", "torchvision"):
        if find_spec(package) is None:
            return Lpips(f"LPIPS was not measured: the package {package} is not installed.")
    import torch

    models = import_module("torchvision.models")
    name = Path(str(models.VGG16_Weights.IMAGENET1K_V1.url)).name
    if not (Path(torch.hub.get_dir()) / "checkpoints" / name).is_file():
        return Lpips(f"LPIPS was not measured: the weights {name} are not on this machine.")
    network = import_module("lpips").LPIPS(net="vgg", verbose=False).eval()

    def measure(a: Image, b: Image) -> float:
        pair = [torch.tensor(np.asarray(x, np.float32)).permute(2, 0, 1)[None] for x in (a, b)]
        with torch.no_grad():
            return float(network(*pair, normalize=True))

    return Lpips("LPIPS is with VGG.", measure)
