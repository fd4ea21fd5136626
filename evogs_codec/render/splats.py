"""What is drawn, as the rasterizer asks for it."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

__all__ = ["Real", "Splats"]

Real = npt.NDArray[np.floating[Any]]


class Splats(Protocol):
    """Parameters before activation; `SplatParams` is one. Arrays of float32 or float64.

    Attributes:
        means: (N, 3). quats: (N, 4), w x y z. log_scales: (N, 3). opacity_logits: (N,).
        sh: (N, K, 3), K = (degree + 1)**2.
    """

    @property
    def means(self) -> Real: ...  # noqa: D102
    @property
    def quats(self) -> Real: ...  # noqa: D102
    @property
    def log_scales(self) -> Real: ...  # noqa: D102
    @property
    def opacity_logits(self) -> Real: ...  # noqa: D102
    @property
    def sh(self) -> Real: ...  # noqa: D102
