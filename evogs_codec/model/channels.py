"""Channels of a splat: their groups and their quantiser classes.

Letters: D = 11 + 3 (degree + 1)**2 channels of a splat. Channel order (spec 3.2): position x y z,
rotation w x y z, log-scale x y z, opacity logit, then the SH coefficients, R G B of each.
"""

from __future__ import annotations

from functools import cache

import numpy as np

__all__ = [
    "CLASS_NAMES",
    "CORE_SH",
    "GROUPS",
    "GROUP_CHANNELS",
    "MAX_SH_DEGREE",
    "N_CORE",
    "N_GEOMETRY",
    "N_GROUPS",
    "SH_GROUP",
    "channel_class",
    "group_of_class",
    "n_channels",
    "n_classes",
]

GROUPS = ("position", "rotation", "scale", "opacity", "sh")
GROUP_CHANNELS = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 11), slice(11, None))
N_GROUPS = len(GROUPS)
SH_GROUP = 4
CLASS_NAMES = ("position", "rotation", "scale", "opacity", "sh 0", "sh 1", "sh 2", "sh 3")
N_GEOMETRY = 11  # channels before the SH coefficients
N_CORE = 14  # channels of core: geometry and SH band 0
CORE_SH = slice(N_GEOMETRY, N_CORE)
MAX_SH_DEGREE = 3


def n_channels(sh_degree: int) -> int:
    """D for an SH degree (spec 3.2)."""
    return N_GEOMETRY + 3 * (sh_degree + 1) ** 2


def n_classes(sh_degree: int) -> int:
    """Quantiser classes (spec 3.2)."""
    return N_GROUPS + sh_degree


@cache
def channel_class(channel: int) -> int:
    """Quantiser class of a channel (spec 3.2)."""
    if channel < N_GEOMETRY:
        return int(np.searchsorted([3, 7, 10, 11], channel, side="right"))
    return SH_GROUP + int(np.sqrt((channel - N_GEOMETRY) // 3))


def group_of_class(kind: int) -> int:
    """The group whose grid and alpha a quantiser class has: every SH band that of SH."""
    return min(kind, SH_GROUP)
