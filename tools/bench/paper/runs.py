"""Finished runs of the queue, read from their folders, and the held-out views they are measured on.

Letters: L levels, n runs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evogs_codec import EvolutionTree, InputError, SplatParams
from evogs_codec.common.printable import shown
from evogs_codec.io.json_files import read_json
from evogs_codec.io.tree_npz import read_tree
from evogs_codec.render import psnr, render
from evogs_codec.render.options import DEFAULT, Options

if TYPE_CHECKING:
    from reference_trainer.data import Dataset, View

__all__ = ["BUDGETS", "TITLES", "Run", "Views", "find_runs", "read_run"]

BUDGETS = {
    "equal": "At an equal budget of splats per level",
    "thresholds": "Growing by thresholds: baselines by their published ones, EvoGS by its own",
}
TITLES = {
    "mono": "Monolithic",
    "single": "Single",
    "l3gs": "L3GS",
    "lapis": "LapisGS",
    "evogs-a": "EvoGS option A",
    "evogs-b": "EvoGS option B",
    "evogs-sym": "EvoGS symmetric",
    "evogs": "EvoGS",
    "evogs-mixed": "EvoGS mixed",
}


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run.

    Attributes:
        folder: with `tree.tree.npz` and `pictures`.
        budget: of `BUDGETS`.
        method: of `TITLES`.
        seed: of the run.
        config: as `Config.as_dict` gave it.
        levels: a row per level, as `evaluate` gave it.
        seconds: of training.
        machine: it was trained on, and how many threads.
        n_views: trained on, and held out.
    """

    folder: Path
    budget: str
    method: str
    seed: int
    config: dict[str, Any]
    levels: tuple[dict[str, Any], ...]
    seconds: float
    machine: str
    n_views: tuple[int, int]

    def tree(self) -> EvolutionTree:
        """The trained tree."""
        return read_tree(self.folder / "tree.tree.npz")

    @cached_property
    def sha256(self) -> str:
        """Of the file of the tree."""
        return hashlib.sha256((self.folder / "tree.tree.npz").read_bytes()).hexdigest()


def find_runs(folder: Path) -> list[Run]:
    """The finished runs below `folder`, in the order of methods, then seeds.

    Raises:
        InputError: a result cannot be read.
    """
    runs = []
    for path in sorted(folder.glob("*/result.json")):
        budget = path.parent.name.split("-")[0]
        if budget in BUDGETS:
            runs.append(read_run(path, budget))
    methods = list(TITLES)
    return sorted(runs, key=lambda run: (methods.index(run.method), run.seed))


def read_run(path: Path, budget: str) -> Run:
    """The run of a `result.json`, of a budget.

    Raises:
        InputError: it cannot be read.
    """
    try:
        result: Any = read_json(path)
        config = result["config"]
        return Run(
            path.parent,
            budget,
            config["method"],
            config["seed"],
            config,
            tuple(result["levels"]),
            result["seconds"],
            f"{result['machine']}, {result['threads']} threads",
            (result["data"]["train"], result["data"]["test"]),
        )
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no result of a run: {shown(repr(error))}") from error


@dataclass(frozen=True, eq=False)
class Views:
    """What runs are measured on.

    Attributes:
        pyramid: the data at the resolution of each of L levels.
        most: views that a cut is measured on, of all that are held out.
    """

    pyramid: tuple[Dataset, ...]
    most: int

    @property
    def background(self) -> tuple[float, float, float]:
        """Of all pictures."""
        return self.pyramid[-1].background

    def held_out(self, level: int, most: int | None = None) -> Sequence[View]:
        """Views at a level, all or `most` of them, evenly chosen."""
        data = self.pyramid[level]
        views = data.test or data.train
        if most is None or most >= len(views):
            return views
        return [views[int(i)] for i in np.linspace(0, len(views) - 1, most)]

    def psnr(
        self,
        splats: SplatParams,
        level: int,
        most: int | None = None,
        *,
        options: Options = DEFAULT,
    ) -> float:
        """Mean PSNR in dB on the views of a level."""
        found = [
            psnr(
                render(splats, view.camera, self.background, options=options).clip(0.0, 1.0),
                view.image,
            )
            for view in self.held_out(level, most)
        ]
        return float(np.mean(found))

    def check(self, run: Run) -> None:
        """Refuse a run of other data.

        Raises:
            InputError: it has other levels, sizes of pictures or numbers of views.
        """
        data = self.pyramid[-1]
        if run.n_views != (len(data.train), len(data.test)):
            views = f"{run.n_views[0]} views, measured on {run.n_views[1]}"
            raise InputError(f"{run.folder}: was trained on {views}; is --data another?")
        sizes = [(row["width"], row["height"]) for row in run.levels]
        cameras = [self.held_out(level)[0].camera for level in range(len(self.pyramid))]
        if sizes != [(camera.width, camera.height) for camera in cameras]:
            of_run = ", ".join(f"{w} x {h}" for w, h in sizes)
            raise InputError(f"{run.folder}: was measured at {of_run}; give its --size and --data")

    @cached_property
    def sha256(self) -> str:
        """Of the held-out views."""
        digest = hashlib.sha256(f"{self.most} {self.background}".encode())
        for view in self.held_out(len(self.pyramid) - 1):
            digest.update(view.name.encode() + view.camera.rotation.tobytes())
            digest.update(np.ascontiguousarray(view.image).tobytes())
        return digest.hexdigest()
