"""Splats that are in a tree and in no picture, until a step makes them what they are to be."""

from __future__ import annotations

import numpy as np

from evogs_codec.model.splats import F64

__all__ = ["hiding"]

HIDES, HIDDEN = -14.0, -8.0  # the same for most, since that takes few bits; and low enough for all


def hiding(logits: F64) -> F64:
    """What to add to the logits of opacities, of any shape, so that their splats are not seen."""
    return np.minimum(HIDES, HIDDEN - logits)
