"""Splats before activation: the five groups, their channels, and `SplatParams`.

Letters: N splats, K = (degree + 1)**2 SH coefficients, D = 11 + 3 K channels.
Channel order (spec 3.2): position x y z, rotation w x y z, log-scale x y z, opacity logit, then the
SH coefficients in the usual order, R G B of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from evogs_codec.model.channels import MAX_SH_DEGREE, N_GEOMETRY, n_channels

__all__ = [
    "SplatParams",
    "sh_degree_of",
]

BLOCK = 4096  # splats whose rows become columns at a time: fits the cache

F32: TypeAlias = npt.NDArray[np.float32]
F64: TypeAlias = npt.NDArray[np.float64]
I32: TypeAlias = npt.NDArray[np.int32]
I64: TypeAlias = npt.NDArray[np.int64]
U8: TypeAlias = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class SplatParams:
    """N splats before activation, the arrays read-only.

    Attributes:
        means: (N, 3) positions, scene units.
        quats: (N, 4) quaternions w x y z, not normalised; zero means identity.
        log_scales: (N, 3) natural logarithms of the standard deviations, scene units.
        opacity_logits: (N,) logits of the opacity.
        sh: (N, K, 3) spherical-harmonics coefficients, R G B last, band 0 first.
    """

    means: F32
    quats: F32
    log_scales: F32
    opacity_logits: F32
    sh: F32

    def __post_init__(self) -> None:
        n = len(self.means)
        if self.sh.ndim != 3:
            raise ValueError(f"sh has shape {self.sh.shape}, expected (N, K, 3)")
        sh_degree_of(self.sh.shape[1])
        expected = {
            "means": (n, 3),
            "quats": (n, 4),
            "log_scales": (n, 3),
            "opacity_logits": (n,),
            "sh": (n, self.sh.shape[1], 3),
        }
        for name, shape in expected.items():
            array = np.asarray(getattr(self, name), dtype=np.float32)
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
            array = array.view()
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        return f"SplatParams({len(self)} splats, SH degree {self.sh_degree})"

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients, 0..3."""
        return sh_degree_of(self.sh.shape[1])

    def n_moved(self, distance: npt.NDArray[np.floating] | float) -> int:
        """How many splats move by over a tenth of their mean size, each by `distance` (N,)."""
        with np.errstate(over="ignore"):
            sizes = np.exp(self.log_scales.mean(axis=1, dtype=np.float64))
        return int(np.count_nonzero(np.isfinite(distance) & (distance > 0.1 * sizes)))

    def channels(self) -> F32:
        """(D, N) float32, one row per channel (spec 3.2)."""
        out = np.empty((n_channels(self.sh_degree), len(self)), np.float32)
        self.write_channels(out)
        return out

    def write_channels(self, out: F32 | F64) -> None:
        """`channels`, to an array that is there."""
        sh = self.sh.reshape(len(self), len(out) - N_GEOMETRY)
        for at in range(0, len(self), BLOCK):
            part = slice(at, at + BLOCK)
            out[0:3, part] = self.means[part].T
            out[3:7, part] = self.quats[part].T
            out[7:10, part] = self.log_scales[part].T
            out[10, part] = self.opacity_logits[part]
            out[11:, part] = sh[part].T

    @staticmethod
    def from_channels(channels: npt.NDArray[np.floating]) -> SplatParams:
        """The inverse of `channels`: (D, N) in, any float dtype, rounded to float32 once."""
        x = np.asarray(channels)
        n = x.shape[1]
        return SplatParams(
            means=np.ascontiguousarray(x[0:3].T, np.float32),
            quats=np.ascontiguousarray(x[3:7].T, np.float32),
            log_scales=np.ascontiguousarray(x[7:10].T, np.float32),
            opacity_logits=x[10].astype(np.float32),
            sh=np.ascontiguousarray(x[11:].T, np.float32).reshape(n, (len(x) - 11) // 3, 3),
        )

    @staticmethod
    def joined(parts: Sequence[SplatParams]) -> SplatParams:
        """The splats of at least one part after another, at the highest SH degree of all."""
        ends = np.cumsum([0, *map(len, parts)])
        sh = np.zeros((ends[-1], max(part.sh.shape[1] for part in parts), 3), np.float32)
        for begin, end, part in zip(ends[:-1], ends[1:], parts, strict=True):
            sh[begin:end, : part.sh.shape[1]] = part.sh
        return SplatParams(
            means=np.concatenate([part.means for part in parts]),
            quats=np.concatenate([part.quats for part in parts]),
            log_scales=np.concatenate([part.log_scales for part in parts]),
            opacity_logits=np.concatenate([part.opacity_logits for part in parts]),
            sh=sh,
        )

    def take(self, rows: npt.NDArray[np.integer] | npt.NDArray[np.bool_] | slice) -> SplatParams:
        """The splats of `rows`, in that order."""
        return SplatParams(
            self.means[rows],
            self.quats[rows],
            self.log_scales[rows],
            self.opacity_logits[rows],
            self.sh[rows],
        )

    def finite(self) -> npt.NDArray[np.bool_]:
        """(N,) True where every number of the splat is finite."""
        flags = np.ones(len(self), bool)
        flags &= np.isfinite(self.means).all(1)
        flags &= np.isfinite(self.quats).all(1)
        flags &= np.isfinite(self.log_scales).all(1)
        flags &= np.isfinite(self.opacity_logits)
        flags &= np.isfinite(self.sh).all((1, 2))
        return flags


def sh_degree_of(n_coefficients: int) -> int:
    """SH degree with `n_coefficients` = (degree + 1)**2 coefficients.

    Raises:
        ValueError: no degree of 0..3 has that many.
    """
    for degree in range(MAX_SH_DEGREE + 1):
        if (degree + 1) ** 2 == n_coefficients:
            return degree
    raise ValueError(f"{n_coefficients} SH coefficients are no degree of 0..{MAX_SH_DEGREE}")
