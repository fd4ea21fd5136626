"""A cloud: splats that are free, as in plain 3DGS, perhaps over a foundation that is frozen.

Without a foundation this trains level 0 of every method, Monolithic and Single. With one it trains
a layer of LapisGS, whose lower layers keep all but their opacity, or of L3GS, whose lower layers
keep everything. Letters: F splats of the foundation, n free ones, N = F + n.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from evogs_codec import SplatParams
from reference_trainer.config import CloudGrowth
from reference_trainer.models.adam import GROUPS, Variable, splat_tensors, splat_variables
from reference_trainer.models.camera_path import CameraPath
from reference_trainer.models.densify import ScreenGradients, largest, useless
from reference_trainer.models.saved import Arrays
from reference_trainer.models.split import rotations
from reference_trainer.models.tensors import SplatTensors

__all__ = ["Cloud"]

OPACITY = GROUPS.index("opacity")
RESET_OPACITY = 0.01
SHRINK = 1.6  # of the scales of both halves


class Cloud:
    """What a level of free splats trains.

    Attributes:
        layer: the five tensors of the n free splats, trained.
        foundation: F frozen splats, or None.
        opacities: (F,) opacity logits of the foundation, trained, or None where they are frozen.
        growth: how it grows, None for not at all.
        path: of the cameras.
        seed: of the places of new splats.
        reach: they may move as far as rates say.
    """

    reach = math.inf

    def __init__(
        self,
        layer: SplatTensors,
        growth: CloudGrowth | None,
        path: CameraPath,
        seed: tuple[int, ...],
        *,
        foundation: SplatTensors | None = None,
        dynamic_opacity: bool = False,
    ) -> None:
        self.layer = splat_variables(layer)
        self.foundation = foundation
        self.opacities: Variable | None = None
        if foundation is not None and dynamic_opacity:
            self.opacities = Variable.of(foundation.opacity_logits.clone(), "opacity")
        self.growth, self.path, self.seed = growth, path, seed

    @property
    def n_foundation(self) -> int:
        """F."""
        return 0 if self.foundation is None else len(self.foundation.means)

    @property
    def n_splats(self) -> int:
        """N."""
        return self.n_foundation + len(self.layer[0].value)

    def splats(self, iteration: int) -> SplatTensors:
        """The N splats, differentiable, the foundation first."""
        layer = splat_tensors(self.layer)
        if self.foundation is None:
            if self.growth is not None:  # SH bands come in one by one
                bands = min(1 + iteration // self.growth.sh_every, 4)
                layer = layer._replace(sh=layer.sh[:, : bands * bands])
            return layer
        return self._below(self.foundation).joined(layer)

    def _below(self, foundation: SplatTensors) -> SplatTensors:
        """The foundation with the opacities that it has here."""
        if self.opacities is None:
            return foundation
        return foundation._replace(opacity_logits=self.opacities.value)

    def layer_splats(self) -> SplatParams:
        """The n free splats, with all bands."""
        return splat_tensors(self.layer).params()

    def variables(self) -> list[Variable]:
        """What is trained."""
        return [*self.layer, self.opacities] if self.opacities is not None else [*self.layer]

    def densify(self, iteration: int, n_iterations: int, scores: ScreenGradients, cap: int) -> bool:
        """Clone, split and prune if that is due after this iteration; `cap` bounds N."""
        growth = self.growth
        if growth is None or not growth.start <= iteration <= growth.stop * n_iterations:
            return False
        if growth.reset_every and iteration % growth.reset_every == 0:
            self._reset_opacities()
        if iteration % growth.every:
            return False
        self._grow(growth, scores.mean(), cap, iteration)
        self._prune(growth)
        return True

    def _grow(
        self, growth: CloudGrowth, scores: npt.NDArray[Any], cap: int, iteration: int
    ) -> None:
        with torch.no_grad():
            # All bands: what is split keeps the coefficients that are not shown yet.
            layer = splat_tensors(self.layer)
            everything = layer
            if self.foundation is not None:
                everything = self._below(self.foundation).joined(layer)
        below = self.n_foundation
        rows = largest(scores, growth.threshold, round(growth.most * self.n_splats))
        chosen = everything.rows(torch.from_numpy(rows).to(layer.means.device)).params()
        wide = chosen.log_scales.max(axis=1, initial=-np.inf) > np.log(
            growth.dense * self.path.extent
        )
        # A clone is one more; so are two halves, unless what they replace may not be removed.
        cost = np.where(wide & (rows < below), 2, 1)
        by_score = np.argsort(-scores[rows], kind="stable")
        fits = by_score[np.cumsum(cost[by_score]) <= cap - self.n_splats]
        if not len(fits):
            return
        kept = np.sort(fits)
        rows, wide, chosen = rows[kept], wide[kept], chosen.take(kept)
        halves = _halves(chosen.take(wide), np.random.default_rng((*self.seed, iteration)))
        clones = chosen.take(~wide)
        device = layer.means.device
        for new in (clones, halves):
            tensors = SplatTensors.of(new, device)
            self.layer = tuple(v.appended(x) for v, x in zip(self.layer, tensors, strict=True))
        split = rows[wide] - below
        self._keep(np.setdiff1d(np.arange(len(self.layer[0].value)), split[split >= 0]))

    def _prune(self, growth: CloudGrowth) -> None:
        splats = splat_tensors(self.layer).params()
        sizes = self.path.sizes(splats.means)
        dead = useless(splats, growth.prune_opacity, growth.prune_scale, sizes)
        self._keep(np.flatnonzero(~dead))

    def _keep(self, rows: npt.NDArray[np.int64]) -> None:
        kept = torch.from_numpy(rows).to(self.layer[0].value.device)
        self.layer = tuple(variable.rows(kept) for variable in self.layer)

    def _reset_opacities(self) -> None:
        ceiling = float(np.log(RESET_OPACITY / (1 - RESET_OPACITY)))
        variables = [self.layer[OPACITY]] + ([self.opacities] if self.opacities else [])
        for variable in variables:
            with torch.no_grad():
                variable.value.clamp_(max=ceiling)
            variable.m.zero_()
            variable.v.zero_()

    def arrays(self) -> Arrays:
        """All that training changed, for a checkpoint."""
        out: Arrays = {}
        for i, variable in enumerate(self.variables()):
            out |= variable.arrays(f"variable{i}")
        return out

    def restore(self, arrays: Arrays) -> None:
        """The inverse of `arrays`, on a cloud made with the same arguments.

        Raises:
            InputError: the arrays are of no such cloud.
        """
        device, n, layer = self.layer[0].value.device, None, []
        for i, (group, before) in enumerate(zip(GROUPS, self.layer, strict=True)):
            sides = before.value.shape[1:]
            layer.append(Variable.restored(arrays, f"variable{i}", group, device, n, *sides))
            n = len(layer[0].value)
        self.layer = tuple(layer)
        if self.opacities is not None:
            shape = self.opacities.value.shape
            self.opacities = Variable.restored(arrays, "variable5", "opacity", device, *shape)


def _halves(splats: SplatParams, rng: np.random.Generator) -> SplatParams:
    """Two for each splat, at random in it, smaller."""
    both = np.tile(np.arange(len(splats)), 2)
    twice = splats.take(both)
    offsets = rng.standard_normal(twice.means.shape) * np.exp(twice.log_scales.astype(np.float64))
    moved = twice.means + np.einsum("nij,nj->ni", rotations(twice.quats), offsets)
    return SplatParams(
        moved.astype(np.float32),
        twice.quats,
        twice.log_scales - np.float32(np.log(SHRINK)),
        twice.opacity_logits,
        twice.sh,
    )
