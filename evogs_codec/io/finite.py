"""Splats whose numbers are not all finite: opacities are made so, other splats may be left out."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace

import numpy as np

from evogs_codec.model.splats import SplatParams

__all__ = [
    "OPAQUE",
    "bounded_opacities",
    "drop_non_finite",
    "finite_opacities",
    "with_finite_opacities",
]

# The logit for an opacity of 1, which some trainers write as infinity. From 17.4 on the opacity is
# exactly 1 in float32: this renders the same, also where a quantiser rounds it by up to 2.6, and is
# small enough to cost no bits worth a mention.
OPAQUE = 20.0


def finite_opacities(splats: SplatParams) -> tuple[SplatParams, int]:
    """`splats` with `OPAQUE` for an opacity logit of +infinity and its negative for -infinity.

    Also how many those were. They render the same: opaque, or not at all.
    """
    infinite = np.isinf(splats.opacity_logits)
    n_infinite = int(np.count_nonzero(infinite))
    if not n_infinite:
        return splats, 0
    finite = np.where(infinite, np.copysign(OPAQUE, splats.opacity_logits), splats.opacity_logits)
    return replace(splats, opacity_logits=finite), n_infinite


def bounded_opacities(splats: SplatParams) -> SplatParams:
    """`splats` with no finite opacity logit beyond `OPAQUE` or its negative: they render the same.

    Logits that are not finite stay, for those who refuse them.
    """
    logits = splats.opacity_logits
    beyond = np.isfinite(logits) & (np.abs(logits) > OPAQUE)
    if not beyond.any():
        return splats
    bounded = np.where(beyond, np.copysign(OPAQUE, logits), logits)
    return replace(splats, opacity_logits=bounded.astype(logits.dtype))


def with_finite_opacities(path: str | os.PathLike[str], splats: SplatParams) -> SplatParams:
    """What `finite_opacities` makes of the splats of a file; a warning says how many they were."""
    finite, n_infinite = finite_opacities(splats)
    if n_infinite:
        warnings.warn(
            f"{path}: {n_infinite:,} of {len(splats):,} splats have an infinite opacity:"
            f" {OPAQUE:g} or {-OPAQUE:g} is taken, which renders the same",
            stacklevel=3,
        )
    return finite


def drop_non_finite(splats: SplatParams) -> tuple[SplatParams, int]:
    """`splats` without those that have a NaN or an infinity, and how many those were."""
    keep = splats.finite()
    n_dropped = len(splats) - int(np.count_nonzero(keep))
    return (splats.take(keep) if n_dropped else splats), n_dropped
