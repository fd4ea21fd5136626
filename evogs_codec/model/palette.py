"""The palette of a tree: SH above band 0 that splats share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.model.splats import F32

__all__ = ["Palette"]


@dataclass(frozen=True, eq=False)
class Palette:
    """SH above band 0 that splats share (spec 12).

    Attributes:
        degree: 1..3.
        entries: (C, n) float32, a row per channel from 14 on; entry k of the text is column k - 1.
        n_coarse: so many of them, the first ones, were made for coarse splats.
    """

    degree: int
    entries: F32
    n_coarse: int = 0

    def sh_of(self, picks: npt.NDArray[np.integer]) -> F32:
        """(C, N) the SH of picks (N,): 0 for the pick 0."""
        n = self.entries.shape[1]
        if not n:
            return np.zeros((len(self.entries), len(picks)), np.float32)
        found: F32 = self.entries.take(np.asarray(picks, np.int64) - 1, axis=1, mode="wrap")
        found[:, picks == 0] = 0
        return found

    def rows_of(self, picks: npt.NDArray[np.integer]) -> F32:
        """(N, C) the SH of picks (N,), a row per splat."""
        entries = np.zeros((1 + self.entries.shape[1], len(self.entries)), np.float32)
        entries[1:] = self.entries.T
        return entries.take(picks, axis=0)
