"""Splats that are drawn several times.

Rotations, sizes and opacities are the same in all views. So whoever draws several views of the same
splats activates them once, and draws what `Activated.of` gives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evogs_codec.render import projection as p
from evogs_codec.render.activation import ACTIVE, activate
from evogs_codec.render.compiled import n_threads
from evogs_codec.render.spans import SPAN
from evogs_codec.render.splats import Real, Splats

__all__ = ["Activated", "Buffers", "active_of"]


@dataclass(frozen=True, eq=False)
class Buffers:
    """What `projection.project` fills for N splats.

    Attributes:
        records: (N, FIELDS). rows: (N, 2). spans: (N, SPAN). depths: (N,). status: (N,).
    """

    records: npt.NDArray[np.float64]
    rows: npt.NDArray[np.int32]
    spans: npt.NDArray[np.int16]
    depths: npt.NDArray[np.float64]
    status: npt.NDArray[np.uint8]

    @staticmethod
    def of(n: int) -> Buffers:
        """For n splats."""
        return Buffers(
            np.empty((n, p.FIELDS), np.float64),
            np.empty((n, 2), np.int32),
            np.empty((n, SPAN), np.int16),
            np.empty(n, np.float64),
            np.empty(n, np.uint8),
        )


@dataclass(frozen=True, eq=False)
class Activated:
    """Splats that are drawn several times, one view after the other.

    Views of them are made in the same memory: a drawing of them lasts until the next.

    Attributes:
        means, quats, log_scales, opacity_logits, sh: the parameters.
        active: (N, ACTIVE) what follows from them.
        buffers: what the last drawing was made in.
    """

    means: Real
    quats: Real
    log_scales: Real
    opacity_logits: Real
    sh: Real
    active: npt.NDArray[np.float64]
    buffers: Buffers

    @staticmethod
    def of(splats: Splats) -> Activated:
        """Of any splats; they are not copied."""
        active = active_of(splats, slice(None))
        return Activated(
            splats.means,
            splats.quats,
            splats.log_scales,
            splats.opacity_logits,
            splats.sh,
            active,
            Buffers.of(len(active)),
        )

    def __len__(self) -> int:
        return len(self.means)


def active_of(splats: Splats, part: slice) -> npt.NDArray[np.float64]:
    """(n, ACTIVE) what follows from the parameters of n of the splats."""
    if isinstance(splats, Activated):
        return splats.active[part]
    quats = splats.quats[part]
    active = np.empty((len(quats), ACTIVE))
    activate(quats, splats.log_scales[part], splats.opacity_logits[part], active, n_threads())
    return active
